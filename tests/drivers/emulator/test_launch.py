"""Emulator in a process, connected by a real pseudo-terminal."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.clock import Clock
from drivers.emulator.launch import Command, control, is_running, launch, read_status
from drivers.emulator.status import EmulatorStatus
from drivers.errors import PortError

pytestmark = pytest.mark.system

SCALE = 50.0
TIME_LIMIT_S = 60.0


def wait_for(condition: Callable[[], bool]) -> None:
    """Poll until a condition is true, up to a deadline."""
    deadline_s = time.monotonic() + TIME_LIMIT_S
    while not condition():
        assert time.monotonic() < deadline_s, "the condition did not become true in time"
        select.select([], [], [], 0.01)


class RawPort:
    """Port that is opened without pyserial, as a host would open it."""

    def __init__(self, tty: Path) -> None:
        self.fd = os.open(tty, os.O_RDWR | os.O_NOCTTY)

    def read_until(self, pattern: bytes) -> bytes:
        data = b""
        while pattern not in data:
            assert select.select([self.fd], [], [], TIME_LIMIT_S)[0], f"only {data!r}"
            data += os.read(self.fd, 4096)
        return data

    def query(self, line: bytes, pattern: bytes = b"ok") -> bytes:
        os.write(self.fd, line + b"\n")
        return self.read_until(pattern)

    def close(self) -> None:
        os.close(self.fd)


class Printer:
    """Emulator in a separate folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def start_emulator(self, url: str = "sim://ultimaker2_plus") -> Path:
        return launch(url, self.folder, Clock(SCALE, time.time()))

    @property
    def status(self) -> EmulatorStatus:
        return read_status(self.folder)

    def boot_and_connect(self) -> RawPort:
        port = RawPort(self.start_emulator())
        port.read_until(b"SD init fail\n")
        return port


@pytest.fixture
def printer(tmp_path: Path) -> Iterator[Printer]:
    # This path is longer than the path of a Unix socket may be.
    printer = Printer(tmp_path / ("deep" * 20) / ("deeper" * 12))
    yield printer
    if is_running(printer.folder):
        control(printer.folder, Command.POWER_OFF)


def test_new_printer_is_cold_clear_and_parked(printer: Printer) -> None:
    tty = printer.start_emulator()
    assert tty == printer.folder / "tty" and tty.is_char_device()
    status = printer.status
    assert status.tty == str(tty.readlink())
    assert status.nozzle_c == status.bed_c == 21.0
    assert status.bed_clear and status.filament_end_mm == -20.0
    assert not status.link_open and status.resets == 0


def test_running_emulator_is_found_and_not_started_twice(printer: Printer) -> None:
    first_tty = printer.start_emulator()
    pid = printer.status.pid
    assert printer.start_emulator() == first_tty and printer.status.pid == pid
    assert os.getsid(pid) != os.getsid(0)


def test_port_answers_without_an_echo(printer: Printer) -> None:
    port = printer.boot_and_connect()
    assert port.query(b"M105") == b"ok T:21.0 /0.0 B:21.0 /0.0 @:0 B@:0\n"
    assert printer.status.link_open
    port.close()


def test_closing_the_port_changes_nothing_and_opening_it_resets_the_board(printer: Printer) -> None:
    port = printer.boot_and_connect()
    port.query(b"M104 S200")
    wait_for(lambda: printer.status.nozzle_target_c == 200.0)
    port.close()
    wait_for(lambda: not printer.status.link_open)
    status = printer.status
    wait_for(lambda: printer.status.time_s > status.time_s + 25.0)
    assert printer.status.nozzle_target_c == 200.0 and printer.status.nozzle_c > status.nozzle_c
    second_port = RawPort(printer.start_emulator())
    wait_for(lambda: printer.status.resets == status.resets + 1)
    assert printer.status.nozzle_target_c == 0.0
    assert second_port.read_until(b"SD init fail\n").startswith(b"start\n")
    second_port.close()


def test_port_that_is_closed_and_reopened_at_once_resets_the_board_each_time(printer: Printer) -> None:
    port = printer.boot_and_connect()
    old_resets = printer.status.resets
    for count in range(1, 6):
        port.query(b"M104 S200")
        port.close()
        port = RawPort(printer.start_emulator())
        assert port.read_until(b"SD init fail\n").startswith(b"start\n")
        wait_for(lambda count=count: printer.status.resets == old_resets + count)  # type: ignore[misc]
        assert printer.status.nozzle_target_c == 0.0
    port.close()


