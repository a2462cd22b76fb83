"""Fit of pieces in the build volumes: number of parts, pieces that do not fit, and positions of cuts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import permutations

import numpy as np

from decompose.arrays import Floats
from decompose.errors import NoFit
from decompose.geometry import Solid
from decompose.grid import PLANE_CLEARANCE_MM
from decompose.pieces import Piece
from decompose.printers import TargetPrinter
from decompose.problem.problem import Problem

FIT_TOLERANCE_MM = 1e-6  # length by which a part may exceed the build volume, due to rounding
ROUNDING_MM3 = 1e-6  # solids up to this volume are films that rounding leaves on a cut, and are removed


def count_blocks(size_mm: Floats, printers: Sequence[TargetPrinter]) -> tuple[int, int, int]:
    """Count the equal blocks into which a box must be divided along x, y and z to fit every printer.

    The number of blocks is as small as possible for each printer. If the result is one block, the box fits;
    otherwise, the box may still fit if it is rotated.

    Parameters
    ----------
    size_mm
        (3,) size of the box.
    printers
        Printers that the parts have to fit.
    """
    axis_counts = []
    for printer in printers:
        block_counts = [
            np.ceil((size_mm - FIT_TOLERANCE_MM) / box)
            for b in printer.box_sizes_mm
            for box in permutations(b)
        ]
        axis_counts.append(
            min(block_counts, key=lambda counts: (math.prod(counts.tolist()), counts.tolist()))
        )
    x, y, z = np.maximum(1.0, np.max(axis_counts, axis=0)).astype(int).tolist()
    return x, y, z


def count_parts(solid: Solid, printers: Sequence[TargetPrinter]) -> int:
    """Compute the smallest number of axis-aligned parts that fit every printer; 1 if the solid itself fits.

    Parameters
    ----------
    solid
        Solid to cut.
    printers
        Printers that the parts have to fit.
    """
    return math.prod(count_blocks(np.ptp(solid.bounds_mm, axis=0), printers))


def find_clear_offset_mm(
    solid: Solid, normal: Floats, at_mm: float, max_shift_mm: float = 2.0 * PLANE_CLEARANCE_MM
) -> float:
    """Find the offset of a plane near `at_mm` at which the plane is not close to any face parallel to it.

    A cut close to a face would leave slivers, and the face would count as a cut face. If every permitted
    offset is close to a face, the result is the offset with the largest distance from all faces.

    Parameters
    ----------
    solid
        Solid to cut.
    normal
        (3,) unit normal of the plane.
    at_mm
        Desired offset along the normal.
    max_shift_mm
        Maximum distance from the desired offset.
    """
    vertices, faces = solid.arrays()
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    doubled_areas_mm2 = np.linalg.norm(cross, axis=1)
    is_parallel = (np.abs(cross @ normal) > (1.0 - 1e-9) * doubled_areas_mm2) & (doubled_areas_mm2 > 0.0)
    coordinates_mm = np.unique(np.round(a[is_parallel] @ normal, 6))
    coordinates_mm = coordinates_mm[np.abs(coordinates_mm - at_mm) < max_shift_mm + PLANE_CLEARANCE_MM]
    if not len(coordinates_mm):
        return at_mm
    offsets_mm = np.linspace(-max_shift_mm, max_shift_mm, 81)
    offsets_mm = offsets_mm[np.argsort(np.abs(offsets_mm), kind="stable")]
    gaps_mm = np.abs(at_mm + offsets_mm[:, None] - coordinates_mm[None]).min(axis=1)
    clear_gaps = np.flatnonzero(gaps_mm >= PLANE_CLEARANCE_MM)
    return at_mm + float(offsets_mm[clear_gaps[0] if len(clear_gaps) else int(np.argmax(gaps_mm))])


def split_connected_pieces(piece: Piece) -> list[Piece]:
    """Split a piece into connected pieces, and remove the films that rounding leaves on a cut."""
    solids = [solid for solid in piece.solid.list_pieces() if solid.volume_mm3 > ROUNDING_MM3]
    return [Piece(solid, piece.planes, piece.boxes_mm) for solid in solids]


def refuse_misfits(
    engine: str, pieces: Sequence[Piece], problem: Problem, sufficient_printer_count: int | None
) -> None:
    """Raise `NoFit` if a piece fits no printer in any pose, or if there are more pieces than printers.

    Parameters
    ----------
    engine
        Name of the engine, for messages.
    pieces
        Pieces that the engine has made.
    problem
        Problem with the printers.
    sufficient_printer_count
        Number of printers that would be enough; None if it is unknown.
    """
    printer_count = len(problem.printers)
    large_pieces = [p for p in pieces if count_parts(p.solid, problem.distinct_printers) > 1]
    misfit_count = sum(pose is None for pose in problem.find_poses(large_pieces))
    if misfit_count:
        verb = "fits" if misfit_count == 1 else "fit"
        noun = "printer" if printer_count == 1 else "printers"
        raise NoFit(
            f"{misfit_count} of the {len(pieces)} parts that {engine} makes for {printer_count} {noun} "
            f"{verb} none of them: choose another value of --longest-side, or --engine guillotine"
        )
    if len(pieces) > printer_count:
        raise NoFit(
            f"{engine} makes {len(pieces)} parts, each on its own printer, but there are {printer_count}: "
            f"free more printers, or choose --engine guillotine",
            sufficient_printer_count,
        )
