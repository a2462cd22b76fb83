"""State of the filament, kept across restarts of the agent."""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.agent.idle_watch import FilamentWatch
from drivers.emulator.launch import Command, control, launch
from drivers.records import JOURNAL
from printers.agent_with_emulator import DEADLINE_S, PRINTER_MODEL, Printer, make_gcode, run

REST_POSITION = b"X:0.00 Y:224.50 Z:205.00 E:-20.00 Count X:0.00 Y:224.50 Z:205.00"
OTHER_POSITION = REST_POSITION.replace(b"E:-20.00", b"E:80.00")


@asynccontextmanager
async def print_file(folder: Path) -> AsyncIterator[Printer]:
    """Print a file over a port that does not report the bed, and end the agent; yield the printer."""
    emulator = folder / "emulator"
    printer = Printer(folder / "agent", str(emulator / "tty"))
    launch(f"sim://{PRINTER_MODEL}", emulator, printer.clock)
    tty_fd = None
    try:
        printer.spawn()
        await printer.connect()
        await printer.wait_for(lambda s: s.link is m.LinkState.FAULT)
        bed_cleared = m.BedCleared(id=0, filament=m.Filament.PARKED)
        assert (await printer.client.request(bed_cleared)).error is None
        await printer.wait_until_ready()
        assert (await printer.start(make_gcode(10))).error is None
        await printer.wait_for_phase(m.PrintPhase.DONE)
        await printer.wait_for(lambda s: s.link is m.LinkState.READY and s.filament is m.Filament.PARKED)
        assert (await printer.client.request(m.ForgetPrint(id=0, print_id="p-1"))).error is None
        await _wait_for_rest_position(printer, '"X:')
        # DTR stays set while no agent has the port open.
        tty_fd = os.open(emulator / "tty", os.O_RDWR | os.O_NOCTTY)
        await _shut_down_agent(printer)
        yield printer
    finally:
        await printer.close()
        control(emulator, Command.POWER_OFF)
        if tty_fd is not None:
            os.close(tty_fd)


async def _wait_for_rest_position(printer: Printer, record: str) -> None:
    """Wait until the last record of the agent's journal has this rest position."""
    async with asyncio.timeout(DEADLINE_S):
        while f'"rest": {record}' not in (printer.folder / JOURNAL).read_text().splitlines()[-1]:
            await asyncio.sleep(0.02)


async def _shut_down_agent(printer: Printer) -> None:
    assert (await printer.client.request(m.Shutdown(id=0))).error is None
    assert printer.process is not None
    await asyncio.to_thread(printer.process.wait, 30.0)
    await printer.client.close()


async def _restart_agent(printer: Printer) -> m.Snapshot:
    printer.client = type(printer.client)(printer.folder)
    printer.spawn()
    await printer.connect()
    return await printer.wait_for(lambda s: s.nozzle is not None)


@pytest.mark.system
def test_filament_is_parked_after_a_restart_of_the_agent(tmp_path: Path) -> None:
    async def run_scenario() -> None:
        async with print_file(tmp_path) as printer:
            for _ in range(2):
                first_snapshot = await _restart_agent(printer)
                assert first_snapshot.bed_unknown_reason is not None
                known_snapshot = await printer.wait_for(lambda s: s.filament is not m.Filament.UNKNOWN)
                assert known_snapshot.filament is m.Filament.PARKED
                assert known_snapshot.bed_unknown_reason is not None  # the bed still needs an inspection
                await _shut_down_agent(printer)

    run(run_scenario())


@pytest.mark.system
@pytest.mark.parametrize("action", [{"command": "move", "z_mm": 50.0}, {"command": "reset"}], ids=str)
def test_filament_is_unknown_if_the_printer_was_used_while_no_agent_watched(
    tmp_path: Path, action: dict[str, object]
) -> None:
    async def run_scenario() -> None:
        async with print_file(tmp_path) as printer:
            await asyncio.to_thread(control, tmp_path / "emulator", **action)
            await _restart_agent(printer)
            await _wait_for_rest_position(printer, "null")
            assert printer.last_snapshot is not None and printer.last_snapshot.filament is m.Filament.UNKNOWN
            bed_cleared = m.BedCleared(id=0, filament=m.Filament.AT_NOZZLE)
            assert (await printer.client.request(bed_cleared)).error is None
            await printer.wait_for(lambda s: s.filament is m.Filament.AT_NOZZLE)

    run(run_scenario())


def test_position_counts_only_after_a_print_and_until_a_reset() -> None:
    watch = FilamentWatch()
    watch.trust_journal()
    watch.judge_position(REST_POSITION)
    # A board that has just started reports the same position each time.
    assert watch.is_certain and watch.rest_position is None
    watch.note_print()
    watch.judge_position(REST_POSITION)
    assert watch.rest_position == REST_POSITION.decode()
    watch.note_reset()
    assert watch.is_certain and watch.rest_position is None
    watch.judge_position(REST_POSITION)
    assert watch.rest_position is None


@pytest.mark.parametrize(("position", "is_certain"), [(REST_POSITION, True), (OTHER_POSITION, False)])
def test_next_agent_knows_the_filament_if_the_printer_has_not_moved(
    position: bytes, is_certain: bool
) -> None:
    watch = FilamentWatch(rest_position=REST_POSITION.decode())
    assert not watch.is_certain
    watch.judge_position(position)
    assert (watch.is_certain, watch.rest_position) == (
        is_certain,
        REST_POSITION.decode() if is_certain else None,
    )
    watch.judge_position(REST_POSITION)
    assert watch.is_certain is is_certain  # an unknown state needs a person's answer
    watch.distrust_journal()
    assert (watch.is_certain, watch.rest_position) == (False, None)
