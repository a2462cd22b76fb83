"""Choice of the printers that a model is cut for: one, all, as many as are worth it, or to end in time."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace

from decompose.auto import CountGoal, decompose_auto
from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.geometry import Model
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import PrinterRoom
from decompose.results import Decomposition

LATE_SHARE = 1.1
"""Margin of `--done-by`, for the time of planning and for prints that take longer."""


@dataclass(frozen=True, slots=True)
class ModelCutter:
    """A model, and the printers that it may be cut for. Every method raises the errors of `decompose`."""

    model: Model
    rooms: list[PrinterRoom]
    options: Options
    cost: CostModel
    executor: Executor

    def cut_for_all(self) -> Decomposition:
        """Cut the model for all of the printers."""
        return decompose_model(self.model, self.rooms, self.options, self.cost, self.executor)

    def cut_for_worthwhile(self, within_s: float | None = None) -> Decomposition:
        """Cut the model for as many printers as are worth it, or as few as end within a time."""
        goal = CountGoal(within_s=within_s)
        return decompose_auto(self.model, self.rooms, self.options, self.cost, self.executor, goal)

    def cut_for_one(self) -> Decomposition | None:
        """Keep the model whole, on the lowest printer that can hold it; None where none can.

        Who wants it sooner says how many printers.
        """
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

    def cut_in_time(self, within_s: float) -> Decomposition:
        """Cut the model into as few parts as end within a time, with a margin; else into the soonest."""
        limit_s = within_s / LATE_SHARE
        whole = self.cut_for_one()
        if whole is not None and whole.makespan_s <= limit_s:
            return whole
        return self.cut_for_worthwhile(within_s=limit_s)
