"""The geometry rules, checked on every result before it is written. None of them trusts the search."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from decompose.boxes import Box
from decompose.cost import PrinterRoom
from decompose.errors import GeometryError
from decompose.grid import Grid
from decompose.mesh import Model
from decompose.solid import Solid

if TYPE_CHECKING:
    from decompose.report import Decomposition, Part

ON_PLANE_MM = 1e-7  # how far from a cut plane rounding may leave a vertex
SURFACE_SHARE = 1e-6
OVERLAP_MM3 = 1e-3
STL_VOLUME_SHARE = 1e-5
FIT_MM = 1e-6


class Rule(StrEnum):
    """The rules, by name."""

    CLOSED = "closed"  # each part is a closed manifold of positive volume
    ONE_PIECE = "one-piece"
    FITS = "fits"  # in its pose, on its printer
    OWN_PRINTER = "own-printer"  # no printer has more parts than it may print
    NO_OVERLAP = "no-overlap"
    SURFACE = "surface"  # the original surface is covered exactly once
    WALL = "wall"  # what is missing keeps its distance from the original surface
    INSIDE = "inside"  # parts and what is missing are the model, no more
    STL = "stl"  # the file, read back, is watertight and has the part's volume


@dataclass(frozen=True, slots=True)
class Coverage:
    """How well the parts cover the model: relative error of the original area, and doubly covered volume."""

    surface_error: float
    overlap_mm3: float


def check(
    result: Decomposition, model: Model, printers: Sequence[PrinterRoom], grid: Grid, boxes: list[Box]
) -> Coverage:
    """Check all rules but the files'.

    Parameters
    ----------
    boxes
        The boxes of the grid that were cut out, whose inner sides are the cut planes.

    Returns
    -------
    Coverage
        The figures of surface and overlap.

    Raises
    ------
    GeometryError
        The first rule that is broken, and the part.
    """
    rooms = {p.name: p for p in printers}
    free = Counter(p.name for p in printers)  # a printer is there once for each round that it may print
    for part in result.parts:
        check_part(part, rooms)
        free[part.printer] -= 1
        if free[part.printer] < 0:
            raise GeometryError(Rule.OWN_PRINTER, part.id, f"{part.printer} has another part already")
    overlap = check_overlap(result.parts)
    error = check_surface(result.parts, model, grid)
    check_missing(result.parts, model, grid, boxes, result.options.min_wall_mm)
    return Coverage(error, overlap)


def check_part(part: Part, rooms: dict[str, PrinterRoom]) -> None:
    """Closed, one piece, and inside its printer's room in its pose."""
    vertices, faces = part.solid.arrays()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if not (len(faces) and mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0):
        raise GeometryError(Rule.CLOSED, part.id, "not a closed surface around a volume")
    pieces = len(part.solid.pieces())
    if pieces != 1:
        raise GeometryError(Rule.ONE_PIECE, part.id, f"{pieces} separate pieces")
    printed, _ = part.printed()
    width, depth, height = np.ptp(printed, axis=0) - FIT_MM
    room = rooms.get(part.printer)
    if room is None or not room.fits(width, depth, height):
        raise GeometryError(
            Rule.FITS, part.id, f"{width:.1f} x {depth:.1f} x {height:.1f} mm does not fit {part.printer}"
        )


def check_overlap(parts: Sequence[Part]) -> float:
    """The volume in mm3 that two parts share, over all pairs."""
    total = 0.0
    for a, b in combinations(parts, 2):
        lo = np.maximum(a.solid.bounds_mm[0], b.solid.bounds_mm[0])
        hi = np.minimum(a.solid.bounds_mm[1], b.solid.bounds_mm[1])
        if (hi - lo).min() <= ON_PLANE_MM:
            continue
        shared = a.solid.intersect(b.solid).volume_mm3
        if shared > OVERLAP_MM3:
            raise GeometryError(Rule.NO_OVERLAP, b.id, f"shares {shared:.3g} mm3 with {a.id}")
        total += shared
    return total


