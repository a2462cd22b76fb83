"""Keeps the host from shutting down and from sleeping while a print is open."""

from __future__ import annotations

import logging
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

log = logging.getLogger(__name__)

_SYSTEMD = Path("/run/systemd/system")  # there where systemd is what runs the host
_WORDS = ("systemd-inhibit", "--what=shutdown:sleep", "--mode=block", "--who=farm")


class Inhibitor:
    """An inhibitor lock of systemd's, held by a child that ends with this process, whatever ends that.

    Parameters
    ----------
    printer
        Named to whoever wants to shut the host down.
    simulated
        Nothing is lost with a simulated print: it holds nothing.
    words
        The command that holds the lock as long as the command behind it runs.
    """

    def __init__(self, printer: str, *, simulated: bool, words: Sequence[str] | None = None) -> None:
        wanted = words is not None or (_SYSTEMD.is_dir() and not simulated)
        self._words = (*(words or _WORDS), f"--why={printer} prints", "cat") if wanted else None
        self._child: subprocess.Popen[bytes] | None = None

    def hold(self, wanted: bool) -> None:
        """Take the lock, or give it back. A host that gives none is only logged: the print goes on."""
        if self._words is None or wanted == (self._child is not None):
            return
        if self._child is not None:
            assert self._child.stdin is not None
            with suppress(OSError):
                self._child.stdin.close()  # `cat` ends, and with it the lock
            try:
                self._child.wait(1.0)
            except subprocess.TimeoutExpired:
                self._child.kill()
                self._child.wait()
            self._child = None
            return
        try:
            self._child = subprocess.Popen(self._words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
        except OSError as error:
            log.warning("nothing keeps the host from shutting down in this print: %s", error)
            self._words = None
