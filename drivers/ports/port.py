"""Ports of printers behind one interface."""

from __future__ import annotations

import os
import socket
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from drivers.clock import Clock
from drivers.errors import PortError
from drivers.ports.serial_port import DTR_PULSE_S, RemotePort, SerialPort, find_device
from drivers.ports.wire_record import WireRecord

NET_PREFIX = "rfc2217://"
_READ_BYTES = 4096


class Port(Protocol):
    """Interface that `SerialPort` and `NetPort` implement."""

    def fileno(self) -> int:
        """Return the descriptor on which to wait; `reset` may change it."""

    def read(self) -> bytes:
        """Read the bytes received so far, if any. Raises PortError."""

    def write(self, data: bytes) -> None:
        """Send bytes; those that the port does not accept yet are kept. Raises PortError."""

    def write_now(self, data: bytes) -> None:
        """Send bytes in place of all unsent ones. Raises PortError."""

    @property
    def has_unsent_bytes(self) -> bool:
        """True while bytes wait for the next call of `write`."""

    def reset(self) -> None:
        """Reset the board. Raises PortError."""

    def close(self) -> None:
        """Close the port."""


class NetPort:
    """Port on another host over RFC 2217 (`ser2net`), which also carries DTR.

    pyserial receives bytes in its own thread; another thread forwards them to a socket, which provides a
    descriptor on which to wait.

    Parameters
    ----------
    url
        ``rfc2217://HOST:PORT``.
    baud_rate
        Bits per second.
    record
        Record of the bytes that are read and written, if they are recorded.

    Raises
    ------
    PortError
        The host does not answer, or DTR cannot be set.
    """

    def __init__(self, url: str, baud_rate: int, record: WireRecord | None = None) -> None:
        self._url = url
        self._record = WireRecord(time.time) if record is None else record
        self._remote = RemotePort(url, baud_rate)
        self._local_end, self._remote_end = socket.socketpair()
        self._local_end.setblocking(False)
        threading.Thread(
            target=self._forward_bytes, args=(self._remote, self._remote_end), daemon=True
        ).start()

    @staticmethod
    def _forward_bytes(remote: RemotePort, receiver: socket.socket) -> None:
        with suppress(Exception), receiver:  # any error closes the socket, which the reader notices
            while True:
                receiver.sendall(remote.read_some())

    def fileno(self) -> int:
        """Return the descriptor on which to wait."""
        return self._local_end.fileno()

    def read(self) -> bytes:
        """Read the bytes received so far, if any. Raises PortError if the port was disconnected."""
        try:
            data = self._local_end.recv(_READ_BYTES)
        except BlockingIOError:
            return b""
        if not data:
            raise PortError(f"{self._url}: was disconnected; check its host and the network")
        self._record.record(False, data)
        return data

    def write(self, data: bytes) -> None:
        """Send bytes. Raises PortError if the port was disconnected."""
        if data:
            self._record.record(True, data)
            self._remote.write(data)

    def write_now(self, data: bytes) -> None:
        """Discard the bytes still queued on the other host, and send these. Raises PortError."""
        self._record.record(True, data)
        self._remote.write_now(data)

    @property
    def has_unsent_bytes(self) -> bool:
        """Always False, as the other host keeps unsent bytes."""
        return False

    def reset(self) -> None:
        """Reset the board by a pulse of DTR; the other host acknowledges both edges. Raises PortError."""
        self._remote.set_dtr(up=False)
        time.sleep(DTR_PULSE_S)
        with suppress(BlockingIOError):
            while self._local_end.recv(_READ_BYTES):
                pass
        self._remote.set_dtr(up=True)  # the board may send `start` before this is acknowledged

    def close(self) -> None:
        """Close the port."""
        self._remote.close()
        self._local_end.close()


def open_port(url: str, folder: Path, clock: Clock, baud_rate: int, record: WireRecord | None = None) -> Port:
    """Open a port of `fleet.yaml`; start the emulator of a simulated port if none is running.

    Parameters
    ----------
    url
        A device path, ``rfc2217://HOST:PORT`` or ``sim://MODEL``.
    folder
        Folder of the emulator.
    clock
        The farm's clock, for the emulator.
    baud_rate
        Bits per second.
    record
        Record of the bytes that are read and written, if they are recorded.

    Raises
    ------
    PortError
        The port does not exist, is in use, or cannot be used for a printer.
    """
    if url.startswith(NET_PREFIX):
        return NetPort(url, baud_rate, record)
    return SerialPort(find_device(url, folder, clock), baud_rate, record)


def identify_device(url: str) -> str | None:
    """Return an identifier of the device behind a port, which changes if it is replugged or the host reboots.

    Returns
    -------
    str or None
        None for a port on another host, or a simulated one.

    Raises
    ------
    PortError
        The device does not exist.
    """
    if "://" in url:
        return None
    path = Path(url)
    try:
        node = path.stat()
        boot_id = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError as error:
        raise PortError(f"{path}: does not exist; is the printer plugged in and switched on?") from error
    return f"{boot_id}:{os.major(node.st_rdev)}:{os.minor(node.st_rdev)}:{node.st_ino}:{node.st_ctime_ns}"
