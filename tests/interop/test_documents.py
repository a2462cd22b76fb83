"""Documents for people in Chromium: the report of a job, and its assembly instructions."""

import asyncio
from dataclasses import replace

import pytest

from books.planned_job import plan_job
from browser.accessibility import AXE_SCRIPT, find_faults
from browser.chromium import CHROMIUM, Chromium
from decompose.decompose import decompose_model
from decompose.export.instructions import write_instructions
from decompose.geometry import Model, Solid
from decompose.options import ConnectorOptions, Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.results import connect_parts
from farm.model import Role
from farms.network_farm import NetworkFarm

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is missing: apt-get install chromium"),
    pytest.mark.skipif(not AXE_SCRIPT.exists(), reason="axe is missing: make pages"),
]


@pytest.fixture
def report(tmp_path):
    """Return the path of a planned job's report, as the farm sends it."""
    farm = NetworkFarm(tmp_path)
    plan_job(farm, hold=True)
    response = farm.ask("GET", "/jobs/1/report", farm.add_key(Role.LOOK).text)
    farm.store.close()
    assert response.status_code == 200
    path = tmp_path / "report.html"
    path.write_bytes(response.content)
    return path


@pytest.fixture
def instructions(tmp_path):
    """Return the path of assembly instructions for a block of two parts with pins and marks."""
    printers = [TargetPrinter(name, ((80.0, 80.0, 80.0),)) for name in "ab"]
    connectors = ConnectorOptions(2.85, marks=True)
    options = Options(engine=Engine.GUILLOTINE, granularity=4, prove=False)
    block = Model(Solid.box((0, 0, 0), (120, 60, 40)), (), 1.0)
    decomposition = decompose_model(block, printers, options, CostModel(1.0, *[1e-3] * 7, brim_mm=0.0))
    cut_model = replace(decomposition.with_assembly(), options=replace(options, connectors=connectors))
    path = tmp_path / "instructions.html"
    write_instructions(connect_parts(cut_model), path)
    return path


def test_documents_are_accessible_and_fit_a_narrow_phone(tmp_path, report, instructions):
    async def run():
        results = {}
        async with Chromium(tmp_path / "profile", "MAP * ~NOTFOUND") as browser:
            for path in (report, instructions):
                await browser.open(path.as_uri())
                if faults := await find_faults(browser):
                    results[path.name] = faults
        assert results == {}

    asyncio.run(run())
