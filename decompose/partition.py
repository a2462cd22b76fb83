"""`decompose`: a model and printers in, checked parts out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np
import numpy.typing as npt

from decompose import parallelobox, unequal
from decompose.assignment import printers_for
from decompose.baselines import cube_skeleton, symmetry_based
from decompose.best import best_of
from decompose.check import check
from decompose.cost import POSE_ROTATIONS, CostModel, PrinterRoom
from decompose.errors import NoFit
from decompose.joints import faults, joints
from decompose.mesh import Model
from decompose.orientation import Pose, best_pose, measure
from decompose.piece import Piece, turned_planes
from decompose.problem import Found, GridFigures, Problem, checked, surface_bound_s
from decompose.report import Coverage, Decomposition, Engine, Options, Part

Floats = npt.NDArray[np.float64]

ENGINES: dict[Engine, Callable[[Problem], Found]] = {
    Engine.GUILLOTINE: unequal.search,
    Engine.PARALLELOBOX: parallelobox.search,
    Engine.SYMMETRY: symmetry_based.search,
    Engine.CUBE_SKELETON: cube_skeleton.search,
}


def decompose(
    model: Model,
    printers: Sequence[PrinterRoom],
    options: Options,
    cost: CostModel,
    executor: Executor | None = None,
) -> Decomposition:
    """Cut a model into parts that finish together.

    Parameters
    ----------
    model
        From `decompose.mesh.load_model`.
    printers
        Those that are free, one part each at most; a printer that may print in several rounds is there once
        for each. The guillotine engine cuts a part for its own printer's room and speed; the parts of the
        others fit all printers.
    options
        How to cut.
    cost
        Print time of a part.
    executor
        For attempts that may run side by side; threads do.

    Raises
    ------
    NoFit
        The parts are more than the printers, with how many would do.
    GeometryError
        The result breaks a geometry rule.
    """
    began_s = perf_counter()
    checked(model, tuple(printers), options)
    vertices, faces = model.solid.arrays()
    serial = serial_seconds(vertices, faces, cost, options.fit_first_layer)
    serial_s = perf_counter() - began_s
    problem = Problem(model, tuple(printers), cost, options, executor)
    by_engine = partial(_by_engine, serial=serial)
    found = best_of(problem, by_engine) if options.engine is Engine.BEST else by_engine(problem)
    stages = found.compute_s | {"serial": serial_s, "total": perf_counter() - began_s}
    return replace(found, compute_s=stages)


def _by_engine(problem: Problem, serial: tuple[float, float]) -> Decomposition:
    """The result of one engine, checked; `serial` is what `serial_seconds` says of the model."""
    watch = _Watch()
    if problem.options.faithful and problem.options.engine is Engine.PARALLELOBOX:
        problem = replace(problem, options=parallelobox.paper_settings(problem.options))
    problem = replace(problem, lap=watch.lap)
    printers, options = problem.printers, problem.options
    found = ENGINES[options.engine](problem)
    watch.lap("engine")
    parts = _parts(found.pieces, problem)
    watch.lap("parts")
    boxed = all(len(piece.boxes_mm) for piece in found.pieces)
    boxes_mm = np.concatenate([p.boxes_mm for p in found.pieces]) if boxed else np.zeros((0, 2, 3))
    coverage = check(parts, boxes_mm, found.model, printers, options.min_wall_mm)
    watch.lap("check")
    return _report(problem, found, parts, coverage, serial, watch.laps())


def _report(
    problem: Problem,
    found: Found,
    parts: Sequence[Part],
    coverage: Coverage,
    serial: tuple[float, float],
    laps: dict[str, float],
) -> Decomposition:
    factors = {printer.name: printer.time_factor for printer in problem.printers}
    makespan_s = max(p.estimated_s * factors[p.printer] for p in parts)
    touching = joints(parts)
    bound_s = surface_bound_s(problem.model.solid.area_mm2, 0.0, len(problem.printers), problem.cost)
    grid = found.grid or GridFigures(makespan_s, problem.quickest * bound_s, None)
    return Decomposition(
        engine=problem.options.engine,
        options=problem.options,
        serial_s=serial[0],
        serial_as_is_s=serial[1],
        makespan_s=makespan_s,
        sum_s=sum(p.estimated_s for p in parts),
        grid_makespan_s=grid.makespan_s,
        lower_bound_s=grid.lower_bound_s,
        gap=(grid.makespan_s - grid.lower_bound_s) / grid.lower_bound_s,
        compute_s=laps,
        parts=tuple(_turned_back(part, found.rotation @ problem.frame) for part in parts),
        coverage=coverage,
        cells=grid.cells,
        joints=tuple(touching),
        faults=tuple(faults(parts, problem.options.min_glue_mm2, touching)),
    )


def _parts(pieces: Sequence[Piece], problem: Problem) -> list[Part]:
    """Pieces in their best poses, numbered by position from the bottom up, each with a printer."""
    order = sorted(pieces, key=lambda p: tuple(np.round(p.solid.bounds_mm.mean(axis=0)[::-1], 3)))
    posed = [_fitting(pose) for pose in problem.poses(order)]
    takers = printers_for(posed, problem.printers)
    if takers is None:
        raise NoFit(f"{len(posed)} parts do not fit these printers, each on one of its own", len(posed))
    digits = max(2, len(str(len(order))))
    return [
        Part(
            id=f"p{i + 1:0{digits}d}",
            solid=piece.solid,
            to_model=pose.to_model,
            estimated_s=pose.seconds,
            printer=takers[i].name,
            brim_width_mm=pose.brim_width_mm,
            layer_0_expansion_mm=pose.layer_0_expansion_mm,
            planes=piece.planes,
            stands=pose.stands,
        )
        for i, (piece, pose) in enumerate(zip(order, posed, strict=True))
    ]


def _fitting(pose: Pose | None) -> Pose:
    if pose is None:
        raise NoFit("a part fits no printer in any pose: take another engine, or a finer --granularity")
    return pose


def _turned_back(part: Part, rotation: Floats) -> Part:
    """A part in the frame of the model as it was; `rotation` (3, 3) led to the frame of the cut."""
    if (rotation == np.eye(3)).all():
        return part
    back = np.eye(4)
    back[:3, :3] = rotation.T
    return replace(
        part,
        solid=part.solid.turned(rotation.T),
        to_model=back @ part.to_model,
        planes=turned_planes(part.planes, rotation.T),
    )


def serial_seconds(
    vertices: Floats, faces: npt.NDArray[np.int64], cost: CostModel, fit_first_layer: bool
) -> tuple[float, float]:
    """A whole model on a printer without limits, in seconds: in its best pose, and as it stands."""
    uncut = np.zeros(len(faces), dtype=np.bool_)
    best = best_pose(vertices, faces, uncut, (), cost, fit_first_layer)
    as_is = measure(vertices, faces, uncut, POSE_ROTATIONS[4], cost, fit_first_layer)
    assert best is not None  # nothing is too large for a printer without limits
    return best.seconds, as_is.seconds


class _Watch:
    """Wall time by stage."""

    def __init__(self) -> None:
        self._start = self._last = perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        now = perf_counter()
        self._laps[stage] = now - self._last
        self._last = now

    def laps(self) -> dict[str, float]:
        return {**self._laps, "total": self._last - self._start}
