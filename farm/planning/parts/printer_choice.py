"""How a job's model is cut: for all of its printers, for as many as are worth it, or to be done in time."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace

from decompose.auto import decompose_auto
from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.geometry import Model
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import PrinterRoom
from decompose.results import Decomposition

LATE = 1.1
"""The margin of `--done-by`: planning itself takes its time, and so may a print."""


@dataclass(frozen=True, slots=True)
class Cut:
    """A model, and the printers that it may be cut for."""

    model: Model
    rooms: list[PrinterRoom]
    options: Options
    cost: CostModel
    executor: Executor

    def for_all(self) -> Decomposition:
        return decompose_model(self.model, self.rooms, self.options, self.cost, self.executor)

    def worth_it(self, within_s: float | None = None) -> Decomposition:
        return decompose_auto(
            self.model, self.rooms, self.options, self.cost, self.executor, within_s=within_s
        )

    def whole(self) -> Decomposition | None:
        """A model that one printer can hold stays in one part: who wants it sooner says how many printers."""
        x, y, z = map(float, self.model.extents_mm)
        poses = ((x, y, z), (y, z, x), (z, x, y))
        rooms = [room for room in self.rooms if any(room.fits(*pose) for pose in poses)]
        options = replace(self.options, engine=Engine.GUILLOTINE)  # which finds one part wherever one will do
        for room in sorted(rooms, key=lambda room: max(box[2] for box in room.boxes)):
            try:
                return decompose_model(self.model, [room], options, self.cost, self.executor)
            except NoFit:
                continue
        return None

    def in_time(self, within_s: float) -> Decomposition:
        """As few parts as are printed within that time, with a margin; where none are, the soonest."""
        enough_s = within_s / LATE
        whole = self.whole()
        if whole is not None and whole.makespan_s <= enough_s:
            return whole
        return self.worth_it(within_s=enough_s)
