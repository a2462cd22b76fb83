"""Imported modules of an agent, whose files an upgrade may replace during a print."""

import re
from pathlib import Path

import pytest

from drivers import messages as m
from printers.agent_with_emulator import make_gcode, run, run_printer


@pytest.mark.system
def test_agent_loads_no_module_after_its_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")

    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            assert (await rig.start(make_gcode(200))).error is None
            await rig.wait_for_phase(m.PrintPhase.PRINTING)
            await rig.client.close()
            await rig.connect()
            await rig.wait_for_phase(m.PrintPhase.DONE)

    run(run_scenario())
    [log] = [path.read_text() for path in tmp_path.rglob("agent.log")]
    imports, ready_text, log_after = log.partition("the board answers")
    assert ready_text and "done" in log_after
    assert re.search(r"import time:.*\| +drivers\.session", imports)
    assert "import time:" not in log_after
