"""An agent and its port: opening, monitoring, and boards whose heaters cannot be switched off."""

import asyncio
import json
import os
import pty
import tty
from pathlib import Path
from typing import Any

import pytest

from drivers import messages as m
from drivers.agent.board import Board
from drivers.emulator.launch import control, launch, read_status
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.errors import Fault
from drivers.firmware import ULTIMAKER2
from drivers.printers import PROFILES
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from drivers.records import JOURNAL
from drivers.remote import is_alive
from drivers.session import Session, SessionContext
from printers.agent_with_emulator import (
    PRINTER_MODEL,
    Printer,
    make_gcode,
    read_buffered_bytes,
    run,
    run_printer,
)


@pytest.mark.system
def test_missing_port_is_reported_as_absent_and_the_agent_continues(tmp_path: Path):
    async def run_scenario() -> None:
        rig = Printer(tmp_path / "agent", str(tmp_path / "no-such-tty"))
        rig.spawn()
        try:
            await rig.connect()
            snapshot = await rig.wait_for(lambda s: s.link is m.LinkState.ABSENT)
            assert "plugged in" in str(snapshot.reason)
            assert is_alive(rig.folder)
        finally:
            await rig.close()

    run(run_scenario())


@pytest.mark.system
def test_port_is_opened_after_a_person_confirms_that_the_printer_is_idle(
    tmp_path: Path,
):
    rig = Printer(tmp_path / "agent", str(tmp_path / "emulator" / "tty"))

    def is_link_open() -> bool:
        return read_status(tmp_path / "emulator").link_open

    async def run_scenario() -> None:
        try:
            launch(f"sim://{PRINTER_MODEL}", tmp_path / "emulator", rig.clock)
            rig.spawn()
            await rig.connect()
            snapshot = await rig.wait_for(lambda s: s.link is m.LinkState.FAULT)
            assert "is not printing" in str(snapshot.reason) and snapshot.bed_unknown_reason is not None
            assert not is_link_open()
            reply = await rig.start(make_gcode(10))
            assert reply.error is not None and not is_link_open()
            assert (await rig.client.request(m.BedCleared(id=0))).error is None
            snapshot = await rig.wait_until_ready()
            assert snapshot.reset_verified and snapshot.bed_unknown_reason is None
            assert rig.process is not None
            rig.process.kill()
            rig.process.wait(10.0)
            rig.spawn()  # DTR is still set, so opening the port changes nothing
            await rig.connect()
            snapshot = await rig.wait_until_ready()
            assert snapshot.bed_unknown_reason is not None
            control(tmp_path / "emulator", "power_off")
            await rig.wait_for(lambda s: s.link is m.LinkState.ABSENT)
            launch(f"sim://{PRINTER_MODEL}", tmp_path / "emulator", rig.clock)  # plug the printer in again
            await rig.wait_for(lambda s: s.link is m.LinkState.FAULT)
            assert not is_link_open()
            assert (await rig.client.request(m.Commission(id=0))).error is None
            await rig.wait_until_ready()
        finally:
            await rig.close()
            if emulator_is_running(tmp_path / "emulator"):
                control(tmp_path / "emulator", "power_off")

    run(run_scenario())


@pytest.mark.system
def test_board_without_reset_is_reported_and_cooled_by_command(tmp_path: Path):
    emulator = tmp_path / "emulator"
    rig = Printer(tmp_path / "agent", str(emulator / "tty"))

    async def run_scenario() -> None:
        launch(f"sim://{PRINTER_MODEL}?no_reset=1", emulator, rig.clock)
        rig.spawn()
        try:
            await rig.connect()
            snapshot = await rig.wait_for(lambda s: s.link is m.LinkState.FAULT)
            assert (await rig.start(make_gcode(10))).error is not None
            assert (await rig.client.request(m.BedCleared(id=0))).error is None
            snapshot = await rig.wait_until_ready()
            assert not snapshot.reset_verified and "DTR" in str(snapshot.reason)
            assert (await rig.start(make_gcode(10))).error is None
            await rig.wait_for_phase(m.PrintPhase.DONE)
            assert (await rig.client.request(m.ForgetPrint(id=0, print_id="p-1"))).error is None
            assert (await rig.start(make_gcode(3000), "p-2")).error is None
            await rig.wait_for_phase(m.PrintPhase.PRINTING)
            assert rig.process is not None
            rig.process.kill()
            rig.process.wait(10.0)
            rig.spawn()
            await rig.connect()
            failed_print = await rig.wait_for_phase(m.PrintPhase.FAILED)
            assert failed_print.fault == Fault.AGENT_DIED
            status = read_status(emulator)
            assert (status.nozzle_target_c, status.bed_target_c, status.resets) == (0.0, 0.0, 0)
        finally:
            await rig.close()
            control(emulator, "power_off")

    run(run_scenario())


