"""The printer's end of its serial port: the master of a pseudo-terminal, and the state of its slave.

A pseudo-terminal has no DTR: opening the slave takes its place. Polling the master for a hang-up would miss
a host that closes and reopens at once (which is how it resets a board), so inotify reports every open and
close of the slave's device file.
"""

from __future__ import annotations

import ctypes
import os
import pty
import struct
import termios
import tty
from contextlib import suppress
from pathlib import Path

_OPEN, _CLOSE_WRITE, _CLOSE_NOWRITE = 0x20, 0x08, 0x10
_EVENT = struct.Struct("iIII")


class Port:
    """A pty in raw mode; `link` points to its slave.

    Attributes
    ----------
    name
        The slave's device file.
    master_fd
        File descriptor of the printer's end; non-blocking.
    watch_fd
        File descriptor that becomes readable when the slave is opened or closed.
    is_plugged
        True while the cable is plugged in; otherwise the descriptors are invalid.
    is_open
        True while a host has the slave open.
    """

    def __init__(self, link: Path) -> None:
        self._link = link
        self.name = ""
        self.plug()

    def plug(self) -> None:
        """Plug the cable in: create a pseudo-terminal with a new name."""
        pty_pairs = [pty.openpty()]
        while os.ttyname(pty_pairs[-1][1]) == self.name:  # the old name, which was just released
            pty_pairs.append(pty.openpty())
        self.master_fd, slave = pty_pairs.pop()
        for end_fd in (end for ends in pty_pairs for end in ends):
            os.close(end_fd)
        tty.setraw(slave, termios.TCSANOW)
        self.name = os.ttyname(slave)
        os.close(slave)  # otherwise an open port would look like a closed one
        os.set_blocking(self.master_fd, False)
        self.watch_fd = _open_watch(self.name)
        self.is_plugged = True
        self.is_open = False
        self._host_count = 0
        new_link = self._link.with_name(f".{self._link.name}.new")
        new_link.unlink(missing_ok=True)
        new_link.symlink_to(self.name)
        new_link.replace(self._link)

    def unplug(self) -> None:
        """Pull the cable: the host's end hangs up, and the board continues."""
        if self.is_plugged:
            self.unlink()
            os.close(self.master_fd)
            os.close(self.watch_fd)
        self.is_plugged = self.is_open = False

    def process_port_events(self) -> bool:
        """Process openings and closings of the slave; return True if an opening raised DTR.

        Only the first of several hosts raises DTR.
        """
        is_dtr_raised = False
        try:
            data = os.read(self.watch_fd, 4096)
        except BlockingIOError:
            return False
        offset = 0
        while offset < len(data):
            _, mask, _, name_bytes = _EVENT.unpack_from(data, offset)
            offset += _EVENT.size + name_bytes
            if mask & _OPEN:
                self._host_count += 1
                is_dtr_raised = is_dtr_raised or self._host_count == 1
            if mask & (_CLOSE_WRITE | _CLOSE_NOWRITE):
                self._host_count = max(0, self._host_count - 1)
        self.is_open = self._host_count > 0
        return is_dtr_raised

    def read(self) -> bytes:
        """Read bytes from the host; empty if there are none, or if the host has closed the port."""
        try:
            return os.read(self.master_fd, 4096)
        except OSError:  # EIO: no host has the slave open; EAGAIN: no data
            return b""

    def write(self, data: bytes) -> None:
        """Send bytes to the host. Bytes that exceed its buffer are lost, as with a USB chip."""
        if self.is_open:
            try:
                os.write(self.master_fd, data)
            except OSError:
                return

    def unlink(self) -> None:
        """Remove the link, as a stale one would soon point to the pseudo-terminal of another process."""
        with suppress(OSError):
            if str(self._link.readlink()) == self.name:
                self._link.unlink()

    def discard_bytes(self) -> None:
        """Drop the bytes from the host that were in transit when it reopened the port."""
        while self.read():
            pass


def _open_watch(name: str) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    watch: int = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    mask = _OPEN | _CLOSE_WRITE | _CLOSE_NOWRITE
    if watch < 0 or libc.inotify_add_watch(watch, os.fsencode(name), mask) < 0:
        code = ctypes.get_errno()
        raise OSError(code, f"cannot watch {name} with inotify: {os.strerror(code)}")
    return watch
