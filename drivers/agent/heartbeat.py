"""Judgement of whether a silent agent is wedged, by whoever listens to it on its host.

An agent that is well says something every 5 wall seconds, and every second while it prints or is warm. A
busy machine must not cost a print, so silence alone is not enough:

1. Silence is counted by the listener's own looks, each for a second at most: where that itself did not
   run, the words of the agent wait unread.
2. After `LOOK_S` of it the kernel is asked what the agent's process does, and again after `WEDGED_S`.
3. In between it waited for a processor for half of the time or more, or it waits for a disk: it is starved,
   and the count begins anew. Else it was stopped, slept, or ran without a word: it is wedged.

A wedged agent is killed; the next one finds the open print in the journal and resets the board.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

LOOK_S, WEDGED_S = 15.0, 30.0
_STARVED_SHARE = 0.5
_LONGEST_LOOK_S = 1.0


@dataclass(frozen=True, slots=True)
class Look:
    """A process as the kernel sees it.

    Attributes
    ----------
    state
        Its letter in /proc/PID/stat: R, S, D, T, Z.
    waited_s
        How long it has been ready to run, but had no processor, since it began.
    """

    state: str
    waited_s: float


def look_at(pid: int) -> Look | None:
    """Ask the kernel; None where there is no such process. One that keeps no schedstat counts no waiting."""
    process = Path("/proc") / str(pid)
    try:
        state = (process / "stat").read_text().rpartition(")")[2].split()[0]
        counts = (process / "schedstat").read_text().split() if (process / "schedstat").exists() else []
    except OSError:
        return None
    return Look(state, int(counts[1]) * 1e-9 if len(counts) > 1 else 0.0)


class Heartbeat:
    """The silence of one agent."""

    def __init__(self) -> None:
        self._silent_s = 0.0
        self._before_s: float | None = None
        self._first: Look | None = None

    def heard(self) -> None:
        """It said something, or has just been started."""
        self._silent_s = 0.0
        self._first = None

    def wedged(self, now_s: float, look: Callable[[], Look | None]) -> bool:
        """Count the time since the last call, and judge.

        Parameters
        ----------
        now_s
            Wall seconds of any clock that does not jump.
        look
            Looks at the agent's process.
        """
        if self._before_s is not None:
            self._silent_s += min(now_s - self._before_s, _LONGEST_LOOK_S)
        self._before_s = now_s
        if self._silent_s >= LOOK_S and self._first is None:
            self._first = look()
        if self._silent_s < WEDGED_S:
            return False
        first, last = self._first, look()
        self.heard()
        if first is None or last is None:
            return False  # it ended meanwhile
        starved = last.waited_s - first.waited_s >= _STARVED_SHARE * (WEDGED_S - LOOK_S)
        return not starved and last.state not in "DZ"
