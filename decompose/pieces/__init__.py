"""Pieces of a model, the joints between them, and the printer of each."""

from __future__ import annotations

from decompose.pieces.assignment import assign_printers, solve_bottleneck_assignment
from decompose.pieces.joints import (
    SLIVER_MM,
    CutSolid,
    Fault,
    Joint,
    JointFace,
    find_faults,
    find_joints,
    list_polygons,
)
from decompose.pieces.piece import (
    PLANE_TOLERANCE_MM,
    Piece,
    copy_printers,
    cut_box,
    cut_cells,
    find_cut_faces,
    find_face_planes,
    list_box_planes,
    rotate_planes,
    sort_pieces,
)
from decompose.pieces.seams import Seam, describe_thin_rims, measure_seams

__all__ = [
    "PLANE_TOLERANCE_MM",
    "SLIVER_MM",
    "CutSolid",
    "Fault",
    "Joint",
    "JointFace",
    "Piece",
    "Seam",
    "assign_printers",
    "copy_printers",
    "cut_box",
    "cut_cells",
    "describe_thin_rims",
    "find_cut_faces",
    "find_face_planes",
    "find_faults",
    "find_joints",
    "list_box_planes",
    "list_polygons",
    "measure_seams",
    "rotate_planes",
    "solve_bottleneck_assignment",
    "sort_pieces",
]
