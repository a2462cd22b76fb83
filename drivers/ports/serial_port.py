"""Serial ports through pyserial, which no other module uses.

pyserial opens and configures the port. Bytes then go through `os.read` and `os.write` on its descriptor:
pyserial's own calls select and lock each time, which is too slow for thousands of lines a second.
"""

from __future__ import annotations

import fcntl
import os
import sys
import termios
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import serial
from serial.tools import list_ports

from drivers.clock import Clock
from drivers.emulator.launch import launch
from drivers.errors import PortError
from drivers.ports.wire_record import WireRecord

DTR_PULSE_S = 0.1  # duration of a pulse that resets the board
DRAIN_TIMEOUT_S = 1.0  # maximum time for unsent bytes to be transmitted
_DRAIN_POLL_S = 0.01
_READ_BYTES = 4096
_PTY_PREFIX = "/dev/pts/"  # the kernel keeps a pty exclusive until its other end is closed


class SerialPort:
    """Open serial port. Opening it resets the board behind it.

    Parameters
    ----------
    path
        A device, or the slave of a pseudo-terminal.
    baud_rate
        Bits per second.
    record
        Record of the bytes that are read and written, if they are recorded.
    is_shared
        True to open the port even if it is in use; for an emergency stop only.

    Raises
    ------
    PortError
        The port does not exist, or is in use.
    """

    def __init__(
        self, path: Path, baud_rate: int, record: WireRecord | None = None, *, is_shared: bool = False
    ) -> None:
        self.path, self._baud_rate = path, baud_rate
        self._record = WireRecord(time.time) if record is None else record
        self._is_exclusive = not is_shared
        self._unsent_bytes = b""
        self._open_device()

    def _open_device(self) -> None:
        try:
            port = serial.Serial(str(self.path), self._baud_rate, timeout=0, exclusive=self._is_exclusive)
        except (serial.SerialException, OSError, ValueError) as error:
            raise PortError(
                f"{self.path}: cannot be opened ({_describe_cause(error)}); {_suggest_remedy(error)}"
            ) from error
        try:
            # With HUPCL, closing the port would drop DTR, and the next opening would reset the board twice.
            fd = port.fileno()
            attributes = termios.tcgetattr(fd)
            attributes[2] &= ~termios.HUPCL
            # pyserial's VMIN of 0 would make an empty port look like one that hung up.
            attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
            termios.tcsetattr(fd, termios.TCSANOW, attributes)
            self._is_pty = os.ttyname(fd).startswith(_PTY_PREFIX)
            if self._is_exclusive and not self._is_pty:
                fcntl.ioctl(fd, termios.TIOCEXCL)  # also excludes programs that do not use locks
            os.set_blocking(fd, False)  # pyserial has discarded earlier input
        except (termios.error, OSError) as error:
            port.close()
            raise PortError(f"{self.path}: is not a serial port ({error}); give another device") from error
        self._serial, self._fd = port, fd

    def fileno(self) -> int:
        """Return the descriptor; `reset` may change it."""
        return self._fd

    def read(self) -> bytes:
        """Read the bytes received so far, which may be none.

        Raises
        ------
        PortError
            The port was disconnected.
        """
        try:
            data = os.read(self._fd, _READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PortError(f"{self.path}: was disconnected ({error}); check its cable and power") from error
        if not data:
            raise PortError(f"{self.path}: was disconnected; check its cable and power")
        self._record.record(False, data)
        return data

    def write(self, data: bytes) -> None:
        """Send bytes; those that the port does not accept yet are kept for the next call.

        Raises
        ------
        PortError
            The port was disconnected.
        """
        self._record.record(True, data)
        if self._unsent_bytes:
            data = self._unsent_bytes + data
        try:
            written_bytes = os.write(self._fd, data)
        except BlockingIOError:
            written_bytes = 0
        except OSError as error:
            raise PortError(f"{self.path}: was disconnected ({error}); check its cable and power") from error
        self._unsent_bytes = data[written_bytes:]

    @property
    def has_unsent_bytes(self) -> bool:
        """True while bytes wait for the next call of `write`."""
        return bool(self._unsent_bytes)

    def write_now(self, data: bytes) -> None:
        """Send bytes in place of all unsent ones, and wait until they are transmitted.

        Waits `DRAIN_TIMEOUT_S` at most, as the board may no longer accept bytes.

        Raises
        ------
        PortError
            The port was disconnected.
        """
        self._record.record(True, data)
        deadline_s = time.monotonic() + DRAIN_TIMEOUT_S
        try:
            # On a pseudo-terminal, a flush also discards bytes that are on their way to the other end.
            self._replace_unsent_bytes(data, flush=not self._is_pty)
            if self._is_pty and self._unsent_bytes:  # the other end has stopped reading
                self._replace_unsent_bytes(data, flush=True)
            while self._unsent_bytes or self._count_queued_bytes():
                if time.monotonic() > deadline_s:
                    return
                time.sleep(_DRAIN_POLL_S)
                if self._unsent_bytes:
                    self.write(b"")
        except (OSError, termios.error) as error:
            raise PortError(f"{self.path}: was disconnected ({error}); check its cable and power") from error

    def _replace_unsent_bytes(self, data: bytes, *, flush: bool) -> None:
        self._unsent_bytes = data
        if flush:
            termios.tcflush(self._fd, termios.TCOFLUSH)
        self.write(b"")

    def _count_queued_bytes(self) -> int:
        """Count the bytes that the kernel has not sent yet."""
        return int.from_bytes(fcntl.ioctl(self._fd, termios.TIOCOUTQ, bytes(4)), sys.byteorder)

    def reset(self) -> None:
        """Reset the board by a pulse of DTR; a pseudo-terminal has no DTR and is closed and reopened.

        Raises
        ------
        PortError
            The port was disconnected.
        """
        self._unsent_bytes = b""
        try:
            if os.ttyname(self._fd).startswith(_PTY_PREFIX):  # raises if the printer was disconnected
                self.close()
                self._open_device()
                return
            self._serial.dtr = False
            time.sleep(DTR_PULSE_S)
            self._serial.dtr = True
            termios.tcflush(self._fd, termios.TCIFLUSH)
        except (OSError, termios.error) as error:
            raise PortError(f"{self.path}: cannot be reset ({error}); check its cable and power") from error

    def close(self) -> None:
        """Close the port. The board continues its buffered moves, and its heaters stay on."""
        with suppress(OSError):  # the port was disconnected
            self._serial.close()


def find_device(url: str, folder: Path, clock: Clock) -> Path:
    """Return the device of a port of `fleet.yaml`; start the emulator of a ``sim://`` port if needed.

    Parameters
    ----------
    url
        A device path or ``sim://MODEL``.
    folder
        Folder of the emulator.
    clock
        The farm's clock, for the emulator.

    Raises
    ------
    PortError
        This kind of port cannot be used for a printer, or the emulator does not start.
    """
    scheme, separator, _ = url.partition("://")
    if not separator:
        return Path(url)
    if scheme == "sim":
        return launch(url, folder, clock)
    if scheme == "socket":
        raise PortError(
            f"{url}: a plain socket has no DTR, so the board cannot be stopped; use a device path"
        )
    raise PortError(f"{url}: a port is a device path, rfc2217://HOST:PORT or sim://MODEL")


@dataclass(frozen=True, slots=True)
class Device:
    """Serial device of this host, found without opening it."""

    path: Path
    description: str  # product name from its USB descriptor


def list_devices() -> list[Device]:
    """List all serial devices on USB, sorted by path."""
    ports = (
        Device(Path(port.device), port.description or "")
        for port in list_ports.comports()
        if port.vid is not None
    )
    return sorted(ports, key=lambda device: device.path)


class RemotePort:
    """Port on another host through pyserial, whose errors are raised as `PortError`."""

    def __init__(self, url: str, baud_rate: int) -> None:
        self._url = url
        try:
            self._port = serial.serial_for_url(url, baud_rate, timeout=None)
        except (serial.SerialException, OSError, ValueError) as error:
            raise PortError(
                f"{url}: cannot be opened ({error}); does ser2net run there, with rfc2217?"
            ) from error

    def read_some(self) -> bytes:
        """Wait for bytes. Raises errors of pyserial if the port was disconnected."""
        data: bytes = self._port.read(1)
        if not data:
            raise PortError(f"{self._url}: was disconnected")
        return data + self._port.read(self._port.in_waiting)

    def write(self, data: bytes) -> None:
        """Send bytes. Raises PortError."""
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise PortError(f"{self._url}: was disconnected ({error}); check its host and network") from error

    def write_now(self, data: bytes) -> None:
        """Send bytes; first discard those queued on the other host, if it can. Raises PortError."""
        with suppress(serial.SerialException, OSError, ValueError):
            self._port.reset_output_buffer()
        self.write(data)

    def set_dtr(self, *, up: bool) -> None:
        """Set DTR, and wait until the other host acknowledges it. Raises PortError."""
        try:
            self._port.dtr = up
        except (serial.SerialException, OSError, ValueError) as error:
            raise PortError(f"{self._url}: DTR cannot be set there ({error})") from error

    def close(self) -> None:
        """Close the port."""
        with suppress(Exception):  # the port was disconnected
            self._port.close()


def _describe_cause(error: BaseException) -> str:
    """Return the message of the operating system, which pyserial wraps twice."""
    number = getattr(error, "errno", None)
    return os.strerror(number) if isinstance(number, int) else str(error)


def _suggest_remedy(error: BaseException) -> str:
    match getattr(error, "errno", None):
        case 2:
            return "is the printer plugged in and switched on?"
        case 13:
            return "add the farm's user to the group that owns it"
        case 11 | 16:
            return "another program uses it: end that first"
    return "check its cable and power"
