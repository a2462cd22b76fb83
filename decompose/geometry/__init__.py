"""Closed solids: reading, repairing, cutting and measuring them."""

from __future__ import annotations

from decompose.geometry.convex import convex_outline, half_planes, rectangles, smallest_rectangle
from decompose.geometry.model import Model, load_model
from decompose.geometry.shells import label_components
from decompose.geometry.solid import Solid, choose_plane_axes, triangulate
from decompose.geometry.stl import round_triangles, write_stl
from decompose.geometry.symmetry import (
    Mirror,
    draw_mirrors,
    find_good_mirrors,
    find_least_rotation,
    find_mirror,
    rotation_to_axis,
)

__all__ = [
    "Mirror",
    "Model",
    "Solid",
    "choose_plane_axes",
    "convex_outline",
    "draw_mirrors",
    "find_good_mirrors",
    "find_least_rotation",
    "find_mirror",
    "half_planes",
    "label_components",
    "load_model",
    "rectangles",
    "rotation_to_axis",
    "round_triangles",
    "smallest_rectangle",
    "triangulate",
    "write_stl",
]
