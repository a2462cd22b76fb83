"""Input and output of every engine, and the check of the input before an engine runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from decompose.arrays import Floats
from decompose.bound import bound_makespan, compute_surface_bound_s
from decompose.errors import DecomposeError, NoFit, format_size
from decompose.geometry import Model, Solid
from decompose.grid import VOLUME, Box, BoxTables, Grid, GridRules, build_grid, price_boxes
from decompose.options import Interior, Options
from decompose.pieces import Piece, assign_printers, find_cut_faces
from decompose.print_time import CostModel, Pose, find_best_pose
from decompose.printers import TargetPrinter
from decompose.problem.connector_cost import set_connector_prices
from decompose.problem.effort import Effort, Work
from decompose.problem.granularity import choose_granularity

T = TypeVar("T")
# For each of several printers, the sizes of the boxes of its build volume.
BuildVolumes = tuple[tuple[tuple[float, float, float], ...], ...]

MAX_PARTS = 200  # maximum number of printers or rounds that a message suggests; above it, it suggests none


@dataclass(frozen=True, slots=True)
class GridFigures:
    """Figures of an engine's grid.

    Attributes
    ----------
    makespan_s
        Makespan of the partition into boxes of the grid, according to the table of box prices.
    lower_bound_s
        Proven lower bound on the makespan.
    cells
        Shape of the grid; None without a grid.
    """

    makespan_s: float
    lower_bound_s: float
    cells: tuple[int, int, int] | None


@dataclass(frozen=True, eq=False)
class Problem:
    """A model to cut, and the printers to cut it for.

    Attributes
    ----------
    model
        Model in the frame in which it is cut.
    printers
        Free printers, each for one piece at most. A printer that prints several pieces one after another, in
        rounds, appears once for each round.
    cost
        Cost model for print times; it gets the prices of the pins and marks that the options request.
    options
        Engine, grid and limits.
    executor
        Threads for work that may run in parallel; None to run it serially.
    effort
        Work that has been done, and the budget. When the budget is spent, a search that has not ended stops
        with the best result so far.
    on_stage
        Function that is called with the name of each stage when it ends.
    best_known_s
        Makespan of the best result so far; no bound is proven for a result with a longer one.
    is_thorough
        Whether to shift the planes of several good partitions instead of the best one alone, and to repeat
        the shift as long as it gains time and the budget lasts.
    frame
        (3, 3) rotation from the frame of the input to that of `model`: ``v_cut = frame @ v_model``.
    """

    model: Model
    printers: tuple[TargetPrinter, ...]
    cost: CostModel
    options: Options
    executor: Executor | None = None
    effort: Effort = field(default_factory=Effort)
    on_stage: Callable[[str], None] = lambda stage: None
    best_known_s: float = math.inf
    is_thorough: bool = False
    frame: Floats = field(default_factory=lambda: np.eye(3))
    # For each solid that is still in use, its pose by the build volumes that it has to fit.
    _poses: WeakKeyDictionary[Solid, dict[BuildVolumes, Pose | None]] = field(
        default_factory=WeakKeyDictionary, init=False, repr=False
    )

    def __post_init__(self) -> None:
        """Set the prices of pins and marks, so that every search and table of the problem has them."""
        object.__setattr__(self, "cost", set_connector_prices(self.cost, self.options.connectors))

    @cached_property
    def distinct_printers(self) -> tuple[TargetPrinter, ...]:
        """One printer for each distinct build volume."""
        return tuple({printer.box_sizes_mm: printer for printer in self.printers}.values())

    @property
    def is_uniform(self) -> bool:
        """True if all printers have the same build volume and the same speed."""
        return len({(printer.box_sizes_mm, printer.time_factor) for printer in self.printers}) == 1

    @property
    def min_time_factor(self) -> float:
        """Time factor of the fastest printer."""
        return min(printer.time_factor for printer in self.printers)

    @property
    def max_part_sides_mm(self) -> list[float]:
        """Maximum sizes along x, y and z of a part that fits every printer."""
        return [
            min(max(box[axis] for box in p.box_sizes_mm) for p in self.distinct_printers) for axis in range(3)
        ]

    def rotate(self, rotation: Floats) -> Problem:
        """Rotate the model by a rotation (3, 3); return the same problem for the identity."""
        if (rotation == np.eye(3)).all():
            return self
        model = replace(self.model, solid=self.model.solid.rotate(rotation))
        return replace(self, model=model, frame=rotation @ self.frame)

    def map(self, function: Callable[..., T], *arguments: Iterable[Any]) -> Iterator[T]:
        """Call a function for each item, in parallel if there is an executor; yield the results in order."""
        return map(function, *arguments) if self.executor is None else self.executor.map(function, *arguments)

    def start_work(self, work: Callable[[], T]) -> Callable[[], T]:
        """Start work in the executor; return a function that waits for its result.

        Without an executor, the first call of that function does the work.
        """
        return cache(work) if self.executor is None else self.executor.submit(work).result

    def choose_granularity(self, model: Model) -> int:
        """Choose the granularity of the grid for a model in the frame of the cut."""
        size_ratio = max(model.extents_mm) / min(self.max_part_sides_mm)
        return choose_granularity(self.options.granularity, len(self.printers), size_ratio)

    def build_grid(
        self,
        model: Model,
        target_plane: tuple[int, float] | None = None,
        overhang_cos: float | None = None,
    ) -> Grid:
        """Build the grid over a model in the frame of the cut.

        Parameters
        ----------
        model
            Model in that frame.
        target_plane
            Axis and coordinate in mm of a plane that the grid must have; None if there is none.
        overhang_cos
            A face overhangs if the cosine of the angle between its normal and the downward direction is
            greater than this; None for the limit of the cost model.
        """
        options, cost = self.options, self.cost
        vertices, faces = model.solid.arrays()
        # Each face is clipped twice: to the cells, and to the finer cells that divide them.
        self.effort.record(Work.FACE_GRIDDED, 2 * len(faces))
        overhang_cos = cost.table_overhang_cos if overhang_cos is None else overhang_cos
        rules = GridRules(options.min_wall_mm, options.interior is Interior.KEEP, overhang_cos, cost.skin_cos)
        return build_grid(vertices[faces], self.choose_granularity(model), rules, target_plane)

    def price_boxes(self, grid: Grid, printers: Sequence[TargetPrinter] = ()) -> BoxTables:
        """Price every box of a grid; a box fits if it fits each of the printers.

        Parameters
        ----------
        grid
            Grid over the model.
        printers
            Printers that a box has to fit; empty for all printers of the problem.
        """
        boxes = price_boxes(grid, list(printers or self.distinct_printers), self.cost, self.executor)
        self.effort.record(Work.BOX_PRICED, len(boxes.seconds))
        return boxes

    def start_proof(self, grid: Grid, boxes: BoxTables, partition: Sequence[Box]) -> Callable[[], float]:
        """Start the proof of a lower bound on the makespan of boxes, in parallel if there is an executor.

        Parameters
        ----------
        grid, boxes
            Grid over the model, and its tables.
        partition
            Boxes of a partition; the bound cannot exceed their makespan.

        Returns
        -------
        Callable
            Function that waits for the proof, and returns a lower bound in s. The bound holds for all
            partitions of the grid, if times are those of the tables.
        """
        self.effort.record(Work.BOX_PROVEN, len(boxes.seconds))
        makespan_s = boxes.find_longest_time_s(partition)
        proof = self.start_work(
            partial(bound_makespan, boxes, grid.is_needed, len(self.printers), makespan_s)
        )
        return lambda: proof().seconds

    def compute_grid_figures(
        self,
        grid: Grid,
        boxes: BoxTables,
        partition: list[Box],
        pieces: Sequence[Piece],
        proof: Callable[[], float] | None = None,
    ) -> GridFigures:
        """Compute the makespan of boxes from the table of prices, and a lower bound for all partitions.

        The boxes fit every printer, and the fastest printer prints the slowest box. The bound is proven as if
        all printers were as fast as the fastest one.

        Parameters
        ----------
        grid, boxes
            Grid over the model, and its tables.
        partition
            Boxes of a partition.
        pieces
            Final pieces from these boxes, or from similar ones.
        proof
            Result of `start_proof`, if the proof has been started already.
        """
        printer_count = len(self.printers)
        times_s = sorted((boxes.find_longest_time_s([box]) for box in partition), reverse=True)
        needed_mm3 = float(grid.sums[grid.is_needed][:, VOLUME].sum())
        bound_s = compute_surface_bound_s(self.model.solid.area_mm2, needed_mm3, printer_count, self.cost)
        if proof is None and self.needs_proof(pieces):
            proof = self.start_proof(grid, boxes, partition)
        bound_s = bound_s if proof is None else max(bound_s, proof())
        factors = sorted(printer.time_factor for printer in self.printers)
        makespan_s = max(time_s * factor for time_s, factor in zip(times_s, factors, strict=False))
        return GridFigures(makespan_s, self.min_time_factor * bound_s, grid.shape)

    def needs_proof(self, pieces: Sequence[Piece]) -> bool:
        """Check whether these pieces may be the best result, for which a bound has to be proven."""
        if not self.options.prove:
            return False
        makespan_s = self.compute_makespan_s(pieces)
        # Either of two results with the same makespan may be chosen.
        return math.isfinite(makespan_s) and makespan_s <= self.best_known_s

    def compute_makespan_s(self, pieces: Sequence[Piece]) -> float:
        """Compute the makespan of pieces, each in its best pose; inf if they do not fit.

        The pieces are assigned to printers again, as in the result, even if they were cut for certain
        printers.
        """
        assigned_printers = self.assign_printers(pieces)
        if assigned_printers is None:
            return math.inf
        pairs = zip(self.find_poses(pieces), assigned_printers, strict=True)
        return max(pose.price_s * printer.time_factor for pose, printer in pairs if pose is not None)

    def assign_printers(self, pieces: Sequence[Piece]) -> list[TargetPrinter] | None:
        """Assign printers to pieces so that the makespan is minimal; None if the pieces do not all fit."""
        if len(pieces) > len(self.printers):
            return None
        poses = [pose for pose in self.find_poses(pieces) if pose is not None]
        return assign_printers(poses, self.printers) if len(poses) == len(pieces) else None

    def list_piece_printers(self, piece: Piece) -> tuple[TargetPrinter, ...]:
        """List the printers that a piece has to fit: its own, or one for each distinct build volume."""
        return self.distinct_printers if piece.printer is None else (piece.printer,)

    def find_pose(self, piece: Piece) -> Pose | None:
        """Find the best pose of a piece on its printers (`list_piece_printers`); None if there is none."""
        vertices, faces = piece.solid.arrays()
        is_cut = find_cut_faces(vertices, faces, piece.planes)
        printers = self.list_piece_printers(piece)
        return find_best_pose(vertices, faces, is_cut, printers, self.cost, self.options.fit_first_layer)

    def find_poses(self, pieces: Sequence[Piece]) -> list[Pose | None]:
        """Find the best pose of each piece, in parallel if there is an executor; poses are cached."""
        volumes = [self._list_build_volumes(piece) for piece in pieces]
        unposed_pieces = {
            (piece.solid, piece_volumes): piece
            for piece, piece_volumes in zip(pieces, volumes, strict=True)
            if piece_volumes not in self._poses.get(piece.solid, {})
        }
        self.effort.record(Work.PIECE_POSED, len(unposed_pieces))
        self.effort.record(Work.FACE_POSED, sum(piece.solid.face_count for piece in unposed_pieces.values()))
        new_poses = self.map(self.find_pose, unposed_pieces.values())
        for (solid, piece_volumes), pose in zip(unposed_pieces, new_poses, strict=True):
            self._poses.setdefault(solid, {})[piece_volumes] = pose
        return [
            self._poses[piece.solid][piece_volumes]
            for piece, piece_volumes in zip(pieces, volumes, strict=True)
        ]

    def keep_poses(self, pieces: Sequence[Piece], poses: Sequence[Pose | None]) -> None:
        """Keep poses of pieces for `find_poses`; None for a piece whose pose is still sought."""
        for piece, pose in zip(pieces, poses, strict=True):
            if pose is not None:
                self._poses.setdefault(piece.solid, {})[self._list_build_volumes(piece)] = pose

    def _list_build_volumes(self, piece: Piece) -> BuildVolumes:
        """List the build volumes of the printers that a piece has to fit."""
        return tuple(printer.box_sizes_mm for printer in self.list_piece_printers(piece))


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """Output of an engine: at most as many pieces as there are printers.

    Attributes
    ----------
    pieces
        Pieces, each of which fits the printer that it is cut for, or all printers if it is cut for none.
    model
        Model in the frame of the pieces.
    rotation
        (3, 3) rotation into that frame: ``v_cut = rotation @ v_model``.
    grid_figures
        Figures of the engine's grid; None without a grid.
    """

    pieces: tuple[Piece, ...]
    model: Model
    rotation: Floats
    grid_figures: GridFigures | None = None


def validate_problem(
    model: Model,
    printers: tuple[TargetPrinter, ...],
    options: Options,
) -> None:
    """Refuse a problem that no engine can work on.

    Parameters
    ----------
    model, printers, options
        As in `decompose.decompose_model`.

    Raises
    ------
    DecomposeError
        There is no printer, a printer has no build volume, the minimum of the wall or of the glue is negative
        or not finite, or the model is too long for all build volumes together.
    """
    if not printers:
        raise NoFit("no printer: name at least one")
    for printer in printers:
        if not printer.box_sizes_mm:
            raise NoFit(f"{printer.name} has no room for a part; choose a narrower brim or a larger volume")
    if not (math.isfinite(options.min_wall_mm) and options.min_wall_mm >= 0.0):
        raise DecomposeError(f"--min-wall {options.min_wall_mm}: give a number of mm, 0 or more")
    if not (math.isfinite(options.min_glue_mm2) and options.min_glue_mm2 >= 0.0):
        raise DecomposeError(f"--min-glue {options.min_glue_mm2}: give a number of mm2, 0 or more")
    _refuse_too_long_model(model, printers)


def _refuse_too_long_model(model: Model, printers: tuple[TargetPrinter, ...]) -> None:
    """Refuse a model that is longer than the diagonals of all printers' build volumes together."""
    max_length_mm = sum(max(math.hypot(*box) for box in p.box_sizes_mm) for p in printers)
    if float(model.extents_mm.max()) <= max_length_mm:
        return
    spans = np.array([piece.bounds_mm for piece in model.solid.list_pieces()])
    for axis in range(3):
        order = spans[np.argsort(spans[:, 0, axis]), :, axis]
        before = np.maximum.accumulate(np.concatenate([[-np.inf], order[:-1, 1]]))
        # Length of the solid along the axis, without the gaps between its pieces.
        solid_mm = float(np.maximum(0.0, order[:, 1] - np.maximum(order[:, 0], before)).sum())
        if solid_mm > max_length_mm:
            part_count = math.ceil(solid_mm / max_length_mm * len(printers))
            raise NoFit(
                f"{format_size(model.extents_mm)} mm needs {part_count} parts at least, each on its own "
                f"printer, but there are {len(printers)}: free more printers, or give a smaller "
                "--longest-side",
                part_count if part_count <= MAX_PARTS else None,
                is_too_large=True,
            )
