"""Times at which stills are requested from a camera. Pure.

Stills are requested while a person views the camera, and at the moments of a print (`Moment`) of which a
still is kept.
Requests are at least two seconds apart; the interval doubles with each failure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from farm.model import AgentSnapshot, Moment, PrintState
from farm.state import Books

MIN_INTERVAL_S = 2.0
MAX_INTERVAL_S = 60.0
MAX_STILL_AGE_S = MIN_INTERVAL_S
"""Age in wall seconds up to which viewers get the last still instead of a new one."""
END_STILL_TIMEOUT_S = 60.0
"""Wall seconds after the end of a print within which its last still is fetched, before the bed is cleared."""
_FIRST_LAYERS_DIVISOR = 10
"""Divisor of the number of layers: during the first tenth of the layers, the first layer is visible."""


@dataclass(frozen=True, slots=True)
class CameraState:
    """State of the attempts to fetch a still from one camera. Times are monotonic, in seconds.

    Attributes
    ----------
    last_attempt_s
        Time at which the last attempt began; None if there was none.
    failure_count
        Number of attempts that have failed since the last still.
    problem
        Reason why the last attempt failed; None if it succeeded.
    """

    last_attempt_s: float | None = None
    failure_count: int = 0
    problem: str | None = None

    def begin(self, now_s: float) -> CameraState:
        """Return the state after the start of an attempt."""
        return replace(self, last_attempt_s=now_s)

    def succeed(self) -> CameraState:
        """Return the state after a successful attempt."""
        return replace(self, failure_count=0, problem=None)

    def fail(self, problem: str) -> CameraState:
        """Return the state after an attempt that failed."""
        return replace(self, failure_count=self.failure_count + 1, problem=problem)

    @property
    def next_attempt_s(self) -> float:
        """Earliest time of the next attempt."""
        if self.last_attempt_s is None:
            return 0.0
        doublings = min(self.failure_count, 10)
        return self.last_attempt_s + min(MAX_INTERVAL_S, MIN_INTERVAL_S * 2.0**doublings)


@dataclass(frozen=True, slots=True)
class DueStill:
    """Still that must be fetched now and stored with a print."""

    print_id: str
    printer: str
    moment: Moment


def find_due_stills(
    books: Books, snapshots: Mapping[str, AgentSnapshot], printers: frozenset[str], now_s: float, scale: float
) -> Iterator[DueStill]:
    """Yield the stills that are due: each must be fetched now and stored with its print.

    Parameters
    ----------
    books
        The books.
    snapshots
        The agents' latest snapshots, by printer.
    printers
        The printers with a camera.
    now_s, scale
        Time on the farm's clock, and farm seconds per wall second.
    """
    for name in printers & books.printers.keys():
        attempt = books.find_open_print(name) or books.find_last_print(name)
        if attempt is None:
            continue
        moment = Moment.FAILURE if attempt.state is PrintState.FAILED else Moment.END
        if not attempt.state.ended:
            moment = Moment.FIRST_LAYER
            is_due = _shows_first_layer(attempt.id, snapshots.get(name))
        else:
            is_due = (
                attempt.ended_s is not None and 0.0 <= now_s - attempt.ended_s <= END_STILL_TIMEOUT_S * scale
            )
        if is_due and all(still.moment is not moment for still in attempt.stills):
            yield DueStill(attempt.id, name, moment)


def _shows_first_layer(print_id: str, snapshot: AgentSnapshot | None) -> bool:
    """Return whether the first layer of an open print is complete, and not yet hidden by later ones."""
    report = None if snapshot is None else snapshot.print
    if report is None or report.print_id != print_id or report.layer is None:
        return False
    return report.state is PrintState.PRINTING and 2 <= report.layer <= max(
        3, report.layers // _FIRST_LAYERS_DIVISOR
    )
