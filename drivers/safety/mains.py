"""Mains switch of a printer: a command of the fleet that is run if heaters were not confirmed off."""

from __future__ import annotations

import logging
import os
import shlex
import signal
import subprocess
import time
from contextlib import suppress

log = logging.getLogger(__name__)

TIMEOUT_S = 10.0  # wall seconds for a relay to answer
POLL_INTERVAL_S = 0.05  # wall seconds between two checks for the end of the command
KILL_TIMEOUT_S = 1.0  # wall seconds for a killed process to end
SWITCH_OFF_ADVICE = "switch it off by hand"
NO_COMMAND_OUTCOME = f"it has no power_off_cmd: {SWITCH_OFF_ADVICE}"
_STDERR_BYTES, _MESSAGE_CHARACTERS = 4096, 200  # parts of the command's stderr that are kept and shown


class PowerOffRun:
    """One run of the command. The methods neither wait nor raise.

    The command runs in its own process session, and thus survives an agent that is killed.

    Parameters
    ----------
    command
        `power_off_cmd` of `fleet.yaml`, split as in a shell, but run without one; ``{printer}`` is replaced
        by the name.
    printer
        The printer's name in the fleet.
    timeout_s
        Wall seconds after which the command is killed.
    """

    def __init__(self, command: str, printer: str, timeout_s: float = TIMEOUT_S) -> None:
        self._printer, self._timeout_s = printer, timeout_s
        self._deadline_s = time.monotonic() + timeout_s
        self._is_killed = False
        self._stderr_tail = b""
        self._outcome: str | None = None
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
            self._end(f"power_off_cmd could not be run ({error}): {SWITCH_OFF_ADVICE}")

    def poll_outcome(self) -> str | None:
        """Return the outcome as a user-facing clause; None while the command runs."""
        if self._outcome is not None:
            return self._outcome
        self._read_stderr()
        code, now_s = self._process.poll(), time.monotonic()
        if self._is_killed:
            if code is not None or now_s > self._deadline_s + KILL_TIMEOUT_S:
                self._end(f"power_off_cmd did not end in {self._timeout_s:g} s: {SWITCH_OFF_ADVICE}")
        elif code == 0:
            self._end("power_off_cmd cut its mains")
        elif code is not None:
            last_lines = self._stderr_tail.decode(errors="replace").strip().splitlines()[-1:]
            message = " ".join(last_lines)[:_MESSAGE_CHARACTERS]
            self._end(f"power_off_cmd failed ({message or code}): {SWITCH_OFF_ADVICE}")
        elif now_s > self._deadline_s:
            self._is_killed = True
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        return self._outcome

    def _read_stderr(self) -> None:
        with suppress(BlockingIOError):
            self._stderr_tail = (self._stderr_tail + os.read(self._stderr.fileno(), 1 << 16))[-_STDERR_BYTES:]

    def _end(self, outcome: str) -> None:
        self._outcome = outcome
        if hasattr(self, "_stderr"):
            self._stderr.close()
        log.warning("%s: %s", self._printer, outcome)


def cut_mains(command: str, printer: str, timeout_s: float = TIMEOUT_S) -> str:
    """Run the command, wait for its end, and return the outcome as a user-facing clause. Never raises.

    Parameters
    ----------
    command, printer, timeout_s
        See `PowerOffRun`.
    """
    run = PowerOffRun(command, printer, timeout_s)
    while (outcome := run.poll_outcome()) is None:
        time.sleep(POLL_INTERVAL_S)
    return outcome