@pytest.mark.system
def test_heaters_left_on_by_a_print_are_switched_off_by_command_without_a_reset(tmp_path: Path):
    emulator, url = tmp_path / "emulator", str(tmp_path / "emulator" / "tty")
    rig = Printer(tmp_path / "agent", url)
    (tmp_path / "agent").mkdir()
    (tmp_path / "agent" / JOURNAL).write_text(json.dumps({"hot": True, "reset_refuted": url}) + "\n")

    async def run_scenario() -> None:
        launch(f"sim://{PRINTER_MODEL}?no_reset=1", emulator, rig.clock)
        control(emulator, "set_nozzle", target_c=180.0)
        rig.spawn()
        try:
            await rig.connect()
            await rig.wait_for(lambda s: s.heaters_off)
            assert read_status(emulator).nozzle_target_c == 0.0
        finally:
            await rig.close()
            control(emulator, "power_off")

    run(run_scenario())


@pytest.mark.system
@pytest.mark.parametrize(
    ("action", "expected_text"),
    [
        ({"command": "move", "z_mm": 50.0}, "moved"),
        ({"command": "set_nozzle", "target_c": 180.0}, "heater"),
        ({"command": "print_sd"}, "SD card"),
        ({"command": "reset"}, "reset"),
    ],
)
def test_manual_use_of_an_idle_printer_makes_its_bed_unknown(
    tmp_path: Path, action: dict[str, Any], expected_text: str
):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            idle_snapshot = await rig.wait_for(lambda s: s.link is m.LinkState.READY and s.heaters_off)
            assert idle_snapshot.bed_unknown_reason is None
            await asyncio.to_thread(control, rig.folder / "emulator", **action)
            snapshot = await rig.wait_for(lambda s: s.bed_unknown_reason is not None)
            assert expected_text in str(snapshot.bed_unknown_reason) or expected_text == "SD card"
            reply = await rig.start(make_gcode(10))
            assert reply.error is not None
            if expected_text == "SD card":
                await rig.wait_for(lambda s: "SD" in str(s.reason))
                reply = await rig.client.request(m.BedCleared(id=0))
                assert "SD card" in str(reply.error)
                assert read_status(rig.folder / "emulator").nozzle_target_c > 0  # the board was not reset

    run(run_scenario())


@pytest.mark.system
def test_hot_printer_that_disconnects_has_its_mains_cut_and_is_reported(tmp_path: Path):
    rig = Printer(tmp_path / "agent", str(tmp_path / "emulator" / "tty"))
    relay = tmp_path / "relay.sh"
    relay.write_text(f'#!/bin/sh\necho "$1" >> {tmp_path}/cut\n')
    relay.chmod(0o700)
    rig.power_off_cmd = f"{relay} {{printer}}"

    async def run_scenario() -> None:
        try:
            launch(f"sim://{PRINTER_MODEL}", tmp_path / "emulator", rig.clock)
            rig.spawn()
            await rig.connect()
            await rig.wait_for(lambda s: s.link is m.LinkState.FAULT)
            await rig.client.request(m.BedCleared(id=0))
            await rig.wait_until_ready()
            assert (await rig.start(make_gcode(50_000))).error is None
            await rig.wait_for_phase(m.PrintPhase.PRINTING)
            control(tmp_path / "emulator", "power_off")
            failed_print = await rig.wait_for_phase(m.PrintPhase.FAILED)
            assert failed_print.fault == "port_lost" and "mains" in str(failed_print.reason)
            assert (tmp_path / "cut").read_text() == "um2-01\n"
            assert not (await rig.wait_for(lambda s: s.link is m.LinkState.ABSENT)).heaters_off
            launch(f"sim://{PRINTER_MODEL}", tmp_path / "emulator", rig.clock)
            # The heaters may still be on when the port is opened.
            snapshot = await rig.wait_for(lambda s: s.heaters_off)
            assert snapshot.link is m.LinkState.FAULT and "mains" in str(snapshot.reason)
        finally:
            await rig.close()
            if emulator_is_running(tmp_path / "emulator"):
                control(tmp_path / "emulator", "power_off")

    run(run_scenario())


def test_last_command_to_a_board_without_reset_is_sent_over_a_full_wire(tmp_path: Path):
    """End the agent with an internal error while a command waits for a board that does not read."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    url = os.ttyname(slave)
    os.close(slave)
    rig = Printer(tmp_path / "agent", url)
    board = Board(url, ULTIMAKER2_PLUS, tmp_path, rig.clock, lambda: None, lambda _: None)
    board.state.hot, board.state.failed_reset_port = True, url
    board.open()
    session = Session(
        SessionContext(
            board.link, None, PROFILES[PRINTER_MODEL], m.Filament.PARKED, board.pace, rig.clock.now()
        )
    )
    board.session = session
    port = board._port
    assert port is not None
    try:
        while not port.has_unsent_bytes:
            port.write(b"G1 X1 Y1\n" * 100)
        board.switch_off_heaters()
        # The command replaces the data that the board has not read, whose amount depends on the host.
        assert read_buffered_bytes(master).endswith(ULTIMAKER2.unnumbered_abort)
    finally:
        board.close()
        os.close(master)
