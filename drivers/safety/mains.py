"""The mains switch of a printer: a command that a fleet may have for where heaters cannot be shown off."""

from __future__ import annotations

import logging
import os
import shlex
import signal
import subprocess
import time
from contextlib import suppress

log = logging.getLogger(__name__)

PATIENCE_S = 10.0  # wall seconds for a relay to answer
LOOK_S = 0.05  # wall seconds between two looks at it
KILL_S = 1.0  # wall seconds for a process that was killed to be gone
BY_HAND = "switch it off by hand"
NO_COMMAND = f"it has no power_off_cmd: {BY_HAND}"
_TAIL_BYTES, _WORDS = 4096, 200  # of what it says on stderr


class PowerOff:
    """A command under way. Nothing here waits, and nothing raises.

    It has a session of its own, so that it outlives an agent that is killed.

    Parameters
    ----------
    command
        `power_off_cmd` of `fleet.yaml`: words as in a shell, but no shell; ``{printer}`` is the name.
    printer
        Its name in the fleet.
    patience_s
        A command that takes longer is ended.
    """

    def __init__(self, command: str, printer: str, patience_s: float = PATIENCE_S) -> None:
        self._printer, self._patience_s = printer, patience_s
        self._by_s = time.monotonic() + patience_s
        self._late = False
        self._heard = b""
        self._said: str | None = None
        try:
            words = [word.replace("{printer}", printer) for word in shlex.split(command)]
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
            assert self._process.stderr is not None
            self._stderr = self._process.stderr
            os.set_blocking(self._stderr.fileno(), False)
        except (OSError, ValueError, IndexError) as error:
            self._end(f"power_off_cmd could not be run ({error}): {BY_HAND}")

    def outcome(self) -> str | None:
        """Say what came of it in a few words; None while it is under way."""
        if self._said is not None:
            return self._said
        self._listen()
        code, now_s = self._process.poll(), time.monotonic()
        if self._late:
            if code is not None or now_s > self._by_s + KILL_S:
                self._end(f"power_off_cmd did not end in {self._patience_s:g} s: {BY_HAND}")
        elif code == 0:
            self._end("power_off_cmd took its mains away")
        elif code is not None:
            last = self._heard.decode(errors="replace").strip().splitlines()[-1:]
            self._end(f"power_off_cmd failed ({' '.join(last)[:_WORDS] or code}): {BY_HAND}")
        elif now_s > self._by_s:
            self._late = True
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        return self._said

    def _listen(self) -> None:
        with suppress(BlockingIOError):
            self._heard = (self._heard + os.read(self._stderr.fileno(), 1 << 16))[-_TAIL_BYTES:]

    def _end(self, said: str) -> None:
        self._said = said
        if hasattr(self, "_stderr"):
            self._stderr.close()
        log.warning("%s: %s", self._printer, said)


def cut(command: str, printer: str, patience_s: float = PATIENCE_S) -> str:
    """Run the command, wait for it, and say in a few words what came of it. Never raises.

    Parameters
    ----------
    command, printer, patience_s
        See `PowerOff`.
    """
    run = PowerOff(command, printer, patience_s)
    while (said := run.outcome()) is None:
        time.sleep(LOOK_S)
    return said
