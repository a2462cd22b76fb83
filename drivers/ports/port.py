"""Every kind of port that can be printed over, behind one face."""

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
from drivers.ports.serial_port import DTR_PULSE_S, Distant, SerialPort, resolve

NET = "rfc2217://"
_BYTES = 4096


class Port(Protocol):
    """Interface of `SerialPort` and `NetPort`."""

    def fileno(self) -> int: ...

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> None: ...

    def write_now(self, data: bytes) -> None: ...

    @property
    def unwritten(self) -> bool: ...

    def reset(self) -> None: ...

    def close(self) -> None: ...


class NetPort:
    """A port on another host, by RFC 2217 (`ser2net`), DTR included.

    pyserial carries the bytes in a thread of its own; another one passes them on, so that there is a
    descriptor to wait for.

    Parameters
    ----------
    url
        ``rfc2217://HOST:PORT``.

    Raises
    ------
    PortError
        Nobody answers there, or DTR cannot be set.
    """

    def __init__(self, url: str, baud_rate: int) -> None:
        self._url = url
        self._distant = Distant(url, baud_rate)
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)
        threading.Thread(target=self._carry, args=(self._distant, self._theirs), daemon=True).start()

    @staticmethod
    def _carry(distant: Distant, to: socket.socket) -> None:
        with suppress(Exception), to:  # whatever ends it, the reader sees the end
            while True:
                to.sendall(distant.read_some())

    def fileno(self) -> int:
        return self._ours.fileno()

    def read(self) -> bytes:
        """Read what has come, perhaps nothing. Raises PortError where the port went away."""
        try:
            data = self._ours.recv(_BYTES)
        except BlockingIOError:
            return b""
        if not data:
            raise PortError(f"{self._url}: went away; look at its host and the network")
        return data

    def write(self, data: bytes) -> None:
        """Send. Raises PortError where the port went away."""
        if data:
            self._distant.write(data)

    def write_now(self, data: bytes) -> None:
        """Send this instead of what waits on the other host. Raises PortError where the port went away."""
        self._distant.write_now(data)

    @property
    def unwritten(self) -> bool:
        return False

    def reset(self) -> None:
        """A pulse of DTR, each edge acknowledged by the other host. Raises PortError."""
        self._distant.set_dtr(up=False)
        time.sleep(DTR_PULSE_S)
        with suppress(BlockingIOError):
            while self._ours.recv(_BYTES):
                pass
        self._distant.set_dtr(up=True)  # the board may have said `start` before that is acknowledged

    def close(self) -> None:
        """Give the port up."""
        self._distant.close()
        self._ours.close()


def open_port(url: str, folder: Path, clock: Clock, baud_rate: int) -> Port:
    """Open the port that `fleet.yaml` names; an emulator is started where none is alive.

    Raises
    ------
    PortError
        It is not there, somebody else has it, or it is none that can be printed over.
    """
    if url.startswith(NET):
        return NetPort(url, baud_rate)
    return SerialPort(resolve(url, folder, clock), baud_rate)


def plugged_in(url: str) -> str | None:
    """A name for the device behind a port that changes when it is plugged in anew or its host starts anew.

    None where nobody can tell.

    Raises
    ------
    PortError
        It is not there.
    """
    if "://" in url:
        return None
    path = Path(url)
    try:
        node = path.stat()
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError as error:
        raise PortError(f"{path}: is not there; is the printer plugged in and switched on?") from error
    return f"{boot}:{os.major(node.st_rdev)}:{os.minor(node.st_rdev)}:{node.st_ino}:{node.st_ctime_ns}"
