"""Several jobs of one evening in real processes, which are planned although no bed is free."""

from __future__ import annotations

import json

import pytest
import trimesh

from farms.real_farm import BUDGET_S, wait_for

pytestmark = pytest.mark.system

PRINTER_MODEL = "ultimaker2_plus"


@pytest.fixture
def models(tmp_path):
    """Write a box that fits one printer, and a sphere whose search for parts takes minutes."""
    trimesh.creation.box((60.0, 30.0, 12.0)).export(tmp_path / "box.stl")
    trimesh.creation.icosphere(subdivisions=5, radius=160.0).export(tmp_path / "sphere.stl")
    return {name: tmp_path / f"{name}.stl" for name in ("box", "sphere")}


@pytest.fixture
def evening_farm(make_farm):
    """Start a farm of two printers and one worker, with a large budget for the search for parts."""
    farm = make_farm(
        {
            "one": (PRINTER_MODEL, f"sim://{PRINTER_MODEL}?seed=1"),
            "two": (PRINTER_MODEL, f"sim://{PRINTER_MODEL}?seed=2"),
        }
    )
    text = farm.fleet.read_text()
    farm.fleet.write_text(text.replace(f"budget_s: {BUDGET_S}", "budget_s: 600, workers: 1"))
    farm.up()
    return farm


def list_prints(job):
    return [attempt for part in job["parts"] for attempt in part["prints"]]


def test_jobs_and_dry_runs_are_planned_while_printers_and_workers_are_busy(evening_farm, bar, models):
    farm = evening_farm
    farm.run_checked("submit", bar, "--engine", "guillotine")
    wait_for("both printers to print", lambda: len(list_prints(farm.read_job())) == 2)

    # From now on, no bed is cleared; both jobs are planned nevertheless.
    farm.run_checked("submit", bar, "--engine", "guillotine")
    farm.run_checked("submit", models["box"])
    wait_for("two plans", lambda: all(farm.read_job(number)["parts"] for number in (2, 3)))
    for number, parts in ((2, 2), (3, 1)):
        job = farm.read_job(number)
        assert len(job["parts"]) == parts
        assert job["grams"] > 0 and job["estimated_s"] > 0 and job["eta"]
        assert {plate["hold"]["code"] for plate in job["plates"]} <= {"printer_busy", "bed_not_clear"}
        assert list_prints(job) == []

    farm.run_checked("submit", models["sphere"])
    wait_for("the search for parts", lambda: (farm.read_job(4)["progress"] or {}).get("remaining_s"))
    timeline = json.loads(farm.run_checked("submit", models["box"], "--dry-run", "--json"))
    assert len(timeline["slots"]) == 1 and timeline["grams"] > 0
    progress = farm.read_job(4)["progress"]
    assert progress["step"] == "decomposing" and progress["remaining_s"] > 0
    assert "decomposing" in farm.run_checked("status")
    farm.run_checked("cancel", 4)
