"""Faces that are hidden once the parts are glued: cut faces on the bed, upright cut faces, and tops.

Hidden skins need fewer layers than visible ones. A slicer uses one number of layers for the bed, another for
other undersides, and a third for all tops. Tops therefore count as hidden only if all of them are cut faces.
Walls along upright cut faces are printed faster.
"""

from __future__ import annotations

from typing import NamedTuple

from decompose.arrays import Bools, Floats
from decompose.jit import jit
from decompose.print_time.surfaces import Surfaces

# Minimum downward component of the normal of a face that lies on the bed: within 2.6 degrees.
LEVEL_COS = 0.999
ON_BED_MM = 0.15  # maximum height of a face that lies on the bed
MAX_UPRIGHT_COS = 1e-6  # maximum upward component of the normal of an upright face
MIN_VISIBLE_MM2 = 1.0  # minimum area of visible faces; a smaller area is a rounding error


class HiddenFaces(NamedTuple):
    """Areas of cut faces and of visible faces.

    Attributes
    ----------
    cut_bed_mm2, visible_bed_mm2
        Area of the cut faces, and of the model's own faces, on the bed.
    cut_top_mm2, visible_top_mm2
        Area of the cut faces, and of the model's own faces, of tops with skin, as seen from above.
    cut_side_mm2
        Area of upright cut faces.
    """

    cut_bed_mm2: float
    visible_bed_mm2: float
    cut_top_mm2: float
    visible_top_mm2: float
    cut_side_mm2: float

    @property
    def is_bed_hidden(self) -> bool:
        """True if all faces on the bed are cut faces."""
        return self.cut_bed_mm2 > 0.0 and self.visible_bed_mm2 < MIN_VISIBLE_MM2

    @property
    def are_tops_hidden(self) -> bool:
        """True if all tops with skin are cut faces."""
        return self.cut_top_mm2 > 0.0 and self.visible_top_mm2 < MIN_VISIBLE_MM2

    def compute_saved_mm(self, bed_mm: float, top_mm: float) -> float:
        """Compute the height of skin in mm that a thin flat part saves.

        Parameters
        ----------
        bed_mm, top_mm
            `hidden_bed_mm` and `hidden_top_mm` of `CostModel`.
        """
        return (bed_mm if self.is_bed_hidden else 0.0) + (top_mm if self.are_tops_hidden else 0.0)

    def compute_saved_skin_mm2(self, bed_share: float, top_share: float) -> float:
        """Compute the area of skin in mm2 that is saved.

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
    """Find the hidden faces of a closed mesh in a pose; see `measure_hidden_faces`.

    Parameters
    ----------
    surfaces, is_cut, up, bed_mm, skin_cos
        As in `measure_hidden_faces`.
    """
    return HiddenFaces(*measure_hidden_faces(surfaces, is_cut, up, bed_mm, skin_cos))


@jit
def measure_hidden_faces(
    surfaces: Surfaces, is_cut: Bools, up: Floats, bed_mm: float, skin_cos: float
) -> tuple[float, float, float, float, float]:
    """Measure the areas of `HiddenFaces` in a pose.

    Parameters
    ----------
    surfaces
        Faces of the mesh.
    is_cut
        (m,) bool, true for faces that are cuts.
    up
        (3,) float64 unit vector.
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
    cut_bed_mm2, visible_bed_mm2, cut_top_mm2, visible_top_mm2, cut_side_mm2 = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(areas_mm2)):
        n = normals[i, 0] * up[0] + normals[i, 1] * up[1] + normals[i, 2] * up[2]
        if n < -LEVEL_COS:
            z = centres[i, 0] * up[0] + centres[i, 1] * up[1] + centres[i, 2] * up[2]
            if z - bed_mm < ON_BED_MM:
                if is_cut[i]:
                    cut_bed_mm2 -= areas_mm2[i] * n
                else:
                    visible_bed_mm2 -= areas_mm2[i] * n
        elif n > skin_cos:
            if is_cut[i]:
                cut_top_mm2 += areas_mm2[i] * n
            else:
                visible_top_mm2 += areas_mm2[i] * n
        elif abs(n) < MAX_UPRIGHT_COS and is_cut[i]:
            cut_side_mm2 += areas_mm2[i]
    return cut_bed_mm2, visible_bed_mm2, cut_top_mm2, visible_top_mm2, cut_side_mm2
