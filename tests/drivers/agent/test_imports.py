"""Modules of an agent: an upgrade changes its files while it prints."""

import re
from pathlib import Path

import pytest

from agent_with_emulator import gcode, printer, run
from drivers import messages as m


@pytest.mark.system
def test_an_agent_loads_no_module_after_its_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")

    async def scenario() -> None:
        async with printer(tmp_path) as rig:
            assert (await rig.start(gcode(200))).error is None
            await rig.phase(m.PrintPhase.PRINTING)
            await rig.client.close()
            await rig.connect()
            await rig.phase(m.PrintPhase.DONE)

    run(scenario())
    [log] = [path.read_text() for path in tmp_path.rglob("agent.log")]
    imports, ready, after = log.partition("the board answers")
    assert ready and "done" in after
    assert re.search(r"import time:.*\| +drivers\.session", imports)
    assert "import time:" not in after
