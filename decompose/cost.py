"""What a part costs: its print time in seconds, as a sum of terms that tables can add up.

The terms are those that decide CuraEngine's print time: volume (infill), lateral area (walls), horizontal
area (top and bottom skin), columns under overhangs (support), brim, and height (layer changes). Cut faces are
ordinary faces: wall or skin by their direction in the pose that is printed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from decompose.jit import jit

Floats = npt.NDArray[np.float64]

SKIN_COS = math.cos(math.radians(47.0))  # faces flatter than this get top or bottom skin

# A pose is the direction of the model that points up on the bed: +x, -x, +y, -y, +z, -z.
POSES = 6


@dataclass(frozen=True, slots=True)
class PrinterRoom:
    """The boxes (x, y, z) in mm that a part may fill on a printer; x and y may be swapped."""

    name: str
    boxes: tuple[tuple[float, float, float], ...]

    def fits(self, width_mm: float, depth_mm: float, height_mm: float) -> bool:
        """Whether a part of these extents fits one of the boxes, turned about Z if need be."""
        return any(
            height_mm <= z and ((width_mm <= x and depth_mm <= y) or (depth_mm <= x and width_mm <= y))
            for x, y, z in self.boxes
        )


@dataclass(frozen=True, slots=True)
class Recipe:
    """The settings of a slicer that decide print time, in mm and mm/s."""

    layer_height_mm: float = 0.25
    line_width_mm: float = 0.35
    wall_count: int = 2
    skin_layers: float = 3.0  # mean of top and bottom
    infill_line_distance_mm: float = 7.0
    support_line_distance_mm: float = 2.333
    outer_wall_mm_s: float = 40.0
    inner_wall_mm_s: float = 50.0
    infill_mm_s: float = 60.0
    skin_mm_s: float = 30.0
    support_mm_s: float = 40.0
    support_angle_deg: float = 45.0  # from the vertical; faces that lean out further get support
    brim_mm: float = 8.0
    brim_mm_s: float = 30.0
    prelude_s: float = 0.0  # heat-up and start code, once a part


@dataclass(frozen=True, slots=True)
class CostModel:
    """Coefficients of the print time, all in seconds.

    ``t = fixed + volume V + lateral L + skin S + overhang O + brim B + height H``, with V in mm3; L and S the
    areas ``A sqrt(1 - nz^2)`` and, of faces flatter than 47 degrees, ``A |nz|``; O the sum of projected area
    times height above the bed of faces that lean out further than `support_angle_deg`; B the ring of the brim
    about the part's rectangle; H the height in mm.
    """

    fixed_s: float
    volume_s_mm3: float
    lateral_s_mm2: float
    skin_s_mm2: float
    overhang_s_mm3: float
    brim_s_mm2: float
    height_s_mm: float
    brim_mm: float
    support_angle_deg: float = 45.0

    @property
    def overhang_cos(self) -> float:
        """Faces whose normal points down by more than this get support."""
        return math.sin(math.radians(self.support_angle_deg))

    @classmethod
    def from_recipe(cls, recipe: Recipe) -> CostModel:
        """Each term's line length over its speed, times a factor measured against CuraEngine 4.13.

        The factors stand for what the line lengths leave out (travel, acceleration, retraction, minimum layer
        time) and for what they count twice (infill where walls and skins are). One set for all settings:
        fitted over 64 parts of four decomposed models at layers of 0.15 and 0.25 mm, where it errs by 3 % on
        average (`bench/decompose_cost.py`).
        """
        layer = recipe.layer_height_mm
        walls = 1.0 / recipe.outer_wall_mm_s + max(recipe.wall_count - 1, 0) / recipe.inner_wall_mm_s
        infill = recipe.infill_line_distance_mm * layer * recipe.infill_mm_s
        support = recipe.support_line_distance_mm * layer * recipe.support_mm_s
        return cls(
            fixed_s=recipe.prelude_s + 60.0,
            volume_s_mm3=0.82 / infill if infill > 0.0 else 0.0,
            lateral_s_mm2=1.23 * walls / layer,
            skin_s_mm2=1.06 * recipe.skin_layers / (recipe.line_width_mm * recipe.skin_mm_s),
            overhang_s_mm3=1.27 / support if support > 0.0 else 0.0,
            brim_s_mm2=1.0 / (recipe.line_width_mm * recipe.brim_mm_s),
            height_s_mm=3.0 / layer,
            brim_mm=recipe.brim_mm,
            support_angle_deg=recipe.support_angle_deg,
        )

    def coefficients(self) -> Floats:
        """The coefficients in the order of the fields, for compiled code."""
        return np.array([getattr(self, f.name) for f in fields(self)], dtype=np.float64)

    def seconds(
        self, volume: float, lateral: float, skin: float, overhang: float, extents: Sequence[float]
    ) -> float:
        """The print time for one pose; `extents` are width, depth and height in mm."""
        width, depth, height = extents
        ring = self.brim_mm * (2.0 * (width + depth) + math.pi * self.brim_mm)
        return (
            self.fixed_s
            + self.volume_s_mm3 * volume
            + self.lateral_s_mm2 * lateral
            + self.skin_s_mm2 * skin
            + self.overhang_s_mm3 * overhang
            + self.brim_s_mm2 * ring
            + self.height_s_mm * height
        )


def pose_axes(pose: int) -> tuple[int, int, int]:
    """The model's axes that become width, depth and height in a pose."""
    up = pose // 2
    return ((up + 1) % 3, (up + 2) % 3, up)


