"""An agent and its port: opening, monitoring, and boards whose heat cannot be stopped."""

import asyncio
import json
import os
import pty
import tty
from pathlib import Path
from typing import Any

import pytest

from agent_with_emulator import MODEL, Printer, everything, gcode, printer, run
from drivers import messages as m
from drivers.agent.board import Board
from drivers.emulator.launch import alive as emulator_alive
from drivers.emulator.launch import control, launch, read_status
from drivers.errors import Fault
from drivers.firmware import ULTIMAKER2
from drivers.printers import PROFILES
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from drivers.records import JOURNAL
from drivers.remote import is_alive
from drivers.session import Session, SessionContext


@pytest.mark.system
def test_missing_port_is_reported_as_absent_and_the_agent_continues(tmp_path: Path):
    async def story() -> None:
        one = Printer(tmp_path / "agent", str(tmp_path / "no-such-tty"))
        one.spawn()
        try:
            await one.connect()
            said = await one.until(lambda s: s.link is m.LinkState.ABSENT)
            assert "plugged in" in str(said.reason)
            assert is_alive(one.folder)
        finally:
            await one.close()

    run(story())


@pytest.mark.system
def test_port_is_opened_after_a_person_confirms_the_printer_idle(
    tmp_path: Path,
):
    tty = tmp_path / "emulator" / "tty"
    one = Printer(tmp_path / "agent", str(tty))

    def link_open() -> bool:
        return read_status(tmp_path / "emulator").link_open

    async def story() -> None:
        try:
            launch(f"sim://{MODEL}", tmp_path / "emulator", one.clock)
            one.spawn()
            await one.connect()
            said = await one.until(lambda s: s.link is m.LinkState.FAULT)
            assert "does not print" in str(said.reason) and said.bed_unknown_reason is not None
            assert not link_open()
            refused = await one.start(gcode(10))
            assert refused.error is not None and not link_open()
            assert (await one.client.request(m.BedCleared(id=0))).error is None
            ready = await one.ready()
            assert ready.reset_verified and ready.bed_unknown_reason is None
            assert one.process is not None
            one.process.kill()
            one.process.wait(10.0)
            one.spawn()  # DTR has been up since: opening changes nothing
            await one.connect()
            ready = await one.ready()
            assert ready.bed_unknown_reason is not None
            control(tmp_path / "emulator", "power_off")
            await one.until(lambda s: s.link is m.LinkState.ABSENT)
            launch(f"sim://{MODEL}", tmp_path / "emulator", one.clock)  # plugged in anew
            await one.until(lambda s: s.link is m.LinkState.FAULT)
            assert not link_open()
            assert (await one.client.request(m.Commission(id=0))).error is None
            await one.ready()
        finally:
            await one.close()
            if emulator_alive(tmp_path / "emulator"):
                control(tmp_path / "emulator", "power_off")

    run(story())


@pytest.mark.system
def test_board_without_reset_is_reported_and_cooled_by_command(tmp_path: Path):
    emulator = tmp_path / "emulator"
    one = Printer(tmp_path / "agent", str(emulator / "tty"))

    async def story() -> None:
        launch(f"sim://{MODEL}?no_reset=1", emulator, one.clock)
        one.spawn()
        try:
            await one.connect()
            said = await one.until(lambda s: s.link is m.LinkState.FAULT)
            assert (await one.start(gcode(10))).error is not None
            assert (await one.client.request(m.BedCleared(id=0))).error is None
            said = await one.ready()
            assert not said.reset_verified and "DTR" in str(said.reason)
            assert (await one.start(gcode(10))).error is None
            await one.phase(m.PrintPhase.DONE)
            assert (await one.client.request(m.ForgetPrint(id=0, print_id="p-1"))).error is None
            assert (await one.start(gcode(3000), "p-2")).error is None
            await one.phase(m.PrintPhase.PRINTING)
            assert one.process is not None
            one.process.kill()
            one.process.wait(10.0)
            one.spawn()
            await one.connect()
            left = await one.phase(m.PrintPhase.FAILED)
            assert left.fault == Fault.AGENT_DIED
            status = read_status(emulator)
            assert (status.nozzle_target_c, status.bed_target_c, status.resets) == (0.0, 0.0, 0)
        finally:
            await one.close()
            control(emulator, "power_off")

    run(story())


