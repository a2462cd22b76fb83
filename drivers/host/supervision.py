"""Decisions about the agents of a host: restarts, and the reports that are sent to the daemon. Pure."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

_FIRST_WAIT_S = 0.5
_MAX_WAIT_S = 60.0
_STEADY_RUN_S = 60.0  # an agent that ran for this long is restarted without delay
_VOLATILE_FIELDS = {
    "": ("now_s", "starved_s"),
    "nozzle": ("now_c",),
    "bed": ("now_c",),
    "print": ("line", "progress_s", "starved_s", "layer", "z_mm", "feature"),
}
"""Fields of a snapshot that change all the time, by the record that contains them."""


@dataclass(frozen=True, slots=True)
class Backoff:
    """Wait before an ended agent is restarted: none at first, then 0.5 s, then twice as long each time.

    Attributes
    ----------
    started_s
        Time of the last start, on a monotonic clock.
    wait_s
        Seconds from that start to the next one.
    """

    started_s: float = -math.inf
    wait_s: float = 0.0

    def may_start(self, now_s: float) -> bool:
        """Return whether the wait is over."""
        return now_s >= self.started_s + self.wait_s

    def record_start(self, now_s: float) -> Backoff:
        """Return the backoff after a start at `now_s`."""
        if now_s - self.started_s > max(_STEADY_RUN_S, 2 * self.wait_s):
            return Backoff(now_s, 0.0 if self.started_s == -math.inf else _FIRST_WAIT_S)
        return Backoff(now_s, min(_MAX_WAIT_S, max(_FIRST_WAIT_S, 2 * self.wait_s)))


class ReportFilter:
    """Filter that selects which lines of an agent are sent to the daemon.

    Replies pass at once, and so do snapshots that differ in more than temperatures and progress. Other
    snapshots pass if the last one passed at least `report_interval_s` earlier.

    Parameters
    ----------
    report_interval_s
        Wall seconds between two snapshots that differ only in temperatures and progress.
    """

    def __init__(self, report_interval_s: float) -> None:
        self._report_interval_s = report_interval_s
        self._last_passed_s = -math.inf
        self._last_fields: dict[str, Any] | None = None

    def passes(self, line: bytes, now_s: float) -> bool:
        """Return whether to relay a line that was received at `now_s` of a monotonic clock."""
        if self._report_interval_s <= 1.0:
            return True
        try:
            fields = _read_fields(line)
        except (ValueError, TypeError, AttributeError):
            return True  # the daemon handles an invalid line
        if fields is None:
            return True
        if fields == self._last_fields and now_s - self._last_passed_s < self._report_interval_s:
            return False
        self._last_fields, self._last_passed_s = fields, now_s
        return True


def _read_fields(line: bytes) -> dict[str, Any] | None:
    """Read a snapshot without the fields that change all the time; None if it is not a snapshot."""
    fields: dict[str, Any] = json.loads(line)
    if fields.get("kind") != "snapshot":
        return None
    for name, volatile_fields in _VOLATILE_FIELDS.items():
        record = fields if name == "" else fields.get(name) or {}
        for field in volatile_fields:
            record.pop(field, None)
    return fields