def _pose_rotation(pose: int) -> Floats:
    """(3, 3) Rows: where the bed's x, y and z point in the model; odd poses are turned over about x."""
    rotation = np.eye(3)[list(pose_axes(pose))]
    if pose % 2:
        rotation[1:] *= -1.0
    return rotation


POSE_ROTATIONS: Floats = np.array([_pose_rotation(pose) for pose in range(POSES)])
"""(6, 3, 3) The axis poses, as rotations that `pose_seconds` takes."""


@jit
def _surface_sums(
    normals: Floats, areas: Floats, centres: Floats, up: Floats, skin_cos: float, overhang_cos: float
) -> tuple[float, float, float, float]:
    """Lateral area, skin area, area of overhangs as seen from above, and the same times height."""
    lateral, skin, hanging, column = 0.0, 0.0, 0.0, 0.0
    for i in range(len(areas)):
        n = normals[i, 0] * up[0] + normals[i, 1] * up[1] + normals[i, 2] * up[2]
        lateral += areas[i] * np.sqrt(max(0.0, 1.0 - n * n))
        if abs(n) > skin_cos:
            skin += areas[i] * abs(n)
        if n < -overhang_cos:
            z = centres[i, 0] * up[0] + centres[i, 1] * up[1] + centres[i, 2] * up[2]
            hanging -= areas[i] * n
            column -= areas[i] * n * z
    return lateral, skin, hanging, column


def pose_seconds(
    vertices: Floats, faces: npt.NDArray[np.int64], rotations: Floats, cost: CostModel
) -> Floats:
    """Print time (k,) in seconds of a closed mesh in each of k poses, by the sums that the tables have too.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3), outward by the right-hand rule, closed.
    rotations
        (k, 3, 3) The rows are the bed's x, y and z in the model's frame: ``v_bed = rotation @ v_model``.
        The brim is taken about the rectangle along the bed's x and y.
    """
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    keep = doubled > 0.0
    corners, cross, doubled = corners[keep], cross[keep], doubled[keep]
    normals, areas, centres = cross / doubled[:, None], doubled / 2.0, corners.mean(axis=1)
    volume = float(np.einsum("ij,ij->i", corners[:, 0], cross).sum() / 6.0)
    times = np.zeros(len(rotations))
    for i, rotation in enumerate(np.ascontiguousarray(rotations, dtype=np.float64)):
        placed = vertices @ rotation.T
        lo, hi = placed.min(axis=0), placed.max(axis=0)
        lateral, skin, hanging, column = _surface_sums(
            normals, areas, centres, rotation[2], SKIN_COS, cost.overhang_cos
        )
        times[i] = cost.seconds(volume, lateral, skin, column - hanging * float(lo[2]), (hi - lo).tolist())
    return times


def pose_costs(vertices: Floats, faces: npt.NDArray[np.int64], cost: CostModel) -> Floats:
    """Print time (6,) in seconds of a closed mesh in each axis pose."""
    return pose_seconds(vertices, faces, POSE_ROTATIONS, cost)
