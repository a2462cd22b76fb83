"""The serial port of a printer, on a pseudo-terminal."""

import fcntl
import os
import pty
import select
import struct
import termios
import tty
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest

from drivers.clock import Clock
from drivers.errors import PortError
from drivers.firmware import ULTIMAKER2
from drivers.ports import SerialPort, WireRecord
from drivers.ports.serial_port import find_device
from printers.agent_with_emulator import read_buffered_bytes

TCGETS2 = 0x802C542A  # reads a rate that has no POSIX constant


@pytest.fixture
def pty_ends() -> Iterator[tuple[int, Path]]:
    """Open a pseudo-terminal, with a board's end to read and write and a path for the port."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    path = Path(os.ttyname(slave))
    os.close(slave)
    yield master, path
    os.close(master)


def read_bytes(fd: int, count: int) -> bytes:
    """Read a number of bytes, or fewer if no more arrive for 2 s."""
    data = b""
    while len(data) < count and select.select([fd], [], [], 2.0)[0]:
        data += os.read(fd, count - len(data))
    return data


def test_bytes_pass_in_both_directions_and_an_empty_port_returns_no_bytes(pty_ends: tuple[int, Path]):
    master, path = pty_ends
    port = SerialPort(path, ULTIMAKER2.baud_rate)
    try:
        assert port.read() == b""
        port.write(b"M105\n")
        assert os.read(master, 100) == b"M105\n"
        os.write(master, b"ok\n")
        assert port.read() == b"ok\n"
        assert not termios.tcgetattr(port.fileno())[2] & termios.HUPCL
        assert (
            struct.unpack("4I B19s 2I", fcntl.ioctl(port.fileno(), TCGETS2, bytes(44)))[-2:] == (250_000,) * 2
        )
    finally:
        port.close()


def test_port_records_both_directions_with_their_times(pty_ends: tuple[int, Path]):
    master, path = pty_ends
    seconds = count()
    record = WireRecord(lambda: float(next(seconds)))
    port = SerialPort(path, ULTIMAKER2.baud_rate, record)
    try:
        port.write(b"N1 M105*38\n")
        os.read(master, 100)
        for piece in (b"o", b"k\n"):
            os.write(master, piece)
            assert port.read() == piece
        assert port.read() == b""
        port.write_now(b"M112\n")
    finally:
        port.close()
    assert [(line.at_s, line.sent, line.text) for line in record.list_lines()] == [
        (0.0, True, "N1 M105*38"),
        (1.0, False, "ok"),
        (3.0, True, "M112"),
    ]


def test_port_is_opened_by_one_process_only(pty_ends: tuple[int, Path]):
    port = SerialPort(pty_ends[1], ULTIMAKER2.baud_rate)
    try:
        with pytest.raises(PortError, match="another program"):
            SerialPort(pty_ends[1], ULTIMAKER2.baud_rate)
        port.reset()
        os.write(pty_ends[0], b"start\n")
        assert port.read() == b"start\n"
    finally:
        port.close()


def test_port_of_a_disconnected_printer_raises(pty_ends: tuple[int, Path]):
    port = SerialPort(pty_ends[1], ULTIMAKER2.baud_rate)
    try:
        os.close(pty_ends[0])
        with pytest.raises(PortError, match="was disconnected"):
            port.read()
    finally:
        port.close()
        os.dup2(os.open(os.devnull, os.O_RDONLY), pty_ends[0])


@pytest.mark.parametrize("url", ["socket://printer:5000", "telnet://printer:5000", "sim://mendel"])
def test_unsupported_ports_are_refused_in_one_line(url: str, tmp_path: Path):
    with pytest.raises(PortError) as error:
        find_device(url, tmp_path, Clock())
    assert "\n" not in str(error.value)


def test_path_that_is_not_a_port_is_refused(tmp_path: Path):
    plain_file = tmp_path / "file"
    plain_file.write_text("")
    for path in (tmp_path / "none", plain_file):
        with pytest.raises(PortError):
            SerialPort(find_device(str(path), tmp_path, Clock()), ULTIMAKER2.baud_rate)


def test_reset_of_a_disconnected_printer_is_a_port_error(pty_ends: tuple[int, Path]):
    port = SerialPort(pty_ends[1], ULTIMAKER2.baud_rate)
    try:
        os.close(pty_ends[0])
        with pytest.raises(PortError, match="cannot be reset"):
            port.reset()
    finally:
        port.close()
        os.dup2(os.open(os.devnull, os.O_RDONLY), pty_ends[0])


def test_urgent_bytes_replace_unsent_ones(pty_ends: tuple[int, Path]):
    """Use a board that does not read, so that the buffers of the kernel and of the port fill up."""
    master, path = pty_ends
    port = SerialPort(path, ULTIMAKER2.baud_rate)
    try:
        while not port.has_unsent_bytes:
            port.write(b"G1 X1 Y1\n" * 100)
        port.write_now(b"\nM104 S0\n")
        assert not port.has_unsent_bytes
        assert read_buffered_bytes(master).endswith(b"\nM104 S0\n")
    finally:
        port.close()


def test_urgent_bytes_do_not_discard_bytes_that_were_sent(pty_ends: tuple[int, Path]):
    """Send without a flush, which would discard bytes in transit on a pseudo-terminal."""
    master, path = pty_ends
    port = SerialPort(path, ULTIMAKER2.baud_rate)
    try:
        for _ in range(50):  # a flush would lose the first line in about 4 of 5 cases
            port.write_now(b"\nM104 S0\n")
            port.write_now(b"\nM112\n")
            assert read_bytes(master, 15) == b"\nM104 S0\n\nM112\n"
    finally:
        port.close()


def test_write_to_a_stalled_board_times_out(pty_ends: tuple[int, Path], monkeypatch: pytest.MonkeyPatch):
    port, ticks_s = SerialPort(pty_ends[1], ULTIMAKER2.baud_rate), iter(range(1000))
    monkeypatch.setattr("drivers.ports.serial_port.time.monotonic", lambda: float(next(ticks_s)))
    monkeypatch.setattr(SerialPort, "_count_queued_bytes", lambda _: 1)
    try:
        port.write_now(b"M104 S0\n")
    finally:
        port.close()
