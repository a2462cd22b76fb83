"""Faces that are hidden once the parts are glued: cut faces on the bed, upright cut faces, and tops.

Hidden skins need fewer layers than visible ones. A slicer uses one number of skin layers on the bed, another
at other undersides, and a third at all tops. Tops therefore count as hidden only if all of them are cut
faces. Walls along upright cut faces are printed faster.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Bools, Floats, Ints
from decompose.jit import jit
from decompose.print_time.part_mesh import PartMesh
from decompose.print_time.surfaces import Surfaces

# Minimum downward component of the normal of a face that lies on the bed: within 2.6 degrees.
LEVEL_COS = 0.999
FLAT_COS = 0.9994  # minimum upward component of the normal of a flat top: within 2 degrees
MAX_BED_FACE_HEIGHT_MM = 0.15  # level faces below this height above the bed count as lying on the bed
MAX_UPRIGHT_COS = 1e-6  # maximum upward component of the normal of an upright face
MIN_VISIBLE_MM2 = 1.0  # minimum area of visible faces; a smaller area is a rounding error
MIN_FLAT_TOP_MM2 = 100.0  # minimum area of all flat tops, on which the order of the lines is seen
SIDE_END_MM = 6.0
"""Length at each end of a hidden side along which no time is saved. The last 5 mm are printed like a visible
wall, and the print head stops once more. In most sliced parts, this length is 4 to 8 mm
(`bench/prices/hidden_walls.py`)."""
MEAN_SIDE_SHARE = 0.9
"""Mean share of the area of hidden sides that is not at these ends. Tables of box prices use it, because the
outlines of cut faces are not known there."""


class HiddenFaces(NamedTuple):
    """Areas of cut faces and of visible faces.

    Attributes
    ----------
    cut_bed_mm2, visible_bed_mm2
        Area of the cut faces, and of the model's own faces, on the bed.
    cut_top_mm2, visible_top_mm2
        Area of the cut faces, and of the model's own faces, among the tops with skin, as seen from above.
    cut_side_mm2
        Area of upright cut faces.
    visible_flat_top_mm2
        Area of the model's own faces among the flat tops.
    """

    cut_bed_mm2: float
    visible_bed_mm2: float
    cut_top_mm2: float
    visible_top_mm2: float
    cut_side_mm2: float
    visible_flat_top_mm2: float

    @property
    def is_bed_hidden(self) -> bool:
        """True if all faces on the bed are cut faces."""
        return self.cut_bed_mm2 > 0.0 and self.visible_bed_mm2 < MIN_VISIBLE_MM2

    @property
    def are_tops_hidden(self) -> bool:
        """True if all tops with skin are cut faces."""
        return self.cut_top_mm2 > 0.0 and self.visible_top_mm2 < MIN_VISIBLE_MM2

    @property
    def has_visible_flat_tops(self) -> bool:
        """True if flat tops remain visible; the steps of a slope do not count."""
        return self.visible_flat_top_mm2 >= MIN_FLAT_TOP_MM2

    def compute_saved_height_mm(self, bed_mm: float, top_mm: float) -> float:
        """Compute the height of skin in mm that the hidden faces of a thin flat part save.

        Parameters
        ----------
        bed_mm, top_mm
            `hidden_bed_mm` and `hidden_top_mm` of `CostModel`.
        """
        return (bed_mm if self.is_bed_hidden else 0.0) + (top_mm if self.are_tops_hidden else 0.0)

    def compute_saved_skin_mm2(self, bed_share: float, top_share: float) -> float:
        """Compute the time that hidden skins save, expressed as an area of ordinary skin in mm2.

        Parameters
        ----------
        bed_share, top_share
            `hidden_bed_share` and `hidden_top_share` of `CostModel`.
        """
        saved_mm2 = bed_share * self.cut_bed_mm2 if self.is_bed_hidden else 0.0
        return saved_mm2 + (top_share * self.cut_top_mm2 if self.are_tops_hidden else 0.0)


def find_hidden_faces(
    surfaces: Surfaces, is_cut: Bools, up: Floats, bed_mm: float, skin_cos: float
) -> HiddenFaces:
    """Measure the areas of cut and visible faces in a pose; see `measure_hidden_faces`.

    Parameters
    ----------
    surfaces, is_cut, up, bed_mm, skin_cos
        As in `measure_hidden_faces`.
    """
    return HiddenFaces(*measure_hidden_faces(surfaces, is_cut, up, bed_mm, skin_cos))


@jit
def measure_hidden_faces(
    surfaces: Surfaces, is_cut: Bools, up: Floats, bed_mm: float, skin_cos: float
) -> tuple[float, float, float, float, float, float]:
    """Measure the areas of `HiddenFaces` in a pose.

    Parameters
    ----------
    surfaces
        Faces of the mesh.
    is_cut
        (m,) bool, true for faces that are cuts.
    up
        (3,) float64 unit vector that points up.
    bed_mm
        Position of the bed along `up`.
    skin_cos
        Minimum upward component of the normal of a top with skin; see `CostModel`.

    Returns
    -------
    tuple
        Areas in the order of `HiddenFaces`, in mm2.
    """
    normals, areas_mm2, centres = surfaces
    cut_bed_mm2, visible_bed_mm2, cut_top_mm2, visible_top_mm2 = 0.0, 0.0, 0.0, 0.0
    cut_side_mm2, visible_flat_top_mm2 = 0.0, 0.0
    for i in range(len(areas_mm2)):
        n = normals[i, 0] * up[0] + normals[i, 1] * up[1] + normals[i, 2] * up[2]
        if n < -LEVEL_COS:
            z = centres[i, 0] * up[0] + centres[i, 1] * up[1] + centres[i, 2] * up[2]
            if z - bed_mm < MAX_BED_FACE_HEIGHT_MM:
                if is_cut[i]:
                    cut_bed_mm2 -= areas_mm2[i] * n
                else:
                    visible_bed_mm2 -= areas_mm2[i] * n
        elif n > skin_cos:
            if is_cut[i]:
                cut_top_mm2 += areas_mm2[i] * n
            else:
                visible_top_mm2 += areas_mm2[i] * n
                if n > FLAT_COS:
                    visible_flat_top_mm2 += areas_mm2[i] * n
        elif abs(n) < MAX_UPRIGHT_COS and is_cut[i]:
            cut_side_mm2 += areas_mm2[i]
    return (
        cut_bed_mm2, visible_bed_mm2, cut_top_mm2, visible_top_mm2, cut_side_mm2, visible_flat_top_mm2,
    )  # fmt: skip


def sum_side_ends_mm(mesh: PartMesh, up: Floats) -> float:
    """Sum the heights of the edges at which hidden sides end, except edges between two hidden sides.

    Parameters
    ----------
    mesh
        Mesh of the part; faces share the vertices of their common edges.
    up
        (3,) float64 unit vector that points up.
    """
    return _sum_side_ends_mm(mesh.vertices, mesh.faces, mesh.surfaces.normals, mesh.is_cut, up, mesh.edges)


@jit
def _sum_side_ends_mm(
    vertices: Floats, faces: Ints, normals: Floats, is_cut: Bools, up: Floats, edges: Ints
) -> float:
    """Sum the heights of the edges between a hidden side and another face.

    Parameters
    ----------
    vertices, faces
        (n, 3) float64 in mm and (m, 3) int64.
    normals
        (m, 3) float64 unit normals of the faces.
    is_cut
        (m,) bool, true for faces that are cuts.
    up
        (3,) float64 unit vector that points up.
    edges
        (k, 2) int64 pairs of half-edges, by `pair_half_edges`.

    Returns
    -------
    float
        Sum in mm.
    """
    is_side = np.zeros(len(faces), np.bool_)
    for i in range(len(faces)):
        n = normals[i, 0] * up[0] + normals[i, 1] * up[1] + normals[i, 2] * up[2]
        is_side[i] = is_cut[i] and abs(n) < MAX_UPRIGHT_COS
    sum_mm = 0.0
    for e in range(len(edges)):
        first, second = edges[e]
        if is_side[first // 3] == is_side[second // 3]:
            continue
        a, b = faces[first // 3, first % 3], faces[first // 3, (first % 3 + 1) % 3]
        rise_mm = 0.0
        for axis in range(3):
            rise_mm += (vertices[b, axis] - vertices[a, axis]) * up[axis]
        sum_mm += abs(rise_mm)
    return sum_mm
