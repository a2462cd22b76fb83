"""Emergency stop with real agents that hang."""

import asyncio
import hashlib
import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time
import tty
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import control, launch, read_status
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.firmware import ULTIMAKER2
from drivers.locks import AGENT_LOCK, acquire_lock, find_holder, is_locked, kill_holder, write_pid
from drivers.records import ESTOP_REASON, Journal, StartFile
from drivers.remote import AgentClient, is_alive, spawn_agent
from drivers.safety import StopResult, StopTarget, estop, heater_watch, list_targets, stop_printer
from printers.agent_with_emulator import Printer, wait_for_emulator

MODEL = "ultimaker2_plus"
HEAD = "G21\nG90\nM82\nM107\nM140 S60\nG28\nM190 S60\nM109 S210\nG1 F2400 Z20\nG92 E0\nG1 F47 E7.8\nG92 E0\n"
SCALE = 120.0
DEADLINE_S = 120.0


async def start_hot_print(folder: Path, process: subprocess.Popen[bytes]) -> None:
    """Start a print, and wait until it extrudes."""
    text = HEAD + "".join(
        f"G1 F6000 X{50 + 100 * (i % 2)} Y{50 + i % 100} Z0.3 E{i * 0.5}\n" for i in range(50_000)
    )
    path = folder.parent / "a.gcode"
    path.write_text(text)
    client = AgentClient(folder)
    await client.connect()
    is_requested = False
    async with asyncio.timeout(DEADLINE_S):
        async for snapshot in client.receive_snapshots():
            if snapshot.link is m.LinkState.READY and not is_requested:
                is_requested = True
                sha256 = hashlib.sha256(text.encode()).hexdigest()
                start_request = m.StartPrint(
                    id=0,
                    print_id="p-1",
                    gcode=str(path),
                    sha256=sha256,
                    print_time_s=60.0,
                    filament=m.Filament.PARKED,
                )
                assert (await client.request(start_request)).error is None
            if snapshot.print is not None and snapshot.print.phase is m.PrintPhase.PRINTING:
                break
    assert process.poll() is None
    await client.close()


async def find_ended_print(folder: Path) -> m.PrintSnapshot:
    """Return the stopped print as the next agent reports it."""
    client = AgentClient(folder)
    await client.connect()
    try:
        async with asyncio.timeout(DEADLINE_S):
            async for snapshot in client.receive_snapshots():
                if snapshot.print is not None and snapshot.print.phase.ended:
                    return snapshot.print
    finally:
        await client.close()
    raise AssertionError("the agent is gone")


@pytest.mark.system
def test_printer_with_a_hung_agent_is_stopped_and_needs_attention_afterwards(
    tmp_path: Path,
):
    folder = tmp_path / "state" / "agents" / "um2-01"
    url = f"sim://{MODEL}"
    process = spawn_agent("um2-01", MODEL, url, folder, Clock(SCALE, time.time()))
    try:
        asyncio.run(start_hot_print(folder, process))
        process.send_signal(signal.SIGSTOP)
        assert read_status(folder / "emulator").nozzle_target_c == 210.0
        command = [Path(sys.executable).with_name("farm"), "estop", "--json"]
        command += ["--state", tmp_path / "state", "--fleet", tmp_path / "none.yaml"]
        finished_process = subprocess.run(command, check=False, capture_output=True, timeout=60)
        assert finished_process.returncode == 0, finished_process.stderr
        [row] = json.loads(finished_process.stdout)["printers"]
        assert (row["printer"], row["seen_off"]) == ("um2-01", True)
        assert 0.0 < row["reset_after_s"] < 10.0
        status = read_status(folder / "emulator")
        assert (status.nozzle_target_c, status.bed_target_c) == (0.0, 0.0)
        assert process.wait(10.0) == -signal.SIGKILL
        assert Journal(folder / "journal.jsonl").state.board.attention_reason == ESTOP_REASON
        assert not is_alive(folder)
        process = spawn_agent("um2-01", MODEL, url, folder, Clock(SCALE, time.time()))
        snapshot = asyncio.run(find_ended_print(folder))
        assert (snapshot.phase, snapshot.fault) == (m.PrintPhase.FAILED, "estop")
        assert snapshot.reason == "a person stopped it by `farm estop`"
    finally:
        process.kill()
        process.wait(10.0)
        if emulator_is_running(folder / "emulator"):
            control(folder / "emulator", "power_off")