@pytest.mark.system
def test_heat_left_by_a_print_is_ended_by_command_without_a_reset(tmp_path: Path):
    emulator, url = tmp_path / "emulator", str(tmp_path / "emulator" / "tty")
    one = Printer(tmp_path / "agent", url)
    (tmp_path / "agent").mkdir()
    (tmp_path / "agent" / JOURNAL).write_text(json.dumps({"hot": True, "reset_refuted": url}) + "\n")

    async def story() -> None:
        launch(f"sim://{MODEL}?no_reset=1", emulator, one.clock)
        control(emulator, "set_nozzle", target_c=180.0)
        one.spawn()
        try:
            await one.connect()
            await one.until(lambda s: s.heaters_off)
            assert read_status(emulator).nozzle_target_c == 0.0
        finally:
            await one.close()
            control(emulator, "power_off")

    run(story())


@pytest.mark.system
@pytest.mark.parametrize(
    ("deed", "seen"),
    [
        ({"command": "move", "z_mm": 50.0}, "moved"),
        ({"command": "set_nozzle", "target_c": 180.0}, "heater"),
        ({"command": "print_sd"}, "SD card"),
        ({"command": "reset"}, "reset"),
    ],
)
def test_manual_use_of_an_idle_printer_makes_its_bed_unknown(tmp_path: Path, deed: dict[str, Any], seen: str):
    async def story() -> None:
        async with printer(tmp_path) as one:
            idle = await one.until(lambda s: s.link is m.LinkState.READY and s.heaters_off)
            assert idle.bed_unknown_reason is None
            await asyncio.to_thread(control, one.folder / "emulator", **deed)
            doubted = await one.until(lambda s: s.bed_unknown_reason is not None)
            assert seen in str(doubted.bed_unknown_reason) or seen == "SD card"
            refused = await one.start(gcode(10))
            assert refused.error is not None
            if seen == "SD card":
                await one.until(lambda s: "SD" in str(s.reason))
                refused = await one.client.request(m.BedCleared(id=0))
                assert "SD card" in str(refused.error)
                assert read_status(one.folder / "emulator").nozzle_target_c > 0  # nobody has reset it

    run(story())


@pytest.mark.system
def test_hot_printer_that_disconnects_has_its_mains_cut_and_is_reported(tmp_path: Path):
    one = Printer(tmp_path / "agent", str(tmp_path / "emulator" / "tty"))
    relay = tmp_path / "relay.sh"
    relay.write_text(f'#!/bin/sh\necho "$1" >> {tmp_path}/cut\n')
    relay.chmod(0o700)
    one.power_off_cmd = f"{relay} {{printer}}"

    async def story() -> None:
        try:
            launch(f"sim://{MODEL}", tmp_path / "emulator", one.clock)
            one.spawn()
            await one.connect()
            await one.until(lambda s: s.link is m.LinkState.FAULT)
            await one.client.request(m.BedCleared(id=0))
            await one.ready()
            assert (await one.start(gcode(50_000))).error is None
            await one.phase(m.PrintPhase.PRINTING)
            control(tmp_path / "emulator", "power_off")
            failed = await one.phase(m.PrintPhase.FAILED)
            assert failed.fault == "port_lost" and "mains" in str(failed.reason)
            assert (tmp_path / "cut").read_text() == "um2-01\n"
            assert not (await one.until(lambda s: s.link is m.LinkState.ABSENT)).heaters_off
            launch(f"sim://{MODEL}", tmp_path / "emulator", one.clock)
            back = await one.until(lambda s: s.heaters_off)  # heat of ours may be on there: it is opened
            assert back.link is m.LinkState.FAULT and "mains" in str(back.reason)
        finally:
            await one.close()
            if emulator_alive(tmp_path / "emulator"):
                control(tmp_path / "emulator", "power_off")

    run(story())


def test_last_command_to_a_board_without_reset_is_sent_over_a_full_wire(tmp_path: Path):
    """End the agent by an internal error while a command waits for a board that does not read."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    url = os.ttyname(slave)
    os.close(slave)
    one = Printer(tmp_path / "agent", url)
    board = Board(url, ULTIMAKER2_PLUS, tmp_path, one.clock, lambda: None, lambda _: None)
    board.state.hot, board.state.reset_failed = True, url
    board.open()
    session = Session(
        SessionContext(board.link, None, PROFILES[MODEL], m.Filament.PARKED, board.pace, one.clock.now())
    )
    board.session = session
    port = board._port
    assert port is not None
    try:
        while not port.write_pending:
            port.write(b"G1 X1 Y1\n" * 100)
        board.switch_off()
        # What the board has not taken yet goes for the next word: how many it hears is up to its own pace.
        assert everything(master).endswith(ULTIMAKER2.abort_unnumbered)
    finally:
        board.close()
        os.close(master)
