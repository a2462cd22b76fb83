"""Real processes: an agent, the emulator on a pty, and a client like the daemon's."""

import asyncio
import signal
import stat
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.emulator.launch import control, read_status
from drivers.remote import is_alive, spawn_agent
from printers.agent_with_emulator import (
    END_GCODE,
    PRINTER_MODEL,
    START_GCODE,
    Printer,
    make_gcode,
    run,
    run_printer,
    wait_for_emulator,
)


@pytest.mark.system
def test_print_runs_once_and_leaves_the_bed_not_clear(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            assert rig.last_snapshot is not None
            assert (rig.last_snapshot.bed_clear, rig.last_snapshot.filament) == (True, m.Filament.PARKED)
            text = make_gcode(200)
            assert (await rig.start(text)).error is None
            assert (await rig.start(text)).error is None  # a repeated command changes nothing
            done_print = await rig.wait_for_phase(m.PrintPhase.DONE)
            assert (done_print.line, done_print.progress_s, done_print.fault) == (
                done_print.lines,
                60.0,
                None,
            )
            assert (done_print.layer, done_print.layers, done_print.feature) == (1, 1, "FILL")
            assert done_print.extruded and done_print.started_s is not None and done_print.ended_s is not None
            last_snapshot = await rig.wait_for(lambda s: s.bed_clear is False)
            assert last_snapshot.heaters_off and last_snapshot.filament is m.Filament.PARKED
            assert rig.read_targets() == (0.0, 0.0)
            moves = read_status(rig.folder / "emulator").moves
            assert (await rig.start(text)).error is None  # an ended print is never printed twice
            assert (await rig.client.request(m.ForgetPrint(id=0, print_id="p-1"))).error is None
            await rig.wait_for(lambda s: s.print is None)
            assert (await rig.client.request(m.BedCleared(id=0))).error is None
            await rig.wait_for(lambda s: s.bed_clear is True and s.link is m.LinkState.READY)
            reply = await rig.start(text)  # a forgotten print is not printed again either
            assert reply.error is None
            assert reply.snapshot is not None and reply.snapshot.print is None
            assert read_status(rig.folder / "emulator").moves == moves
            assert (await rig.client.request(m.Shutdown(id=0))).error is None
            assert rig.process is not None
            assert await asyncio.to_thread(rig.process.wait, 10.0) == 0
            assert not is_alive(rig.folder)

    run(run_scenario())


@pytest.mark.system
def test_next_agent_confirms_heaters_off_and_fails_the_open_print(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            await rig.start(make_gcode(50_000))
            await rig.wait_for_phase(m.PrintPhase.PRINTING)
            assert rig.process is not None
            rig.process.kill()
            rig.process.wait(10.0)
            assert not is_alive(rig.folder)
            assert rig.read_targets() != (0.0, 0.0)  # closing the port does not switch the heaters off
            rig.spawn()
            await rig.connect()
            failed_print = await rig.wait_for_phase(m.PrintPhase.FAILED)
            assert failed_print.fault == "agent_died"
            assert failed_print.extruded
            last_snapshot = await rig.wait_until_ready()
            assert last_snapshot.heaters_off
            assert rig.read_targets() == (0.0, 0.0)

    run(run_scenario())


@pytest.mark.system
def test_print_continues_without_a_daemon_and_sigterm_ends_the_agent_afterwards(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            await rig.start(make_gcode(3000))
            running_print = await rig.wait_for_phase(m.PrintPhase.PRINTING)
            await rig.client.close()
            assert rig.process is not None
            rig.process.send_signal(signal.SIGTERM)
            await rig.connect()
            last_snapshot = await rig.wait_for(
                lambda s: s.print is not None and s.print.line > running_print.line
            )
            assert last_snapshot.agent_pid == rig.process.pid
            reply = await rig.client.request(m.Shutdown(id=0))
            assert reply.error is not None and "now" in reply.error
            await rig.client.request(m.CancelPrint(id=0, print_id="another"))
            assert (await rig.client.request(m.Hello(id=0))).snapshot.link is m.LinkState.BUSY  # type: ignore[union-attr]
            await rig.client.request(m.CancelPrint(id=0, print_id="p-1", reason="enough"))
            cancelled_print = await rig.wait_for_phase(m.PrintPhase.CANCELLED)
            assert cancelled_print.reason == "enough"
            assert cancelled_print.ended_s is not None
            assert await asyncio.to_thread(rig.process.wait, 10.0) == 0  # as the signal requested
            assert rig.read_targets() == (0.0, 0.0)
            rig.spawn()
            await rig.connect()
            last_snapshot = await rig.wait_for(lambda s: s.heaters_off)
            assert last_snapshot.filament is m.Filament.PARKED
            rig.process.send_signal(signal.SIGTERM)  # the agent is idle now
            assert await asyncio.to_thread(rig.process.wait, 10.0) == 0

    run(run_scenario())


@pytest.mark.system
def test_sigint_ends_the_print_safely_and_then_the_agent(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            await rig.start(make_gcode(50_000))
            await rig.wait_for_phase(m.PrintPhase.PRINTING)
            assert rig.process is not None
            rig.process.send_signal(signal.SIGINT)
            await rig.wait_for_phase(m.PrintPhase.CANCELLED)
            assert await asyncio.to_thread(rig.process.wait, 10.0) == 0
            assert rig.read_targets() == (0.0, 0.0)

    run(run_scenario())


@pytest.mark.system
@pytest.mark.parametrize("lines", [40, 77, 114])
def test_cancel_parks_the_filament_after_any_retraction(tmp_path: Path, lines: int):
    moves = (
        f"G1 F1500 X{50 + 9 * (i % 2)} Y{50 + i % 100} Z0.3 E{i + 1}\nG1 F900 E{i - 5.5}\n"
        f"G0 F9000 X{80 - 9 * (i % 2)}\nG1 F900 E{i + 1}\n"
        for i in range(2000)
    )

    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            await rig.start(START_GCODE.replace("S180", "S210") + "".join(moves) + END_GCODE)
            await rig.wait_for(lambda s: s.print is not None and s.print.line >= lines)
            await rig.client.request(m.CancelPrint(id=0, print_id="p-1"))
            await rig.wait_for_phase(m.PrintPhase.CANCELLED)
            last_snapshot = await rig.wait_until_ready()
            assert last_snapshot.heaters_off and last_snapshot.filament is m.Filament.PARKED
            assert wait_for_emulator(rig.folder / "emulator", lambda s: abs(s.filament_end_mm + 20.0) <= 0.5)

    run(run_scenario())


@pytest.mark.system
def test_print_is_paused_and_resumed(tmp_path: Path):
    async def run_scenario() -> None:
        # The firmware's dead-man lasts 120 s. At a higher scale, a busy machine may exceed it.
        async with run_printer(tmp_path, time_scale=30.0) as rig:
            await rig.start(make_gcode(400))
            await rig.wait_for(lambda s: s.print is not None and s.print.line >= 100)
            await rig.client.request(m.PausePrint(id=0, print_id="p-1"))
            paused_print = await rig.wait_for_phase(m.PrintPhase.PAUSED)
            await rig.wait_for(lambda s: s.filament is m.Filament.PARKED)
            assert await asyncio.to_thread(
                wait_for_emulator, rig.folder / "emulator", lambda s: s.nozzle_target_c == 0
            )
            assert rig.read_targets() == (0.0, 40.0)
            await rig.wait_for(lambda s: s.print is not None and s.print.pause_ends_s is not None)
            await rig.client.request(m.ResumePrint(id=0, print_id="p-1"))
            done_print = await rig.wait_for_phase(m.PrintPhase.DONE)
            assert done_print.line == done_print.lines > paused_print.line
            assert done_print.pause_ends_s is None
            assert rig.read_targets() == (0.0, 0.0)

    run(run_scenario())


@pytest.mark.system
def test_pulled_cable_fails_the_print_and_heaters_are_confirmed_off_later(
    tmp_path: Path,
):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            await rig.start(make_gcode(50_000))
            await rig.wait_for_phase(m.PrintPhase.PRINTING)
            old_tty = read_status(rig.folder / "emulator").tty
            control(rig.folder / "emulator", "unplug")
            await rig.wait_for(lambda s: s.reason is not None)
            assert rig.read_targets() != (0.0, 0.0)
            control(rig.folder / "emulator", "plug")
            failed_print = await rig.wait_for_phase(m.PrintPhase.FAILED)
            assert failed_print.fault == "port_lost"
            last_snapshot = await rig.wait_for(lambda s: s.link is not m.LinkState.BUSY)
            assert last_snapshot.heaters_off
            assert rig.read_targets() == (0.0, 0.0)
            assert read_status(rig.folder / "emulator").tty != old_tty

    run(run_scenario())


@pytest.mark.system
def test_swapped_cables_are_reported_until_a_person_confirms(tmp_path: Path):
    async def run_scenario() -> None:
        rig = Printer(tmp_path / "agent", f"sim://{PRINTER_MODEL}?home_offset_hundredths_mm=100")
        for print_id, home_offset, phase in (
            ("p-1", 100, "done"),
            ("p-2", 250, "failed"),
            ("p-3", 250, "done"),
        ):
            rig.url = f"sim://{PRINTER_MODEL}?home_offset_hundredths_mm={home_offset}"
            rig.spawn()
            try:
                await rig.connect()
                if print_id == "p-3":
                    await rig.wait_for(lambda s: s.link is m.LinkState.FAULT)
                    assert (await rig.client.request(m.BedCleared(id=0))).error is None
                await rig.wait_until_ready()
                assert (await rig.start(make_gcode(20), print_id)).error is None
                ended_print = await rig.wait_for_phase(m.PrintPhase(phase))
                assert ended_print.fault == ("wrong_printer" if phase == "failed" else None)
                assert ended_print.extruded == (phase == "done")
                if phase == "done":
                    await rig.client.request(m.ForgetPrint(id=0, print_id=print_id))
            finally:
                await rig.close()

    run(run_scenario())


@pytest.mark.system
def test_file_with_another_hash_heats_nothing(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            await rig.start(make_gcode(10), sha256="0" * 64)
            failed_print = await rig.wait_for_phase(m.PrintPhase.FAILED)
            assert failed_print.fault == "bad_file" and not failed_print.extruded
            await rig.start(make_gcode(10) + "M0\n", print_id="p-2")
            failed_print = (
                await rig.wait_for(lambda s: s.print is not None and s.print.print_id == "p-2")
            ).print  # type: ignore[assignment]
            assert failed_print.fault == "bad_file" and "M0" in str(failed_print.reason)
            reply = await rig.start(make_gcode(10), print_id="../p")
            assert reply.error is not None
            assert rig.read_targets() == (0.0, 0.0)

    run(run_scenario())


@pytest.mark.system
def test_checksum_errors_and_lost_oks_are_recovered(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path, "?checksum=0.004&drop_ok=0.0005&seed=5") as rig:
            await rig.start(make_gcode(1000))
            done_print = await rig.wait_for_phase(m.PrintPhase.DONE)
            assert done_print.line == done_print.lines
            assert read_status(rig.folder / "emulator").errors > 0

    run(run_scenario())


@pytest.mark.system
def test_printer_switched_off_is_absent_and_reconnects(tmp_path: Path):
    async def run_scenario() -> None:
        async with run_printer(tmp_path) as rig:
            control(rig.folder / "emulator", "power_off")
            snapshot = await rig.wait_for(lambda s: s.link is m.LinkState.ABSENT)
            assert snapshot.reason is not None
            reply = await rig.start(make_gcode(10))
            assert reply.error is not None and "absent" in reply.error
            await rig.wait_until_ready()  # a simulated printer is switched on again by opening its port

    run(run_scenario())


@pytest.mark.system
def test_second_agent_of_a_printer_is_refused_and_the_socket_is_private(tmp_path: Path):
    async def run_scenario() -> None:
        deep_folder = tmp_path / ("x" * 60) / ("y" * 60)
        async with run_printer(deep_folder) as rig:
            assert len(str(rig.folder / "agent.sock")) > 107
            assert stat.S_IMODE((rig.folder / "agent.sock").stat().st_mode) == 0o600
            assert is_alive(rig.folder)
            second_agent = spawn_agent("um2-01", PRINTER_MODEL, rig.url, rig.folder, rig.clock)
            assert await asyncio.to_thread(second_agent.wait, 20.0) == 1
            assert (await rig.client.request(m.Hello(id=0))).snapshot is not None

    run(run_scenario())
