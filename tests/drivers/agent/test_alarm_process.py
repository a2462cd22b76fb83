"""Heater stuck on during a print, on real processes: agent, emulator and a `power_off_cmd`."""

import asyncio
import os
import signal
import time
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import control
from drivers.errors import PortError
from printers.agent_with_emulator import PRINTER_MODEL, Printer, make_gcode, run, run_printer

SCALE = 6.0  # at a higher scale, the minimum delay of 4 s of wall time would exceed these times


@pytest.mark.system
@pytest.mark.parametrize("is_killed", [False, True])
def test_shorted_nozzle_cuts_the_mains_once(tmp_path: Path, is_killed: bool):
    """Cut the mains even if the agent is killed after the finding; the next agent runs the command."""
    run_log, fifo = tmp_path / "run_log", tmp_path / "gate"
    os.mkfifo(fifo)
    script = tmp_path / "relay.sh"
    script.write_text(f'#!/bin/sh\necho "$1" >> {run_log}\nread go < {fifo}\n')
    script.chmod(0o700)
    rig = Printer(tmp_path / "agent", f"sim://{PRINTER_MODEL}")
    rig.clock, rig.power_off_cmd = Clock(SCALE, time.time()), f"{script} {{printer}}"

    async def run_scenario() -> None:
        try:
            rig.spawn()
            await rig.connect()
            await rig.wait_until_ready()
            text = make_gcode(5000).replace("M140 S40\n", "").replace("M190 S40\n", "")
            assert (await rig.start(text)).error is None
            await rig.wait_for_phase(m.PrintPhase.PRINTING)
            control(rig.folder / "emulator", "break", fault="nozzle_burns_after")
            result = await rig.wait_for(lambda s: s.alarm is not None)
            assert "went up to" in str(result.alarm) and result.nozzle is not None
            if is_killed:
                assert rig.process is not None
                rig.process.send_signal(signal.SIGKILL)
                rig.process.wait(10.0)
                await rig.client.close()
                rig.spawn()
                await rig.connect()
            # While the command hangs, the loop continues to read.
            snapshot = await rig.wait_for(lambda s: run_log.exists() and s.nozzle is not None)
            assert snapshot.print is not None and snapshot.print.phase is m.PrintPhase.ENDING
            old_c = snapshot.nozzle.now_c if snapshot.nozzle else 0.0
            await rig.wait_for(lambda s: s.nozzle is not None and s.nozzle.now_c > old_c + 2.0)
            await asyncio.to_thread(fifo.write_text, "go\n")
            alarm_snapshot = await rig.wait_for(lambda s: "cut its mains" in str(s.alarm))
            assert str(alarm_snapshot.alarm).count("cut its mains") == 1
            assert run_log.read_text() == "um2-01\n"
        finally:
            await rig.close()

    run(run_scenario())


def test_only_faults_that_count_lines_can_be_triggered(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            with pytest.raises(PortError, match="no fault 'fire'; use one of reset_after"):
                await asyncio.to_thread(control, rig.folder / "emulator", "break", fault="fire")

    run(run_scenario())
