"""Inhibitor of sleep and shutdown of the host while a print is open."""

from __future__ import annotations

import logging
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

log = logging.getLogger(__name__)

_SYSTEMD = Path("/run/systemd/system")  # exists if systemd manages the host
_COMMAND = ("systemd-inhibit", "--what=shutdown:sleep", "--mode=block", "--who=farm")


class Inhibitor:
    """Inhibitor lock of systemd, held by a child process that ends with this one.

    Parameters
    ----------
    printer
        The printer's name, shown to people who shut the host down.
    is_simulated
        True for a simulated printer, which takes no lock.
    command
        Command prefix that takes the lock, and holds it while the command appended to it runs.
    """

    def __init__(self, printer: str, *, is_simulated: bool, command: Sequence[str] | None = None) -> None:
        is_enabled = command is not None or (_SYSTEMD.is_dir() and not is_simulated)
        self._command = (
            (*(command or _COMMAND), f"--why={printer} is printing", "cat") if is_enabled else None
        )
        self._child: subprocess.Popen[bytes] | None = None

    def set_lock(self, is_held: bool) -> None:
        """Take or release the lock. A refusal by the host is logged, and the print continues."""
        if self._command is None or is_held == (self._child is not None):
            return
        if self._child is not None:
            assert self._child.stdin is not None
            with suppress(OSError):
                self._child.stdin.close()  # ends `cat`, which releases the lock
            try:
                self._child.wait(1.0)
            except subprocess.TimeoutExpired:
                self._child.kill()
                self._child.wait()
            self._child = None
            return
        try:
            self._child = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
        except OSError as error:
            log.warning("the host may shut down during this print: %s", error)
            self._command = None
