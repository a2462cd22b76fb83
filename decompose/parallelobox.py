"""The engine `parallelobox`: blocks grown from seeds on a grid, as in the paper, section by section.

Orientation (`alignment`) and symmetry cut (`symmetry`), then for each half seeds (`seeds`), growth (`growth`)
and void fill (`voids`), over many attempts (`metaheuristic`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, product

import numpy as np
import numpy.typing as npt

from decompose.alignment import Aligned, align
from decompose.boxes import Box
from decompose.errors import NoFit
from decompose.grid import VOLUME, Grid
from decompose.growth import OVERHANG_TOLERANCE_DEG, Score, Terrain, terrain_in_seconds, terrain_of_the_paper
from decompose.metaheuristic import Attempt, attempts
from decompose.piece import Piece, pieces_in_cells
from decompose.problem import Found, Problem
from decompose.report import Options
from decompose.solid import Solid

Floats = npt.NDArray[np.float64]
MOST_CUT = 12  # attempts whose pieces are counted, the best first


def paper_settings(options: Options) -> Options:
    """The paper's own settings and its own reading of the score; speeds and overhang are in `growth`."""
    return replace(options, granularity="vfine", tries=3, score=Score.HIGH)


def search(problem: Problem) -> Found:
    """The pieces of the best attempt that has no more of them than there are printers.

    Raises
    ------
    NoFit
        No attempt covers the model.
    """
    options = problem.options
    steep = math.sin(math.radians(OVERHANG_TOLERANCE_DEG))  # the paper's
    overhang_cos = steep if options.faithful else problem.cost.overhang_cos
    aligned = align(problem.model, options.seed, overhang_cos)
    grid = problem.grid(aligned.model, aligned.mirror)
    problem.lap("grid")
    boxes = problem.boxes(grid)
    problem.lap("boxes")
    if options.faithful:
        terrain = terrain_of_the_paper(problem.grid(aligned.model, aligned.mirror, steep), boxes)
    else:
        terrain = terrain_in_seconds(grid, boxes)
    cut = _best_attempt(aligned, grid, terrain, problem)
    problem.lap("search")
    figures = problem.figures(grid, boxes, list(cut))
    problem.lap("bound")
    pieces = tuple(piece for found in cut.values() for piece in found)
    return Found(pieces, aligned.model, aligned.rotation, figures)


def _best_attempt(aligned: Aligned, grid: Grid, terrain: Terrain, problem: Problem) -> dict[Box, list[Piece]]:
    """The boxes of the best attempt that has no more pieces than there are printers, and their pieces."""
    printers, options, executor = len(problem.printers), problem.options, problem.executor
    points = np.unique(aligned.model.solid.arrays()[0], axis=0)
    tried = options.tries * printers * len(options.score.readings)
    for halves in _halves(aligned.mirror, grid, terrain, points, printers):
        found = []
        for half, part_of_points, share in halves:
            run = map if executor is None else executor.map
            settings = (share, options.tries, options.score, options.seed, run)
            found.append(attempts(part_of_points, grid, half, *settings))
        best = _whole_within(found, aligned.model.solid, grid, problem)
        if best is not None:
            return best
    raise NoFit(
        f"none of {tried} attempts of parallelobox covers the model with {printers} parts that fit: "
        f"free more printers, or take --engine guillotine, which finds parts wherever there are any"
    )


Half = tuple[Terrain, Floats, int]  # where blocks grow, the points for seeds, the printers


def _halves(
    mirror: tuple[int, float] | None, grid: Grid, terrain: Terrain, points: Floats, printers: int
) -> list[list[Half]]:
    """First the two halves of a symmetric model, the larger with the odd printer; then the model uncut."""
    whole: list[list[Half]] = [[(terrain, points, printers)]]
    if mirror is None or printers < 2:
        return whole
    axis, at_mm = mirror
    planes = np.flatnonzero(grid.planes[axis][1:-1] == at_mm)
    if not len(planes):
        return whole
    plane = int(planes[0]) + 1
    sides = [
        (terrain.half(axis, plane, upper), (points[:, axis] >= at_mm) == upper) for upper in (False, True)
    ]
    work = [float(grid.sums[side.needed][:, VOLUME].sum()) for side, _ in sides]
    larger = int(work[1] > work[0])
    shares = [printers // 2 + (printers % 2 if i == larger else 0) for i in range(2)]
    return [[(side, points[on], n) for (side, on), n in zip(sides, shares, strict=True)], *whole]


def _whole_within(
    found: Sequence[list[Attempt]], solid: Solid, grid: Grid, problem: Problem
) -> dict[Box, list[Piece]] | None:
    """Of the best attempts the first that has no more pieces than there are printers.

    Not faithful, the one of them whose pieces, in the poses that they are printed in, end soonest.
    """
    each = product(*(range(len(half)) for half in found))
    ranked = sorted(
        islice(each, 10_000),
        key=lambda picks: max(half[i].longest for half, i in zip(found, picks, strict=True)),
    )
    cut: dict[Box, list[Piece]] = {}
    best: dict[Box, list[Piece]] | None = None
    best_s = math.inf
    for picks in ranked[:MOST_CUT]:
        boxes = [box for half, i in zip(found, picks, strict=True) for box in half[i].blocks]
        for box in boxes:
            if box not in cut:
                cut[box] = pieces_in_cells(solid, grid, box)
        pieces = [piece for box in boxes for piece in cut[box]]
        if len(pieces) > len(problem.printers):
            continue
        if problem.options.faithful:
            return {box: cut[box] for box in boxes}
        longest_s = max(math.inf if pose is None else pose.seconds for pose in problem.poses(pieces))
        if best is None or longest_s < best_s:
            best, best_s = {box: cut[box] for box in boxes}, longest_s
        if problem.expired():
            break
    return best
