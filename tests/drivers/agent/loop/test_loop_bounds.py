"""Bounds of an agent's files, over years and during a print."""

import json
import signal
import time
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.records import AGENT_LOG, JOURNAL, Journal
from drivers.records.journal import MAX_BYTES
from printers.agent_with_emulator import make_gcode, run, run_printer


def fill_journal(path: Path) -> None:
    """Write a journal of thousands of prints, after which the filament is parked."""
    journal = Journal(path)
    ended_print = m.PrintSnapshot(
        print_id="p-0", phase=m.PrintPhase.DONE, ended_s=time.time(), reason="x" * 400
    )
    line = ended_print.model_dump_json()
    with path.open("a") as file:
        for number in range(MAX_BYTES // len(line) + 100):
            file.write(f'{{"at_s": 1.0, "print": {line.replace("p-0", f"old-{number}")}}}\n')
    journal = Journal(path)
    journal.write(2.0, print=None, filament="parked")


@pytest.mark.system
def test_full_log_and_a_long_journal_are_continued_without_losing_a_line(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            assert rig.process is not None
            rig.process.send_signal(signal.SIGTERM)
            rig.process.wait(10.0)
            first_log = (rig.folder / AGENT_LOG).read_text()
            with (rig.folder / AGENT_LOG).open("a") as log:
                log.write("x" * 3_000_000 + "\n")
            fill_journal(rig.folder / JOURNAL)
            rig.spawn()
            await rig.connect()
            await rig.wait_until_ready()
            assert (await rig.start(make_gcode(50))).error is None
            await rig.wait_for_phase(m.PrintPhase.DONE)
            old_log, new_log = (
                (rig.folder / f"{AGENT_LOG}.1").read_text(),
                (rig.folder / AGENT_LOG).read_text(),
            )
            assert old_log.startswith(first_log + "x" * 100) and len(new_log) < 10_000
            records = (json.loads(line) for line in (rig.folder / JOURNAL).read_text().splitlines())
            prints = (record["print"] for record in records if record.get("print"))
            phases = [item["phase"] for item in prints if item["print_id"] == "p-1"]
            log_texts = [
                line.rpartition("print p-1: ")[2] for line in new_log.splitlines() if "print p-1: " in line
            ]
            assert phases[0] == "spooled" and log_texts == phases[1:] and log_texts[-1] == "done"
            assert (rig.folder / JOURNAL).stat().st_size < MAX_BYTES
            state = Journal(rig.folder / JOURNAL).state
            assert len(state.recent_prints) == 1000 and state.recent_prints[-1].print_id == "p-1"

    run(run_scenario())
