"""The printer's end of its serial port: the master of a pseudo-terminal, and who has the other end open.

A pseudo-terminal has no DTR: an opened slave stands for it. Polling the master for a hang-up would miss a
host that closes and opens again at once (which is how it resets a board), so the kernel is asked for every
open and close of the slave's device file (inotify).
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
    """A pty in raw mode, with `link` pointing to its slave.

    Attributes
    ----------
    name
        The slave's device file.
    master
        File descriptor of the printer's end; non-blocking.
    watch
        File descriptor that is readable when the slave was opened or closed.
    plugged
        Whether the cable is in; the descriptors are of no use where it is not.
    is_open
        Whether a host has the slave open.
    """

    def __init__(self, link: Path) -> None:
        self._link = link
        self.name = ""
        self.plug()

    def plug(self) -> None:
        """Put the cable in: a pseudo-terminal of another name than before."""
        masters = [pty.openpty()]
        while os.ttyname(masters[-1][1]) == self.name:  # it would be the old one again
            masters.append(pty.openpty())
        self.master, slave = masters.pop()
        for spare in (end for ends in masters for end in ends):
            os.close(spare)
        tty.setraw(slave, termios.TCSANOW)
        self.name = os.ttyname(slave)
        os.close(slave)  # or nobody could tell an open port from a closed one
        os.set_blocking(self.master, False)
        self.watch = _watch(self.name)
        self.plugged = True
        self.is_open = False
        self._hosts = 0
        new = self._link.with_name(f".{self._link.name}.new")
        new.unlink(missing_ok=True)
        new.symlink_to(self.name)
        new.replace(self._link)

    def unplug(self) -> None:
        """Pull the cable: the host's end hangs up, and the board goes on."""
        if self.plugged:
            self.unlink()
            os.close(self.master)
            os.close(self.watch)
        self.plugged = self.is_open = False

    def opened(self) -> bool:
        """Take in what happened to the slave; True where it was closed and is, or was again, opened.

        Only the first of several hosts raises DTR.
        """
        raised = False
        try:
            data = os.read(self.watch, 4096)
        except BlockingIOError:
            return False
        at = 0
        while at < len(data):
            _, mask, _, name_bytes = _EVENT.unpack_from(data, at)
            at += _EVENT.size + name_bytes
            if mask & _OPEN:
                self._hosts += 1
                raised = raised or self._hosts == 1
            if mask & (_CLOSE_WRITE | _CLOSE_NOWRITE):
                self._hosts = max(0, self._hosts - 1)
        self.is_open = self._hosts > 0
        return raised

    def read(self) -> bytes:
        """Read what the host sent; empty also where it has closed the port."""
        try:
            return os.read(self.master, 4096)
        except OSError:  # EIO: nobody has the slave open; EAGAIN: nothing there
            return b""

    def write(self, data: bytes) -> None:
        """Send to the host. What it does not read while its buffer is full is lost, as with a USB chip."""
        if self.is_open:
            try:
                os.write(self.master, data)
            except OSError:
                return

    def unlink(self) -> None:
        """The printer goes: a link left behind would soon lead to somebody else's pseudo-terminal."""
        with suppress(OSError):
            if str(self._link.readlink()) == self.name:
                self._link.unlink()

    def discard(self) -> None:
        """Forget all that is under way in both directions: a host opened the port anew."""
        while self.read():
            pass


def _watch(name: str) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    watch: int = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    mask = _OPEN | _CLOSE_WRITE | _CLOSE_NOWRITE
    if watch < 0 or libc.inotify_add_watch(watch, os.fsencode(name), mask) < 0:
        code = ctypes.get_errno()
        raise OSError(code, f"cannot watch {name} with inotify: {os.strerror(code)}")
    return watch
