"""Detection of a hung agent, by the process that listens to it on the same host.

A healthy agent sends something every 5 wall seconds, and every second while its printer is warm or printing.
A loaded host must not cost a print, so silence alone is not enough:

1. Silence is the sum of the intervals between the listener's own checks, each limited to a second: while the
   listener does not run, messages of the agent remain unread.
2. The state of the agent's process is read from the kernel after `SAMPLE_SILENCE_S` of silence, and again
   after `HUNG_SILENCE_S`.
3. If the process waited for a processor for half of the time between both samples, or if it waits for a disk,
   it is starved, and the count restarts. Otherwise it was stopped, slept, or ran without sending: it hangs.

A hung agent is killed; the next one finds the open print in the journal and resets the board.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SAMPLE_SILENCE_S, HUNG_SILENCE_S = 15.0, 30.0
_STARVED_FRACTION = 0.5
_MAX_INTERVAL_S = 1.0


@dataclass(frozen=True, slots=True)
class ProcessSample:
    """State of a process at one moment.

    Attributes
    ----------
    state
        Letter in /proc/PID/stat: R, S, D, T, Z.
    waited_s
        Seconds since the start of the process in which it was ready to run but had no processor.
    """

    state: str
    waited_s: float


def sample_process(pid: int) -> ProcessSample | None:
    """Read the state of a process; None if it does not exist. Without schedstat `waited_s` is 0."""
    process = Path("/proc") / str(pid)
    try:
        state = (process / "stat").read_text().rpartition(")")[2].split()[0]
        counts = (process / "schedstat").read_text().split() if (process / "schedstat").exists() else []
    except OSError:
        return None
    return ProcessSample(state, int(counts[1]) * 1e-9 if len(counts) > 1 else 0.0)


class Heartbeat:
    """Detector that recognises a hung agent by its silence."""

    def __init__(self) -> None:
        self._silence_s = 0.0
        self._last_check_s: float | None = None
        self._first_sample: ProcessSample | None = None

    def reset(self) -> None:
        """Restart the count, as the agent has sent something or was just started."""
        self._silence_s = 0.0
        self._first_sample = None

    def is_hung(self, now_s: float, sample: Callable[[], ProcessSample | None]) -> bool:
        """Add the time since the last call; return True if the agent hangs.

        Parameters
        ----------
        now_s
            Seconds of a monotonic clock.
        sample
            Function that samples the agent's process.
        """
        if self._last_check_s is not None:
            self._silence_s += min(now_s - self._last_check_s, _MAX_INTERVAL_S)
        self._last_check_s = now_s
        if self._silence_s >= SAMPLE_SILENCE_S and self._first_sample is None:
            self._first_sample = sample()
        if self._silence_s < HUNG_SILENCE_S:
            return False
        first_sample, last_sample = self._first_sample, sample()
        self.reset()
        if first_sample is None or last_sample is None:
            return False  # the process has ended
        waited_s = last_sample.waited_s - first_sample.waited_s
        is_starved = waited_s >= _STARVED_FRACTION * (HUNG_SILENCE_S - SAMPLE_SILENCE_S)
        return not is_starved and last_sample.state not in "DZ"