def test_print_makes_the_bed_not_clear_until_a_person_clears_it(printer: Printer) -> None:
    port = printer.boot_and_connect()
    port.query(b"M109 S200", b"\nok\n")
    for line in (b"G28", b"G92 E0", b"G1 E20 F1500", b"G92 E0", b"G1 X50 Y50 Z0.3 F9000"):
        port.query(line)
    for k in range(1, 40):
        port.query(b"G1 X%d Y%d E%.2f F3000" % (50 + k, 50 + 3 * (k % 2), k * 0.2))
    port.query(b"M400")
    wait_for(lambda: not printer.status.bed_clear)
    wait_for(lambda: printer.status.moves >= 41)
    status = printer.status
    assert status.homed and status.printing_s > 1.0
    assert status.filament_mm == pytest.approx(20 + 39 * 0.2) and status.filament_end_mm == 0.0
    assert status.position_mm == pytest.approx((89.0, 53.0, 0.3))
    control(printer.folder, Command.RESET)
    port.read_until(b"start\n")
    assert not printer.status.bed_clear
    control(printer.folder, Command.CLEAR_BED)
    assert printer.status.bed_clear
    port.close()


def test_power_is_cut_and_restored(printer: Printer) -> None:
    port = printer.boot_and_connect()
    port.query(b"M104 S200")
    control(printer.folder, Command.POWER_OFF)
    assert not is_running(printer.folder)
    assert printer.status.nozzle_target_c == 0.0
    assert not (printer.folder / "tty").is_symlink()  # another process may soon have this device
    port.close()
    with pytest.raises(PortError, match="no emulator answers"):
        control(printer.folder, Command.RESET)
    printer.start_emulator()
    assert printer.status.nozzle_c == 21.0


def test_control_refuses_unknown_commands(printer: Printer) -> None:
    printer.start_emulator()
    with pytest.raises(PortError, match="no command 'dance'; use one of clear_bed, reset, power_off"):
        control(printer.folder, "dance")


def test_wrong_url_starts_nothing(printer: Printer) -> None:
    with pytest.raises(PortError, match="no printer model"):
        printer.start_emulator("sim://ender3")
    assert not printer.folder.exists()


def test_missing_status_is_reported(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="no emulator has run here"):
        read_status(tmp_path)


def test_slow_wire_delays_answers(printer: Printer) -> None:
    port = RawPort(printer.start_emulator("sim://ultimaker2_plus?wire=1"))
    port.read_until(b"SD init fail\n")
    assert port.query(b"M115").endswith(b"\nok\n")
    port.close()


def test_status_is_written_atomically(printer: Printer) -> None:
    port = printer.boot_and_connect()
    statuses = set()
    for k in range(60):  # read the status repeatedly while it is rewritten for each target
        os.write(port.fd, b"M104 S%d\n" % (k % 2 * 50))
        for _ in range(20):
            statuses.add(printer.status.nozzle_target_c)
        port.read_until(b"ok")
    assert statuses == {0.0, 50.0}
    port.close()


def test_unplugged_port_hangs_up_and_returns_as_another_device(
    printer: Printer,
) -> None:
    port = printer.boot_and_connect()
    port.query(b"M104 S200")
    old_status = printer.status
    control(printer.folder, Command.UNPLUG)
    while os.read(port.fd, 4096):
        pass  # the end of the data shows that the port has hung up
    port.close()
    assert not (printer.folder / "tty").exists()
    assert printer.status.nozzle_target_c == 200.0
    control(printer.folder, Command.PLUG)
    assert printer.status.tty != old_status.tty
    second_port = RawPort(printer.folder / "tty")  # opening a port resets the board
    second_port.read_until(b"start\n")
    assert printer.status.resets == old_status.resets + 1
    second_port.close()


def test_actions_at_the_display_are_visible_only_in_answers_to_queries(printer: Printer) -> None:
    port = printer.boot_and_connect()
    port.query(b"G28")
    control(printer.folder, Command.SET_NOZZLE, target_c=150)
    assert b"/150.0" in port.query(b"M105")
    control(printer.folder, Command.MOVE, z_mm=50)
    assert b"Z:50.00" in port.query(b"M114")
    assert b"Not SD printing" in port.query(b"M27")
    control(printer.folder, Command.PRINT_SD)
    assert b"SD printing byte " in port.query(b"M27")
    status = printer.status
    assert (status.nozzle_target_c, status.bed_target_c) == (210.0, 60.0)
    with pytest.raises(PortError):
        control(printer.folder, Command.SET_BED)  # without a value
    port.close()


def test_answers_sent_in_pieces_arrive_completely(printer: Printer) -> None:
    printer.start_emulator("sim://ultimaker2_plus?bytewise=1")
    port = printer.boot_and_connect()
    assert b"EXTRUDER_COUNT:1\nok" in port.query(b"M115")
    port.close()