@pytest.mark.system
@pytest.mark.parametrize("agent_dies", [False, True], ids=["estop", "its agent dies"])
def test_moves_end_and_heaters_are_off_on_a_board_that_dtr_does_not_reset(tmp_path: Path, agent_dies: bool):
    """Fill the planner with moves of 200 s."""
    emulator = tmp_path / "emulator"
    printer = Printer(tmp_path / "state" / "agents" / "um2-01", str(emulator / "tty"))
    # The first move is fast, because the agent ends a print after ten seconds without a temperature.
    slow_gcode = HEAD + "G1 F6000 X50 Y50 Z0.3\n"
    slow_gcode += "".join(f"G1 F6 X{50 + 20 * (i % 2)} Y50 Z0.3 E{i * 0.1}\n" for i in range(1000))

    async def print_slow_gcode() -> None:
        await printer.connect()
        await printer.wait_for(lambda s: s.link is m.LinkState.FAULT)
        assert (await printer.client.request(m.BedCleared(id=0))).error is None
        await printer.wait_until_ready()
        assert (await printer.start(slow_gcode)).error is None
        await printer.wait_for_phase(m.PrintPhase.PRINTING)
        assert await asyncio.to_thread(
            wait_for_emulator, emulator, lambda status: status.position_mm[2] < 1.0
        )
        await printer.client.close()

    async def wait_until_failed() -> None:
        printer.spawn()
        await printer.connect()
        assert (await printer.wait_for_phase(m.PrintPhase.FAILED)).fault == "agent_died"
        await printer.client.close()

    try:
        launch(f"sim://{MODEL}?no_reset=1", emulator, printer.clock)
        printer.spawn()
        asyncio.run(print_slow_gcode())
        assert printer.process is not None
        printer.process.send_signal(signal.SIGKILL if agent_dies else signal.SIGSTOP)
        if agent_dies:
            printer.process.wait(10.0)
            asyncio.run(wait_until_failed())
        else:
            # Stop it in this process, because on a busy host the dead-man timer may act before `farm estop`.
            [target] = list_targets(printer.folder.parent).values()
            result = stop_printer(target, report_timeout_s=100.0)
            assert (result.is_confirmed_off, result.is_still) == (True, True), result.text
            assert "not reset" in result.text and "stands still" in result.text
        old_status = read_status(emulator)
        assert (old_status.nozzle_target_c, old_status.bed_target_c) == (0.0, 0.0)
        # On a busy host, the firmware's dead-man timer, 20 s at this scale, may act first.
        assert old_status.resets <= 1
        # Wait for the time of two and a half moves.
        assert wait_for_emulator(emulator, lambda status: status.time_s > old_status.time_s + 500.0)
        assert read_status(emulator).position_mm == old_status.position_mm
    finally:
        if printer.process is not None:
            printer.process.kill()
            printer.process.wait(10.0)
        control(emulator, "power_off")


@pytest.mark.parametrize(("relay", "message"), [("exit 0", "cut its"), ("echo stuck >&2; exit 3", "stuck")])
def test_mains_are_cut_if_a_board_does_not_confirm_that_its_heaters_are_off(
    tmp_path: Path, relay: str, message: str
):
    master, slave = pty.openpty()
    tty.setraw(slave)
    port = os.ttyname(slave)
    os.close(slave)
    script = tmp_path / "relay.sh"
    script.write_text(f'#!/bin/sh\necho "$1" > {tmp_path}/cut\n{relay}\n')
    script.chmod(0o700)
    try:
        target = StopTarget("um2-01", port, tmp_path / "um2-01", ULTIMAKER2, f"{script} {{printer}}")
        result = stop_printer(target, report_timeout_s=0.05)
        assert not result.is_confirmed_off and result.reset_s is not None
        assert "reports no temperatures" in result.text and message in result.text
        assert (tmp_path / "cut").read_text() == "um2-01\n"
    finally:
        os.close(master)


@pytest.mark.parametrize("has_listener", [True, False], ids=["", "without a listener"])
def test_heater_that_does_not_cool_is_not_reported_as_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_listener: bool
):
    for name, rule in tuple(heater_watch.RULES.items()):
        monkeypatch.setitem(heater_watch.RULES, name, replace(rule, cooling_timeout_s=1.0))
    master, slave = pty.openpty()
    tty.setraw(slave)

    def serve_board() -> None:
        os.write(master, b"start\necho:   M301 P10.03\n")
        with suppress(OSError):
            while data := os.read(master, 4096):
                for line in data.split(b"\n")[:-1]:
                    os.write(master, b"ok T:200.0 /0.0 B:60.0 /0.0\n" if b"M105" in line else b"ok\n")

    lines: list[str] = []

    def report(text: str) -> None:
        lines.append(text)
        if not has_listener:
            raise BrokenPipeError

    threading.Timer(0.2, serve_board).start()
    try:
        result = stop_printer(StopTarget("a", os.ttyname(slave), tmp_path / "a", ULTIMAKER2), notify=report)
        assert not result.is_confirmed_off and "cooling was not confirmed" in result.text
        assert len(lines) == 1 and "reports targets of 0" in lines[0]
        assert Journal(tmp_path / "a" / "journal.jsonl").state.board.hot
    finally:
        os.close(slave)
        os.close(master)


