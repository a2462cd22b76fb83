"""Effort of a search: work is counted, not timed, so that the result is the same on every machine.

A unit of each kind of work counts as a fixed time on one core of a typical machine (measured by
`bench/search/effort.py`). Work is recorded by the thread that distributes it, not by the threads that do it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum


class Work(StrEnum):
    """Kinds of work, named by their units."""

    FACE_GRIDDED = "face-gridded"  # a triangle of the model that is added to a grid
    BOX_PRICED = "box-priced"  # a box of the grid whose print time is estimated
    SUM = "sum"  # a sum of the printer counts of both sides of a cut, in a search for a partition
    FACE_CUT = "face-cut"  # a triangle of a solid that is cut
    FACE_POSED = "face-posed"  # a triangle of a piece for which the best pose is sought
    PIECE_POSED = "piece-posed"
    FACE_MEASURED = "face-measured"  # a triangle of a piece that is priced in a given pose
    PIECE_MEASURED = "piece-measured"
    FACE_SLOPED = "face-sloped"  # a triangle of a piece whose price is differentiated by its planes
    POINT_CLUSTERED = "point-clustered"  # a vertex compared with a cluster, to draw seeds of blocks
    CELL_GROWN = "cell-grown"  # a cell of the grid in one attempt to cover the grid with growing boxes
    BOX_PROVEN = "box-proven"  # a box of the grid in the proof of a lower bound


WORK_NS = {
    Work.FACE_GRIDDED: 4_000.0,
    Work.BOX_PRICED: 100.0,
    Work.SUM: 0.4,
    Work.FACE_CUT: 100.0,
    Work.FACE_POSED: 3_000.0,
    Work.PIECE_POSED: 9e6,
    Work.FACE_MEASURED: 1_000.0,
    Work.PIECE_MEASURED: 3e6,
    Work.FACE_SLOPED: 1_000.0,
    Work.POINT_CLUSTERED: 300.0,
    Work.CELL_GROWN: 1_500.0,
    Work.BOX_PROVEN: 400.0,
}
"""Nanoseconds that a unit of each kind takes on one core of a typical machine."""


@dataclass(slots=True)
class Effort:
    """Work that has been done, and the budget.

    Attributes
    ----------
    budget_s
        Maximum work in seconds of one core of a typical machine.
    done_units
        Number of units of each kind that have been done.
    is_cut_short
        Whether a search has stopped because of the budget.
    on_spent
        Function that is called with the spent seconds whenever work is started; None if there is none.
    reserved_s
        Part of the budget that no search may use, for work that is always done.
    """

    budget_s: float = math.inf
    done_units: Counter[Work] = field(default_factory=Counter)
    is_cut_short: bool = False
    on_spent: Callable[[float], None] | None = None
    reserved_s: float = 0.0

    def restart(self) -> None:
        """Extend the budget by the work done so far, for a search that has to begin again."""
        self.budget_s += self.spent_s
        self.is_cut_short = False

    @property
    def spent_s(self) -> float:
        """Work done, in seconds of one core of a typical machine."""
        return sum(unit_ns * self.done_units[work] for work, unit_ns in WORK_NS.items()) / 1e9

    def record(self, work: Work, units: int) -> None:
        """Record units of work when they are started."""
        self.done_units[work] += units
        if self.on_spent is not None:
            self.on_spent(self.spent_s)

    def can_afford(self, work: Work, units: int) -> bool:
        """Check whether the budget is enough for some work; record in `is_cut_short` if it is not."""
        total_s = self.spent_s + self.reserved_s + units * WORK_NS[work] / 1e9
        can_afford = total_s <= self.budget_s
        self.is_cut_short = self.is_cut_short or not can_afford
        return can_afford

    def is_spent(self) -> bool:
        """Check whether the budget is spent; record in `is_cut_short` if it is."""
        is_spent = self.spent_s + self.reserved_s >= self.budget_s
        self.is_cut_short = self.is_cut_short or is_spent
        return is_spent
