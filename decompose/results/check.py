"""Geometry rules that are checked on every result before it is written, independently of the search."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from decompose.arrays import Floats
from decompose.errors import GeometryError, Rule
from decompose.geometry import Model, Solid, is_watertight
from decompose.pieces import PLANE_TOLERANCE_MM, find_cut_faces
from decompose.printers import TargetPrinter
from decompose.results.decomposition import Part
from decompose.results.records import Coverage

# Maximum difference between the area of the parts without their cut faces and the model's area, as a share of
# the model's area; also the maximum error of the missing volume, as a share of the model's volume.
MAX_ERROR_SHARE = 1e-6
MAX_OVERLAP_MM3 = 1e-3  # maximum volume that two parts share, due to rounding
# Minimum volume of all hollows, as a share of the model's volume; a smaller one is a rounding error. A hollow
# is a space inside the model that no box covers, so that it is not printed.
MIN_HOLLOW_SHARE = 1e-12
MAX_STL_ERROR_SHARE = 1e-5  # maximum error of the volume of an STL file, due to single precision
FIT_TOLERANCE_MM = 1e-6  # length by which a part may exceed its build volume, or a wall may be too thin
BOX_OVERLAP_MM = 1e-6  # overlap of boxes that are united, so that rounding leaves no films between them


def check_result(
    parts: Sequence[Part],
    boxes_mm: Floats,
    model: Model,
    printers: Sequence[TargetPrinter],
    min_wall_mm: float,
) -> Coverage:
    """Check the geometry of the parts against all rules except those of pins, marks and STL files.

    Parameters
    ----------
    parts
        Parts of the result.
    boxes_mm
        (b, 2, 3) corners of the boxes that were cut out; the interior of the model outside all boxes is not
        printed. Empty if nothing may be missing.
    model
        Model in the frame of the parts.
    printers
        Printers; each appears once for every part that it may print.
    min_wall_mm
        Minimum distance of a hollow from the model's surface.

    Returns
    -------
    Coverage
        Relative difference between the area of the parts without their cut faces and the area of the model,
        and total volume in which parts overlap.

    Raises
    ------
    GeometryError
        A rule is broken; the error names the first such rule, and the part.
    """
    printer_by_name = {p.name: p for p in printers}
    # A printer is listed once for each part that it may print.
    free_counts = Counter(p.name for p in printers)
    for part in parts:
        check_part(part, printer_by_name)
        free_counts[part.printer] -= 1
        if free_counts[part.printer] < 0:
            raise GeometryError(Rule.OWN_PRINTER, part.id, f"{part.printer} has another part already")
    overlap_mm3 = check_overlap(parts)
    surface_error = check_surface(parts, model)
    check_missing_volume(parts, boxes_mm, model, min_wall_mm)
    return Coverage(surface_error, overlap_mm3)


def check_part(part: Part, printers: dict[str, TargetPrinter]) -> None:
    """Check that a part is closed, in one piece, and fits its printer in its pose.

    Parameters
    ----------
    part
        Part of the result.
    printers
        Printers by their names.
    """
    vertices, faces = part.solid.arrays()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if not (len(faces) and mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0):
        raise GeometryError(Rule.CLOSED, part.id, "not a closed surface around a volume")
    piece_count = len(part.solid.list_pieces())
    if piece_count != 1:
        raise GeometryError(Rule.ONE_PIECE, part.id, f"{piece_count} separate pieces")
    vertices_on_bed, _ = part.build_printing_mesh()
    width_mm, depth_mm, height_mm = np.ptp(vertices_on_bed, axis=0) - FIT_TOLERANCE_MM
    printer = printers.get(part.printer)
    if printer is None or not printer.fits(width_mm, depth_mm, height_mm):
        raise GeometryError(
            Rule.FITS,
            part.id,
            f"{width_mm:.1f} x {depth_mm:.1f} x {height_mm:.1f} mm does not fit {part.printer}",
        )


def check_overlap(parts: Sequence[Part]) -> float:
    """Check that no two parts overlap; return the total volume in mm3 that pairs of parts share."""
    total_mm3 = 0.0
    for a, b in combinations(parts, 2):
        lo_mm = np.maximum(a.solid.bounds_mm[0], b.solid.bounds_mm[0])
        hi_mm = np.minimum(a.solid.bounds_mm[1], b.solid.bounds_mm[1])
        if (hi_mm - lo_mm).min() <= PLANE_TOLERANCE_MM:
            continue
        shared_mm3 = a.solid.intersect(b.solid).volume_mm3
        if shared_mm3 > MAX_OVERLAP_MM3:
            raise GeometryError(Rule.NO_OVERLAP, b.id, f"shares {shared_mm3:.3g} mm3 with {a.id}")
        total_mm3 += shared_mm3
    return total_mm3


def check_surface(parts: Sequence[Part], model: Model) -> float:
    """Check that the parts' faces except cut faces have the area of the model; return the relative error.

    Parameters
    ----------
    parts
        Parts of the result.
    model
        Model in the frame of the parts.
    """
    covered_mm2 = 0.0
    for part in parts:
        vertices, faces = part.solid.arrays()
        triangles = vertices[faces]
        cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        areas_mm2 = np.linalg.norm(cross, axis=1) / 2.0
        covered_mm2 += float(areas_mm2[~find_cut_faces(vertices, faces, part.planes)].sum())
    model_mm2 = model.solid.area_mm2
    surface_error = abs(covered_mm2 - model_mm2) / model_mm2
    if surface_error > MAX_ERROR_SHARE:
        raise GeometryError(
            Rule.SURFACE,
            None,
            f"the parts contain {covered_mm2:.3f} of {model_mm2:.3f} mm2 of the original surface",
        )
    return surface_error


def check_missing_volume(parts: Sequence[Part], boxes_mm: Floats, model: Model, min_wall_mm: float) -> None:
    """Check that only the hollows outside the boxes are missing, and that they are far from the surface.

    Parameters
    ----------
    parts, boxes_mm, model, min_wall_mm
        As in `check_result`.
    """
    model_mm3 = model.solid.volume_mm3
    missing_mm3 = model_mm3 - sum(p.solid.volume_mm3 for p in parts)
    hollow = None
    if len(boxes_mm):
        boxes = np.unique(boxes_mm, axis=0)
        hollow = model.solid.subtract(
            Solid.union([Solid.box(lo_mm - BOX_OVERLAP_MM, hi_mm + BOX_OVERLAP_MM) for lo_mm, hi_mm in boxes])
        )
    hollow_mm3 = 0.0 if hollow is None else hollow.volume_mm3
    if abs(missing_mm3 - hollow_mm3) > MAX_ERROR_SHARE * model_mm3:
        raise GeometryError(
            Rule.INTERIOR,
            None,
            f"{missing_mm3:.1f} mm3 are missing, but {hollow_mm3:.1f} are outside all boxes",
        )
    if hollow is None or hollow_mm3 <= MIN_HOLLOW_SHARE * model_mm3:
        return
    lo_mm, hi_mm = model.solid.bounds_mm
    margin_mm = 2.0 * min_wall_mm + 1.0  # keeps the sides of this box far enough from all hollows
    outside = Solid.box(lo_mm - margin_mm, hi_mm + margin_mm).subtract(model.solid)
    if outside.measure_gap_mm(hollow, min_wall_mm) >= min_wall_mm - FIT_TOLERANCE_MM:
        return
    hollows = hollow.list_pieces()
    distances_mm = [outside.measure_gap_mm(cavity, min_wall_mm) for cavity in hollows]
    nearest_index = int(np.argmin(distances_mm))
    centre_mm = np.round(hollows[nearest_index].bounds_mm.mean(axis=0))
    raise GeometryError(
        Rule.WALL, None, f"the hollow at {centre_mm} is {distances_mm[nearest_index]:.2f} mm from the surface"
    )


def check_stl(path: Path, part: Part) -> None:
    """Check that a written file is watertight and has the volume of its part.

    Parameters
    ----------
    path
        STL file.
    part
        Part that was written to the file.

    Raises
    ------
    GeometryError
        The file breaks the rule `Rule.STL`.
    """
    mesh: Any = trimesh.load(path, force="mesh", process=False)
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    if not is_watertight(triangles):
        raise GeometryError(Rule.STL, part.id, f"{path.name}, read back, is not watertight")
    volume_mm3, file_volume_mm3 = part.printed_solid.volume_mm3, _compute_volume_mm3(triangles)
    if abs(file_volume_mm3 - volume_mm3) > MAX_STL_ERROR_SHARE * volume_mm3:
        raise GeometryError(
            Rule.STL,
            part.id,
            f"{path.name}, read back, has {file_volume_mm3:.3f} mm3 instead of {volume_mm3:.3f}",
        )


def _compute_volume_mm3(triangles: Floats) -> float:
    """Compute the volume inside triangles (m, 3, 3) in mm that face outward."""
    # Not by the code that reads models, which this checks; near the origin, where rounding errors are small.
    corners = triangles - triangles[0, 0]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)