def test_agent_of_another_user_leaves_the_stop_unconfirmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def deny_access(path: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(estop, "kill_holder", deny_access)
    target = StopTarget("um2-01", str(tmp_path / "no-such-tty"), tmp_path / "um2-01", ULTIMAKER2)
    result = stop_printer(target)
    assert not result.is_confirmed_off
    assert "cannot be stopped" in result.text


def test_simulated_printer_without_power_is_off(tmp_path: Path):
    result = stop_printer(StopTarget("um2-01", f"sim://{MODEL}", tmp_path / "um2-01", ULTIMAKER2))
    assert result.is_confirmed_off


def test_farm_estop_names_printers_that_it_could_not_stop(tmp_path: Path):
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(f"printers:\n  - {{name: a, model: {MODEL}, port: {tmp_path}/no-such-tty}}\n")
    command = [Path(sys.executable).with_name("farm"), "estop", "--state", tmp_path, "--fleet", fleet]
    finished_process = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert finished_process.returncode == 1
    assert (
        "a: cannot be stopped" in finished_process.stdout
        and "not confirmed off: a" in finished_process.stderr
    )
    finished_process = subprocess.run(
        [*command, "b"], check=False, capture_output=True, text=True, timeout=60
    )
    assert finished_process.returncode == 4 and "no printer b" in finished_process.stderr


def test_lock_names_its_holder(tmp_path: Path):
    path = tmp_path / AGENT_LOCK
    assert find_holder(path) is None
    lock = acquire_lock(path)
    assert lock is not None
    write_pid(lock)
    assert is_locked(path) and acquire_lock(path) is None
    assert find_holder(path) == os.getpid()
    size_bytes = path.stat().st_size
    path.write_text("[1")
    assert find_holder(path) is None
    os.close(lock)
    assert not is_locked(path)
    path.write_text("1" * size_bytes)
    lock = acquire_lock(path)
    assert lock is not None
    assert find_holder(path) is None  # the lock file has no process id yet
    write_pid(lock)
    assert find_holder(path) == os.getpid()
    assert path.stat().st_size == size_bytes  # a full disk has no space for a longer file
    os.close(lock)


def test_targets_are_read_from_start_files_and_broken_files_are_skipped(tmp_path: Path):
    for name, text in (("a", None), ("b", "{}"), ("c", "[")):
        (tmp_path / name).mkdir()
        if text is not None:
            (tmp_path / name / "start.json").write_text(text)
    (tmp_path / "e").mkdir()
    # An emergency stop must also find the printer of a start file that an older version wrote.
    (tmp_path / "e" / "start.json").write_text(
        '{"printer": "e", "model": "' + MODEL + '", "port": "/dev/null"}'
    )
    StartFile("d", MODEL, "/dev/null", power_off_cmd="relay d").write(tmp_path / "d")
    target = StopTarget("d", "/dev/null", tmp_path / "d", ULTIMAKER2, "relay d")
    old_target = StopTarget("e", "/dev/null", tmp_path / "e", ULTIMAKER2)
    assert list_targets(tmp_path) == {"d": target, "e": old_target}


def test_unchanged_start_file_is_not_written_again(tmp_path: Path):
    start_file = StartFile("d", MODEL, "/dev/null")
    start_file.write(tmp_path)
    (tmp_path / ".start.json.new").mkdir()  # nothing can be written there
    start_file.write(tmp_path)
    with pytest.raises(OSError):
        replace(start_file, port="/dev/zero").write(tmp_path)


def test_unrelated_process_with_the_pid_of_a_former_agent_is_not_killed(tmp_path: Path):
    unrelated_process = subprocess.Popen(["sleep", "60"])
    try:
        (tmp_path / AGENT_LOCK).write_text(str(unrelated_process.pid))
        assert kill_holder(tmp_path / AGENT_LOCK)
        assert unrelated_process.poll() is None
    finally:
        unrelated_process.kill()
        unrelated_process.wait()


def test_result_keeps_the_names_of_its_fields_in_json():
    result = StopResult("um2-01", 12.5, True, "stopped", is_still=True)
    record = {"printer": "um2-01", "cut_s": 12.5, "seen_off": True, "text": "stopped", "still": True}
    assert json.loads(result.dump()) == record
    assert StopResult.parse(result.dump()) == result
