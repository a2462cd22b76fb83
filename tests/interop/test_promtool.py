"""Metrics, alert rules and the expressions of the Grafana board, checked by Prometheus' promtool."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from farm.model import PrintState
from farms.scraped_farm import ScrapedFarm

DEPLOY_FOLDER = Path(__file__).parents[2] / "deploy"
RULES, BOARD = DEPLOY_FOLDER / "prometheus/farm.rules.yml", DEPLOY_FOLDER / "grafana/farm.json"
pytestmark = pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is missing: `make peers`")


def run_promtool(*arguments, text=None):
    return subprocess.run(
        ["promtool", *arguments], input=text, capture_output=True, text=True, check=False, timeout=60
    )


def test_names_of_metrics_follow_the_rules_of_prometheus(tmp_path):
    farm = ScrapedFarm(tmp_path)
    farm.print_plate(PrintState.DONE)
    result = run_promtool("check", "metrics", text=farm.scrape())
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    assert run_promtool("check", "metrics", text="farm_wrong_total 1 2 3\n").returncode != 0


def test_alert_rules_are_valid_and_use_existing_metrics_only(tmp_path):
    result = run_promtool("check", "rules", str(RULES))
    assert result.returncode == 0, result.stdout + result.stderr
    text = ScrapedFarm(tmp_path).scrape()
    metric_names = set(re.findall(r"\bfarm_[a-z_]+", RULES.read_text()))
    assert len(metric_names) > 4
    for name in metric_names:
        assert f"# TYPE {name} " in text, name


def test_expressions_of_the_grafana_board_are_valid(tmp_path):
    panels = json.loads(BOARD.read_text())["panels"]
    expressions = [
        target["expr"].replace("$printer", ".*") for panel in panels for target in panel["targets"]
    ]
    rules = [{"record": f"panel:{number}", "expr": expr} for number, expr in enumerate(expressions)]
    path = tmp_path / "rules.json"  # JSON is valid YAML
    path.write_text(json.dumps({"groups": [{"name": "board", "rules": rules}]}))
    result = run_promtool("check", "rules", str(path))
    assert result.returncode == 0, result.stdout + result.stderr
    assert f"{len(rules)} rules found" in result.stdout
