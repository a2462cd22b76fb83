"""`decompose`: a model and printers in, checked parts out."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from time import perf_counter

import numpy as np
import numpy.typing as npt

from decompose import parallelobox
from decompose.bound import makespan_bound
from decompose.boxes import Box, Boxes, all_boxes, box_index
from decompose.check import Coverage, check
from decompose.cost import POSE_ROTATIONS, CostModel, PrinterRoom
from decompose.cut import cut_box, cut_faces
from decompose.errors import DecomposeError, NoFit
from decompose.grid import GRANULARITY, VOLUME, Grid, build_grid
from decompose.guillotine import UNREACHABLE, Partitioner
from decompose.mesh import Model
from decompose.orientation import Pose, best_pose, measure
from decompose.parallelobox import align, as_it_stands, paper_settings
from decompose.report import Decomposition, Engine, Interior, Options, Part
from decompose.solid import Solid

Floats = npt.NDArray[np.float64]
Piece = tuple[Solid, Floats]  # and the corners (2, 3) of the box that it was cut out of

AUTO_GRANULARITY = 15
FINEST_FOR_ROOM = 24  # a finer grid takes gigabytes
CELLS_PER_PART = 400  # with fewer, one layer of cells is too large a share of a part


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
        for each. All parts fit the smallest.
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
    if not printers:
        raise NoFit("no printer: name at least one")
    for printer in printers:
        if not printer.boxes:
            raise NoFit(f"{printer.name} has no room for a part; take a narrower brim or a larger volume")
    if not (math.isfinite(options.min_wall_mm) and options.min_wall_mm >= 0.0):
        raise DecomposeError(f"--min-wall {options.min_wall_mm}: give a number of mm, 0 or more")
    watch = _Watch()
    grows = options.engine is Engine.PARALLELOBOX
    if grows and options.faithful:
        options = paper_settings(options)
    vertices, faces = model.solid.arrays()
    aligned = align(model, options.seed) if grows else as_it_stands(model)
    model = aligned.model
    turned, turned_faces = model.solid.arrays()
    triangles = turned[turned_faces]
    keep = options.interior is Interior.KEEP
    room_mm = [min(max(box[axis] for box in p.boxes) for p in printers) for axis in range(3)]
    cells = granularity(options.granularity, len(printers), max(model.extents_mm) / min(room_mm))

    def lay(overhang_cos: float) -> Grid:
        wall_mm, plane_at = options.min_wall_mm, aligned.mirror
        return build_grid(triangles, cells, wall_mm, keep, overhang_cos, cost.skin_cos, plane_at)

    grid = lay(cost.overhang_cos)
    watch.lap("grid")
    boxes = all_boxes(grid, list(printers), cost)
    watch.lap("boxes")
    bound = lower_bound_s(model.solid.area_mm2, grid, len(printers), cost)
    if grows:
        cut = parallelobox.search(aligned, grid, boxes, len(printers), options, lay, executor)
        found, pieces = list(cut), _with_bounds(cut, grid)
    else:
        found, pieces = _search(model, grid, boxes, len(printers), room_mm, bound)
    watch.lap("search")
    grid_makespan = boxes.longest_s(found)
    if options.prove:
        proof = makespan_bound(boxes, grid.needed, len(printers), found, grid_makespan)
        bound = max(bound, proof.seconds)
    watch.lap("bound")
    parts = _parts(pieces, printers, cost, options.fit_first_layer)
    serial_s, as_is_s = serial_seconds(vertices, faces, cost, options.fit_first_layer)
    makespan = max(p.estimated_s for p in parts)
    result = Decomposition(
        engine=options.engine,
        options=options,
        serial_s=serial_s,
        serial_as_is_s=as_is_s,
        makespan_s=makespan,
        sum_s=sum(p.estimated_s for p in parts),
        grid_makespan_s=grid_makespan,
        lower_bound_s=bound,
        gap=(grid_makespan - bound) / bound,
        compute_s={},
        parts=tuple(parts),
        coverage=Coverage(0.0, 0.0),
        cells=grid.shape,
    )
    watch.lap("parts")
    coverage = check(result, model, printers, grid, found)
    watch.lap("check")
    in_frame = tuple(aligned.turned_back(part) for part in result.parts)
    return replace(result, parts=in_frame, coverage=coverage, compute_s=watch.laps())


def granularity(wanted: str | int, printers: int, rooms_long: float = 1.0) -> int:
    """The cube root of the number of cells, from a name, a number, or ``auto``.

    `rooms_long` is the model's longest side over the narrowest side of a part's room: on ``auto`` a cell is
    not much larger than half a room.
    """
    if wanted == "auto":
        finer = math.ceil(math.pow(CELLS_PER_PART * printers, 1.0 / 3.0))
        for_room = min(FINEST_FOR_ROOM, math.ceil(2.0 * rooms_long))
        return max(AUTO_GRANULARITY, finer, for_room)
    if wanted in GRANULARITY:
        return GRANULARITY[str(wanted)]
    try:
        number = int(wanted)
    except ValueError:
        number = 0
    if not 1 <= number <= 60:
        known = ", ".join(GRANULARITY)
        raise DecomposeError(f"--granularity {wanted}: give auto, one of {known}, or a number from 1 to 60")
    return number


def lower_bound_s(area_mm2: float, grid: Grid, printers: int, cost: CostModel) -> float:
    """A makespan that no partition into boxes of this grid undercuts, in seconds.

    Every partition prints the whole surface, all of it at best as level skin or as the flattest slope that
    has none, and all needed cells; cuts, supports, brims and least times of layers only add. The work is
    shared by at most `printers` parts, each with its fixed time.
    """
    slope = cost.lateral_s_mm2 * math.sqrt(max(0.0, 1.0 - cost.skin_cos**2))
    surface = area_mm2 * min(slope, cost.skin_s_mm2)
    volume = float(grid.sums[grid.needed][:, VOLUME].sum())
    return cost.fixed_s + (surface + cost.volume_s_mm3 * volume) / printers


def _search(
    model: Model, grid: Grid, boxes: Boxes, printers: int, room_mm: list[float], bound_s: float
) -> tuple[list[Box], list[Piece]]:
    """The boxes of the least makespan, and the pieces of solid in them.

    The grid takes the solid in a cell as one piece; where a chosen box turns out to have more pieces, that is
    put into the table and the search is made again. Counts only grow, so the makespan only grows: the first
    solution whose counts are all true is the best.
    """
    solver = Partitioner(boxes)
    cut: dict[Box, list[Solid]] = {}
    least_s = bound_s
    while True:
        makespan = solver.least_makespan(printers, least_s)
        if makespan is None:
            raise _no_fit(model, grid, solver, printers, room_mm)
        chosen = solver.chosen()
        wrong = False
        for box in chosen:
            if box not in cut:
                cut[box] = cut_box(model.solid, grid, box)
            at = box_index(box, boxes.shape)
            if len(cut[box]) != int(boxes.pieces[at]):
                wrong = wrong or len(cut[box]) > int(boxes.pieces[at])
                boxes.pieces[at] = len(cut[box])
        if not wrong:
            return chosen, _with_bounds({box: cut[box] for box in chosen}, grid)
        least_s = max(bound_s, makespan - 1.0)


def _with_bounds(cut: dict[Box, list[Solid]], grid: Grid) -> list[Piece]:
    return [(solid, np.stack(grid.bounds_mm(box))) for box, solids in cut.items() for solid in solids]


def _no_fit(model: Model, grid: Grid, solver: Partitioner, printers: int, room_mm: list[float]) -> NoFit:
    needed = solver.parts(sys.float_info.max)  # below inf, which stands for no fit
    size = " x ".join(f"{v:.0f}" for v in model.extents_mm)
    if needed >= UNREACHABLE:
        least_mm = max(float(np.diff(planes).max()) for planes in grid.planes)
        room = " x ".join(f"{v:.0f}" for v in room_mm)
        return NoFit(
            f"{size} mm is cut into blocks of {least_mm:.0f} mm at least, and a part has room for {room} mm "
            f"(clips and brim are off): printers with room for {math.ceil(least_mm)} mm each way would do"
        )
    longest = float(model.extents_mm.max()) * (printers / needed) ** (1.0 / 3.0)
    return NoFit(
        f"{size} mm needs {needed} parts, each on a printer of its own, and there are {printers}: free more "
        f"printers, or try --longest-side {max(1.0, math.floor(longest)):.0f}",
        needed,
    )


def _parts(
    pieces: list[Piece], printers: Sequence[PrinterRoom], cost: CostModel, fit_first_layer: bool
) -> list[Part]:
    """Pieces in their best poses, numbered by position from the bottom up, each with a printer."""
    order = sorted(pieces, key=lambda p: tuple(np.round(p[0].bounds_mm.mean(axis=0)[::-1], 3)))
    rooms = list(dict.fromkeys(replace(printer, name="") for printer in printers))
    posed = [_posed(piece, rooms, cost, fit_first_layer) for piece in order]
    free = list(printers)
    # The part that fits the fewest printers chooses first.
    names: dict[int, str] = {}
    fitting = {i: [p for p in printers if p.fits(*pose.size_mm)] for i, pose in enumerate(posed)}
    for i in sorted(fitting, key=lambda i: (len(fitting[i]), i)):
        taken = next((p for p in free if p in fitting[i]), None)
        if taken is None:
            raise NoFit(f"part {i + 1} of {len(order)} fits no printer that is left", len(order))
        free.remove(taken)
        names[i] = taken.name
    digits = max(2, len(str(len(order))))
    return [
        Part(
            id=f"p{i + 1:0{digits}d}",
            solid=solid,
            to_model=pose.to_model,
            estimated_s=pose.seconds,
            printer=names[i],
            brim_width_mm=pose.brim_width_mm,
            layer_0_expansion_mm=pose.layer_0_expansion_mm,
            box_mm=box_mm,
        )
        for i, ((solid, box_mm), pose) in enumerate(zip(order, posed, strict=True))
    ]


def _posed(piece: Piece, rooms: Sequence[PrinterRoom], cost: CostModel, fit_first_layer: bool) -> Pose:
    """The best pose that fits every printer; a box was only chosen because it has one."""
    solid, box_mm = piece
    vertices, faces = solid.arrays()
    cut = cut_faces(vertices, faces, box_mm)
    pose = best_pose(vertices, faces, cut, rooms, cost, fit_first_layer)
    if pose is None:
        raise NoFit("a part fits no printer in any pose; this is a fault in the tables of the search")
    return pose


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
