"""Records of a result: errors of its geometry, attempts, and boxes from which the parts were cut."""

from __future__ import annotations

from dataclasses import dataclass

from decompose.arrays import Floats
from decompose.options import Engine
from decompose.printers import TargetPrinter


@dataclass(frozen=True, slots=True)
class Coverage:
    """Errors of the parts: of the area of their surface, and the volume that they share.

    Attributes
    ----------
    surface_error
        Difference between the area of the parts without their cut faces and the area of the model, as a share
        of the area of the model.
    overlap_mm3
        Volume in which parts overlap.
    """

    surface_error: float
    overlap_mm3: float


@dataclass(frozen=True, slots=True)
class Attempt:
    """Record of an attempt of the engine `best`, which runs another engine on a grid.

    Attributes
    ----------
    engine, granularity
        Engine, and granularity of the grid.
    yaw_deg
        Angle by which the model was rotated about z.
    makespan_s
        Makespan of the result; None if there is no result.
    compute_s, effort_s
        Wall time, and the work that was counted, which is the same on every machine (`problem.Effort`).
    finished
        Whether the search ended within the budget.
    reason
        Reason why there is no result; empty if there is a result.
    """

    engine: Engine
    granularity: str | int
    yaw_deg: float = 0.0
    makespan_s: float | None = None
    compute_s: float = 0.0
    effort_s: float = 0.0
    finished: bool = True
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Cutting:
    """Boxes from which the parts were cut, so that their planes can be moved again (`decompose.rebalance`).

    Attributes
    ----------
    granularity
        Granularity of the grid.
    frame
        (3, 3) rotation into the frame of the cut: ``v_cut = frame @ v_model``.
    boxes_mm
        (parts, 2, 3) corners of the box from which each part was cut, in the frame of the cut.
    cut_for
        Printer for which each part was cut; None for all printers.
    printers
        Printers of the problem.
    prices_s
        Price of each part in its printing pose; empty if the prices are not known.
    """

    granularity: str | int
    frame: Floats
    boxes_mm: Floats
    cut_for: tuple[TargetPrinter | None, ...]
    printers: tuple[TargetPrinter, ...]
    prices_s: tuple[float, ...] = ()
