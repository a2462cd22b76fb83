"""Discovery and commissioning of printers."""

import os
import pty
import select
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.clock import Clock
from drivers.discovery import find_model, list_plugged_devices, verify_reset
from drivers.emulator.launch import control, launch
from drivers.errors import DriverError, PortError
from drivers.firmware import MARLIN2, ULTIMAKER2
from drivers.ports import Device
from drivers.records import Journal
from drivers.remote import find_agent_pid, spawn_agent

MODEL = "ultimaker2_extended_plus"
FARM = Path(sys.executable).with_name("farm")


@pytest.fixture
def printer(tmp_path: Path) -> Iterator[Path]:
    """Start an emulated printer, whose port has no description."""
    folder = tmp_path / "printer"
    launch(f"sim://{MODEL}", folder, Clock(120.0, time.time()))
    yield folder / "tty"
    control(folder, "power_off")


def run_discover(tmp_path: Path, port: object, *arguments: str) -> subprocess.CompletedProcess[str]:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(f"printers:\n  - {{name: a, model: ultimaker2_plus, port: {port}}}\n")
    command = [FARM, "discover", "--state", tmp_path / "state", "--fleet", fleet, *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=90)


def test_plugged_device_is_named_by_its_socket_and_the_fleet(tmp_path: Path):
    for name in ("ttyACM0", "ttyACM1", "ttyS0"):
        (tmp_path / name).touch()
    by_path = tmp_path / "by-path"
    by_path.mkdir()
    (by_path / "usb-0:2:1.0").symlink_to(tmp_path / "ttyACM0")
    (by_path / "usb-0:3:1.0").symlink_to(tmp_path / "ttyACM1")
    devices = [Device(tmp_path / name, "a board") for name in ("ttyACM0", "ttyACM1", "ttyS0")]
    fleet = [("um2-01", str(by_path / "usb-0:3:1.0")), ("um2-02", "sim://ultimaker2_plus")]
    rows = list_plugged_devices(fleet, devices, by_path)
    assert [(row.port.name, row.printer) for row in rows] == [
        ("usb-0:2:1.0", None),
        ("usb-0:3:1.0", "um2-01"),
        ("ttyS0", None),
    ]


@pytest.mark.system
def test_board_that_restarts_is_commissioned_and_the_reset_is_recorded(tmp_path: Path, printer: Path):
    assert verify_reset(str(printer), tmp_path / "agent", ULTIMAKER2) == MODEL
    journal_state = Journal(tmp_path / "agent" / "journal.jsonl").state
    assert (
        journal_state.board.verified_reset_port == str(printer) and journal_state.board.device_id is not None
    )


@pytest.mark.system
def test_board_whose_banner_lacks_the_model_is_queried(tmp_path: Path):
    folder = tmp_path / "printer"
    launch("sim://creality_ender3", folder, Clock(120.0, time.time()))
    try:
        assert verify_reset(str(folder / "tty"), None, MARLIN2) == "creality_ender3"
    finally:
        control(folder, "power_off")


def test_board_that_prints_from_its_card_is_not_reset():
    master, slave = pty.openpty()
    tty.setraw(slave)
    path = Path(os.ttyname(slave))  # the slave stays open, because the master would see a close
    received_data = b""

    def serve_board() -> None:
        nonlocal received_data
        while True:
            try:
                data = os.read(master, 4096)
            except OSError:
                return
            received_data += data
            for line in data.split(b"\n")[:-1]:
                if b"M27" in line:
                    os.write(master, b"SD printing byte 77/900\n")
                os.write(master, b"ok T:200.0 /200.0 B:60.0 /60.0 @:0 B@:0\n" if b"M105" in line else b"ok\n")

    thread = threading.Thread(target=serve_board, daemon=True)
    thread.start()
    try:
        with pytest.raises(PortError, match="SD card"):
            verify_reset(str(path), None, ULTIMAKER2, timeout_s=30.0)
        assert b"M27" in received_data
    finally:
        os.close(slave)
        os.close(master)


@pytest.mark.parametrize("banner", [b"", b"echo: Last Updated: by nobody"])
def test_board_of_an_unknown_version_is_refused(banner: bytes):
    with pytest.raises(DriverError):
        find_model(banner)


@pytest.mark.system
def test_farm_commissions_a_printer_with_and_without_its_agent(tmp_path: Path, printer: Path):
    result_without_agent = run_discover(tmp_path, "/dev/null", "--commission", str(printer), "--yes")
    assert result_without_agent.returncode == 0, result_without_agent.stderr
    assert f"model: {MODEL}" in result_without_agent.stdout  # the line for fleet.yaml
    (tmp_path / "by-path").symlink_to(printer)
    # The command names the port by another path than the fleet.
    wrong_result = run_discover(tmp_path, printer, "--commission", str(tmp_path / "by-path"), "--yes")
    assert wrong_result.returncode == 2 and "fleet.yaml says ultimaker2_plus" in wrong_result.stderr
    folder = tmp_path / "state" / "agents" / "b"
    process = spawn_agent("b", MODEL, str(printer), folder, Clock(120.0, time.time()))
    try:
        fleet = tmp_path / "fleet.yaml"
        fleet.write_text(f"printers:\n  - {{name: b, model: {MODEL}, port: {printer}}}\n")
        deadline_s = time.monotonic() + 30.0
        while find_agent_pid(folder) is None and time.monotonic() < deadline_s:
            select.select([], [], [], 0.02)
        command = [FARM, "discover", "--commission", "b", "--yes"]
        command += ["--state", tmp_path / "state", "--fleet", fleet]
        finished_process = subprocess.run(command, check=False, capture_output=True, text=True, timeout=90)
        assert finished_process.returncode == 0 and "can be stopped" in finished_process.stdout, (
            finished_process.stderr
        )
    finally:
        process.kill()
        process.wait(10.0)
    assert Journal(folder / "journal.jsonl").state.board.verified_reset_port == str(printer)
    result = run_discover(tmp_path, f"{printer}, host: pc-b", "--commission", "a", "--yes")
    # A port of this host with the same name belongs to another printer.
    assert result.returncode == 5 and "is on pc-b" in result.stderr
    unknown_result = run_discover(tmp_path, printer, "--commission", "z", "--yes")
    assert unknown_result.returncode == 4