def check_surface(parts: Sequence[Part], model: Model, grid: Grid) -> float:
    """Relative error of the original area that the parts carry: their faces off the grid's inner planes."""
    covered = 0.0
    for part in parts:
        vertices, faces = part.solid.arrays()
        triangles = vertices[faces]
        cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        area = np.linalg.norm(cross, axis=1) / 2.0
        cut = np.zeros(len(faces), dtype=np.bool_)
        for axis in range(3):
            planes = grid.planes[axis][1:-1]
            if len(planes):
                along = triangles[:, :, axis]
                nearest = planes[np.abs(along[:, :1] - planes[None, :]).argmin(axis=1)]
                cut |= (np.abs(along - nearest[:, None]) < ON_PLANE_MM).all(axis=1)
        covered += float(area[~cut].sum())
    whole = model.solid.area_mm2
    error = abs(covered - whole) / whole
    if error > SURFACE_SHARE:
        raise GeometryError(
            Rule.SURFACE, None, f"the parts carry {covered:.3f} of {whole:.3f} mm2 of the original surface"
        )
    return error


def check_missing(
    parts: Sequence[Part], model: Model, grid: Grid, boxes: list[Box], min_wall_mm: float
) -> None:
    """What no part has is whole cells of the grid, full of solid, away from the surface."""
    covered = np.zeros(grid.shape, dtype=np.bool_)
    for x0, y0, z0, x1, y1, z1 in boxes:
        covered[x0:x1, y0:y1, z0:z1] = True
    steps = [np.diff(p) for p in grid.planes]
    volume = steps[0][:, None, None] * steps[1][None, :, None] * steps[2][None, None, :]
    # A cell outside the boxes is empty or full; whether it is full is seen from the model's own cuts.
    left = ~covered & (grid.cuts[0][:-1] > 0.0)
    whole = model.solid.volume_mm3
    missing = whole - sum(p.solid.volume_mm3 for p in parts)
    expected = float(volume[left].sum())
    if abs(missing - expected) > SURFACE_SHARE * whole:
        raise GeometryError(
            Rule.INSIDE, None, f"{missing:.1f} mm3 are missing, the cells left out have {expected:.1f}"
        )
    if not left.any():
        return
    hollows = [Solid.box(*grid.bounds_mm((x, y, z, x + 1, y + 1, z + 1))) for x, y, z in np.argwhere(left)]
    lo, hi = model.solid.bounds_mm
    far_mm = 2.0 * min_wall_mm + 1.0  # the sides of this box are further from any hollow than the limit
    outside = Solid.box(lo - far_mm, hi + far_mm).subtract(model.solid)
    distance = outside.gap_mm(Solid.union(hollows), min_wall_mm)
    if distance >= min_wall_mm - FIT_MM:
        return
    while len(hollows) > 1:  # halve until the one that is to blame is left
        half = hollows[: len(hollows) // 2]
        near = outside.gap_mm(Solid.union(half), min_wall_mm) < min_wall_mm - FIT_MM
        hollows = half if near else hollows[len(half) :]
    distance = outside.gap_mm(hollows[0], min_wall_mm)
    centre = np.round(hollows[0].bounds_mm.mean(axis=0))
    raise GeometryError(Rule.WALL, None, f"the hollow at {centre} is {distance:.2f} mm from the surface")


def check_stl(path: Path, part: Part) -> None:
    """The written file holds the part: watertight, and of its volume."""
    mesh: Any = trimesh.load(path, force="mesh", process=True)
    if not mesh.is_watertight:
        raise GeometryError(Rule.STL, part.id, f"{path.name}, read back, is not watertight")
    volume = part.solid.volume_mm3
    if abs(mesh.volume - volume) > STL_VOLUME_SHARE * volume:
        raise GeometryError(
            Rule.STL, part.id, f"{path.name}, read back, has {mesh.volume:.3f} mm3 instead of {volume:.3f}"
        )
