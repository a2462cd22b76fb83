"""Closed solids: reading, repairing, cutting and measuring them."""

from __future__ import annotations

from decompose.geometry.convex import (
    find_convex_outline,
    find_half_planes,
    find_smallest_rectangle_angle_rad,
    measure_rectangles,
)
from decompose.geometry.formats import round_triangles, separate_touching_surfaces, write_stl
from decompose.geometry.model import Model, load_model
from decompose.geometry.shells import label_components
from decompose.geometry.solid import Solid, triangulate
from decompose.geometry.symmetry import (
    Mirror,
    find_good_mirrors,
    find_mirror,
    find_rotation_to_axis,
    find_smallest_rotation,
    sample_mirrors,
)
from decompose.geometry.vectors import choose_plane_axes, compute_cross_product
from decompose.geometry.weld import is_watertight

__all__ = [
    "Mirror",
    "Model",
    "Solid",
    "choose_plane_axes",
    "compute_cross_product",
    "find_convex_outline",
    "find_good_mirrors",
    "find_half_planes",
    "find_mirror",
    "find_rotation_to_axis",
    "find_smallest_rectangle_angle_rad",
    "find_smallest_rotation",
    "is_watertight",
    "label_components",
    "load_model",
    "measure_rectangles",
    "round_triangles",
    "sample_mirrors",
    "separate_touching_surfaces",
    "triangulate",
    "write_stl",
]
