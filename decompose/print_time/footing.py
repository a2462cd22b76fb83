"""Adhesion of a part to the bed: its first layer, the brim that it needs, and its elephant foot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from decompose.arrays import Floats
from decompose.geometry import find_convex_outline, find_half_planes

FIRST_LAYER_MM = 0.15  # height of the middle of the first layer, at which it is cut
SHARP_DEG = 120.0
ROUNDED_MM = 1.0  # maximum size of a chamfer or a rounding that counts as one corner

# [assumed] Widths of brims.
STEADY = 3.0  # maximum ratio of height to width of the walls in the first layer without a brim
GOOD_CONTACT_MM2 = 400.0
# Lengths of a base from which its corners lift, and need the widest brim.
WARP_LENGTHS_MM = (60.0, 120.0)
REFERENCE_SHRINKAGE = 0.007
"""Shrinkage (of ABS) to which `WARPS_MM` applies: a corner lifts by shrinkage times length squared."""
MIN_BRIM_MM = 2.0

# [assumed] Width that the squeezed first layer adds to each side; it is not taken off thinner walls.
ELEPHANT_FOOT_MM = 0.2
MIN_WALL_MM = 2.0


@dataclass(frozen=True, slots=True)
class Footing:
    """Contact of a part with the bed.

    Attributes
    ----------
    contact_mm2, wall_mm
        Area of the first layer, and the width of the walls that it consists of (four areas over its outline).
    length_mm, sharp_corners
        Greatest extent of the convex outline around it, and the number of its corners under `SHARP_DEG`.
    width_mm, edges
        Least extent of the convex outline around it and the supports that stand on the bed, and that outline
        as half-planes (q, 3): ``edges[:, :2] @ p + edges[:, 2] <= 0`` in mm; empty without area.
    """

    contact_mm2: float
    wall_mm: float
    length_mm: float
    sharp_corners: int
    width_mm: float
    edges: Floats

    @classmethod
    def from_mesh(cls, triangles: Floats, props_mm: Floats) -> Footing:
        """Measure the footing of a closed mesh (m, 3, 3) in mm on z = 0 and of its supports at (p, 2)."""
        contact_mm2, outline_mm, points = _measure_first_layer(triangles)
        rim = find_convex_outline(points)
        sides = np.diff(rim, axis=0, append=rim[:1])
        sides = sides[np.linalg.norm(sides, axis=1) > ROUNDED_MM]
        turn = np.arctan2(sides[:, 1], sides[:, 0])
        bend = np.degrees((np.roll(turn, -1) - turn + math.pi) % (2.0 * math.pi) - math.pi)
        outline = find_convex_outline(np.concatenate([rim, props_mm])) if len(props_mm) else rim
        edges = find_half_planes(outline)
        return cls(
            contact_mm2=contact_mm2,
            wall_mm=4.0 * contact_mm2 / outline_mm if outline_mm > 0.0 else 0.0,
            length_mm=float(pdist(rim).max(initial=0.0)),
            sharp_corners=int((bend > 180.0 - SHARP_DEG).sum()),
            width_mm=float(np.ptp(outline @ edges[:, :2].T, axis=0).min()) if len(outline) else 0.0,
            edges=edges,
        )

    def inside_mm(self, points: Floats) -> float:
        """Measure the distance of the outermost of points (n, 2) inside the outline; negative outside."""
        if not len(self.edges):
            return -math.inf
        return -float((points @ self.edges[:, :2].T + self.edges[:, 2]).max())

    def brim_width_mm(
        self, height_mm: float, lean_mm: float, widest_mm: float, shrinkage: float = REFERENCE_SHRINKAGE
    ) -> float:
        """Choose the width of the brim that a part of this height needs, from 0 to the widest.

        A part that is tall for its base, or whose centre of mass is not above it (`lean_mm`), gets a brim
        that widens the base; a small contact area needs a brim for adhesion; a long base curls up at its
        corners, less at blunt corners and with a material that shrinks less (`shrinkage`, a share of its
        length).
        """
        lever = (height_mm / STEADY - self.wall_mm) / 2.0
        contact = widest_mm * (1.0 - self.contact_mm2 / GOOD_CONTACT_MM2)
        longer = math.sqrt(REFERENCE_SHRINKAGE / max(shrinkage, 1e-4))
        begins, all_of_it = (longer * length_mm for length_mm in WARP_LENGTHS_MM)
        warp = widest_mm * (self.length_mm - begins) / (all_of_it - begins)
        offset_mm = widest_mm if lean_mm < 0.0 else 0.0
        width_mm = max(lever, contact, offset_mm, warp if self.sharp_corners else warp / 2.0)
        return 0.0 if width_mm < MIN_BRIM_MM else math.floor(10.0 * min(width_mm, widest_mm)) / 10.0

    def expansion_mm(self, joined: bool) -> float:
        """Choose the horizontal expansion of the first layer, so that no glued face protrudes."""
        return -ELEPHANT_FOOT_MM if joined and self.wall_mm >= MIN_WALL_MM else 0.0


def _measure_first_layer(triangles: Floats) -> tuple[float, float, Floats]:
    """Measure the first layer: area in mm2, length of the outline in mm, and points (n, 2) that span it."""
    low_triangles = triangles[triangles[:, :, 2].min(axis=1) < FIRST_LAYER_MM]
    areas_mm2 = (
        np.cross(low_triangles[:, 1] - low_triangles[:, 0], low_triangles[:, 2] - low_triangles[:, 0])[:, 2]
        / 2.0
    )
    order = np.argsort(low_triangles[:, :, 2], axis=1)[:, :, None]
    corners = np.take_along_axis(low_triangles, order, axis=1)
    z = corners[:, :, 2]
    one_in_layer = z[:, 1] >= FIRST_LAYER_MM  # triangles with one corner in the layer, and with two
    two_in_layer = ~one_in_layer & (z[:, 2] >= FIRST_LAYER_MM)
    share = np.ones(len(low_triangles))
    share[one_in_layer] = _compute_corner_share(z[one_in_layer])
    share[two_in_layer] = 1.0 - _compute_corner_share(z[two_in_layer][:, ::-1])
    ends = np.concatenate(
        [
            np.stack(
                [_find_crossings(corners[one_in_layer], 0, 1), _find_crossings(corners[one_in_layer], 0, 2)],
                axis=1,
            ),
            np.stack(
                [
                    _find_crossings(corners[two_in_layer], 0, 2),
                    _find_crossings(corners[two_in_layer], 1, 2),
                ],
                axis=1,
            ),
        ]
    )
    # By the divergence theorem the area of a section is the downward area below it minus the upward area.
    area_mm2 = max(0.0, -float((areas_mm2 * share).sum()))
    outline_mm = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())
    return area_mm2, outline_mm, np.concatenate([corners[z < FIRST_LAYER_MM][:, :2], ends.reshape(-1, 2)])


def _compute_corner_share(z: Floats) -> Floats:
    """Compute the share of a triangle's area below the first layer, by heights (m, 3), corner first."""
    apex, b, c = z.T
    share: Floats = (FIRST_LAYER_MM - apex) ** 2 / ((b - apex) * (c - apex))
    return share


def _find_crossings(corners: Floats, a: int, b: int) -> Floats:
    """Find the points (m, 2) where the edges between two corners cross the first layer."""
    start, end = corners[:, a], corners[:, b]
    share = (FIRST_LAYER_MM - start[:, 2:]) / (end[:, 2:] - start[:, 2:])
    points: Floats = start[:, :2] + share * (end - start)[:, :2]
    return points
