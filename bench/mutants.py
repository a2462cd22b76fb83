"""Mutation testing of the rules that prints depend on: find deliberate faults that no test detects.

.venv/mutants/bin/python -m bench.mutants --group link

cosmic-ray makes mutants of a group of modules. A sample of them (`--seed`) is put, one by one, into a copy
of the sources, and the tests of the group are run on each. cosmic-ray is in its own environment
(`make mutants`).
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkerOutcome, WorkResult

from bench.mutant_groups import GROUPS, Group

ROOT = Path(__file__).parents[1]
PYTHON = ROOT / ".venv" / "bin" / "python"
TIMEOUT_S = 600.0
_EQUIVALENT_OPERATORS = ("BitOr", "RemoveDecorator")  # mutants that change no behaviour


def test_group(name: str, group: Group, seed: int, folder: Path) -> list[tuple[str, str]]:
    """Run a sample of the mutants of a group; return outcome and diff of each."""
    sources, session, config = folder / "sources", folder / "session.sqlite", folder / "config.toml"
    shutil.rmtree(folder, ignore_errors=True)
    list_command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    files = subprocess.run(
        list_command, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    for file in files:
        (sources / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, sources / file)
    command = f"{PYTHON} -m pytest -x --hypothesis-profile=ci -p no:cacheprovider {' '.join(group.tests)}"
    modules = ", ".join(f'"{module}"' for module in group.modules)
    config.write_text(
        f'[cosmic-ray]\nmodule-path = [{modules}]\ntimeout = {TIMEOUT_S}\ntest-command = "{command}"\n'
        '[cosmic-ray.distributor]\nname = "local"\n'
    )

    def run_cosmic_ray(*arguments: str | Path) -> None:
        # Without this, Python would mistake two mutants of the same second and size for the same file.
        env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        tool = Path(sys.executable).with_name("cosmic-ray")
        subprocess.run([tool, *arguments], cwd=sources, env=env, check=True)

    run_cosmic_ray("baseline", config)
    run_cosmic_ray("init", config, session)
    with use_db(session, WorkDB.Mode.open) as db:
        _sample(db, random.Random(f"{name} {seed}"), group.mutants)
    run_cosmic_ray("exec", config, session)
    with use_db(session, WorkDB.Mode.open) as db:
        results = [result for _, result in db.results if result.worker_outcome is not WorkerOutcome.SKIPPED]
    return [(str((r.test_outcome or TestOutcome.INCOMPETENT).value), r.diff or "") for r in results]


def _sample(db: WorkDB, rng: random.Random, count: int) -> None:
    """Reduce the mutants to a random sample."""
    items = sorted(db.work_items, key=lambda item: str(item.mutations))
    candidates = [
        item
        for item in items
        if not any(name in item.mutations[0].operator_name for name in _EQUIVALENT_OPERATORS)
    ]
    sample = {item.job_id for item in rng.sample(candidates, min(count, len(candidates)))}
    skipped_result = WorkResult(worker_outcome=WorkerOutcome.SKIPPED)
    db.set_multiple_results([item.job_id for item in items if item.job_id not in sample], skipped_result)


def main() -> None:
    """Parse the command line, test the mutants, and print those that survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--group", choices=GROUPS, action="append", help="group to test, may be repeated; default: all"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at-once", type=int, default=1, help="number of groups tested in parallel")
    options = parser.parse_args()
    names = options.group or list(GROUPS)

    def run_group(name: str) -> list[tuple[str, str]]:
        return test_group(name, GROUPS[name], options.seed, ROOT / "build" / "mutants" / name)

    with ThreadPoolExecutor(options.at_once) as pool:
        results_by_group = dict(zip(names, pool.map(run_group, names), strict=True))
    for name, results in results_by_group.items():
        for outcome, diff in results:
            if outcome == TestOutcome.SURVIVED.value:
                print(f"--- {name}: survived\n{diff}")
    print(f"{'group':12} {'mutants':>7} {'killed':>7} {'survived':>9}")
    for name, results in results_by_group.items():
        survivor_count = sum(outcome == TestOutcome.SURVIVED.value for outcome, _ in results)
        print(f"{name:12} {len(results):5} {len(results) - survivor_count:7} {survivor_count:9}")


if __name__ == "__main__":
    main()
