"""Grafana board, whose panels must query existing metrics and must not overlap."""

import itertools
import json
import re
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from farm.model import PrintState
from farms.scraped_farm import ScrapedFarm

BOARD = json.loads((Path(__file__).parents[2] / "deploy/grafana/farm.json").read_text())
PANELS = BOARD["panels"]
LABEL_PATTERN = re.compile(r"\b(\w+)\s*(?:=~|!~|!=|=)\s*\"")


@pytest.fixture
def labels(tmp_path):
    """Return the labels of each metric of a farm with one ended and one open print."""
    farm = ScrapedFarm(tmp_path)
    farm.print_plate(PrintState.DONE)
    farm.print_plate(PrintState.PRINTING)
    labels_by_name = {}
    for family in text_string_to_metric_families(farm.scrape()):
        labels_by_name.setdefault(family.name, set())
        labels_by_name.setdefault(f"{family.name}_total", set())
        for sample in family.samples:
            labels_by_name.setdefault(sample.name, set()).update(sample.labels)
    return labels_by_name


def test_every_expression_uses_existing_metrics_and_labels(labels):
    expressions = [target for panel in PANELS for target in panel["targets"]]
    assert len(expressions) > 10
    for target in expressions:
        (name,) = set(re.findall(r"\bfarm_[a-z_]+", target["expr"]))
        assert name in labels, name
        names_used = {
            *LABEL_PATTERN.findall(target["expr"]),
            *re.findall(r"\{\{(\w+)\}\}", target["legendFormat"]),
        }
        assert not labels[name] or names_used <= labels[name], (name, names_used - labels[name])
    assert "printer" in labels["farm_printer_info"]


def test_panels_have_unique_ids_and_do_not_overlap():
    assert len({panel["id"] for panel in PANELS}) == len(PANELS)
    cells = [
        (x, y)
        for position in (panel["gridPos"] for panel in PANELS)
        for x, y in itertools.product(
            range(position["x"], position["x"] + position["w"]),
            range(position["y"], position["y"] + position["h"]),
        )
    ]
    assert len(cells) == len(set(cells))
    assert max(x for x, _ in cells) < 24


def test_data_source_is_chosen_by_the_user():
    names = {variable["name"] for variable in BOARD["templating"]["list"]}
    assert names == {"datasource", "printer"}
    assert all(
        target["datasource"]["uid"] == "${datasource}" for panel in PANELS for target in panel["targets"]
    )
    assert BOARD["id"] is None  # Grafana assigns an id
