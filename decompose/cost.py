"""What a part costs: its print time in seconds, from features that need no slicing.

Two kinds of feature. The additive ones (`ADDITIVE`) are integrals over volume and surface: the sum over the
cells of a grid is that of a part, cut faces being ordinary faces, so that `decompose.boxes` prices any box
from tables. The rest follows from the sums (`skin_rim_mm`) and from the extents of a part.

The time of each term is the length of its lines over their speed. What lengths and speeds leave out (travel,
acceleration, retraction) is measured: `FACTORS`, by bench/print_time_model.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from decompose.jit import jit

Floats = npt.NDArray[np.float64]

ADDITIVE = ("volume_mm3", "lateral_mm2", "skin_mm2", "slope_mm2", "column_mm3")
"""Features that add up over the cells of a grid, n being the upward part of a face's unit normal.

volume_mm3
    Of the solid.
lateral_mm2
    Sum of A sqrt(1 - n^2) over all faces: walls, in every layer.
skin_mm2, slope_mm2
    Sums of A |n| and of A sqrt(1 - n^2) over the faces so flat that they get top or bottom skin.
column_mm3
    Sum of A |n| z over the faces that lean out further than the support angle, z being their height above the
    bed: the support's volume, where it reaches the bed.
"""
FEATURES = (
    *ADDITIVE,
    *("height_mm", "skin_rim_mm", "brim_mm2"),
    *("support_mm3", "support_side_mm2", "towers_mm", "islands_mm"),
)
"""And those that do not add up: the height, the root of `skin_mm2`, the ring of the brim about the part's
rectangle and, where a part is looked at closely, its islands and, in place of `column_mm3`, the support that
it really has (`decompose.columns`)."""

FACTORS: Mapping[str, float] = {
    "infill": 1.005,
    "walls": 1.0,
    "connections": 0.361,
    "skin": 1.005,
    "skin rim": 6.1,
    "slope ends": 2.0,
    "columns": 1.26,
    "support": 1.054,
    "support sides": 0.701,
    "islands": 1.07,
    "brim": 0.963,
    "infill ends": 0.808,
    "travel": 0.868,
}
"""What the seconds of each term of `terms` are multiplied by: one set for all settings.

``columns`` stands for all of `SUPPORT` where only tables are at hand. The factor of ``islands`` is seconds
a layer: there and back, with a retraction each way.
"""
SUPPORT = ("support", "support sides", "islands")
TOWER = 2.7
"""What a layer of a tower of support takes, in islands: it is printed, too."""
INSET = 8.0
"""A loop is shorter by so many mm for each mm that it lies inside the outline: two at each right angle."""
MAX_INSET_SHARE = 0.1
"""Share of the walls that is lost so at most: beyond it they are as thick as the part."""
OUTLINE_MM = 0.004
"""By so much less than it may a layer reach out beyond the one below, and is supported: outlines are rounded,
and a line that is left grows to the whole face. A face at just the support angle would be priced bare."""
TURNED = 0.5
"""What a line of infill loses where it turns along the wall, as a share of where it ends."""

# A pose is the direction of the model that points up on the bed: +x, -x, +y, -y, +z, -z.
POSES = 6


@dataclass(frozen=True, slots=True)
class PrinterRoom:
    """The boxes (x, y, z) in mm that a part may fill on a printer; x and y may be swapped.

    A part takes `time_factor` times what it costs: what was learned of the printer.
    """

    name: str
    boxes: tuple[tuple[float, float, float], ...]
    time_factor: float = 1.0

    def fits(self, width_mm: float, depth_mm: float, height_mm: float) -> bool:
        """Whether a part of these extents fits one of the boxes, turned about Z if need be."""
        return any(
            height_mm <= z and ((width_mm <= x and depth_mm <= y) or (depth_mm <= x and width_mm <= y))
            for x, y, z in self.boxes
        )


@dataclass(frozen=True, slots=True)
class Recipe:
    """The settings of a slicer that decide print time, in mm, mm/s and s."""

    layer_height_mm: float = 0.25
    line_width_mm: float = 0.35
    outer_line_width_mm: float = 0.35
    wall_count: int = 2
    skin_layers: float = 3.0  # mean of top and bottom
    infill_line_distance_mm: float = 7.0  # mean spacing, all directions together; 0 without infill
    infill_connected: bool = True  # along the walls, as a zigzag is
    support_line_distance_mm: float = 2.333  # 0 without support
    outer_wall_mm_s: float = 40.0
    inner_wall_mm_s: float = 50.0
    infill_mm_s: float = 60.0
    skin_mm_s: float = 30.0
    support_mm_s: float = 40.0
    support_angle_deg: float = 45.0  # from the vertical; faces that lean out further get support
    brim_mm: float = 8.0
    brim_mm_s: float = 30.0  # of the first layer
    speeding_layers: int = 2  # the speed rises to that of the others over so many
    travel_mm_s: float = 150.0
    acceleration_mm_s2: float = 3000.0
    least_layer_s: float = 5.0  # the slicer slows down for it
    shrinkage: float = 0.007  # of the material, a share of its length: what warps
    prelude_s: float = 0.0  # heat-up, homing, start and end code, once a part

    @property
    def walls_mm(self) -> float:
        """Width of all walls together."""
        return self.outer_line_width_mm + max(self.wall_count - 1, 0) * self.line_width_mm

    @property
    def insets_s(self) -> float:
        """Of all walls of a layer: mm that each lies inside the outline, over its speed."""
        inner = range(1, self.wall_count)
        depths_mm = [self.outer_line_width_mm + (i - 0.5) * self.line_width_mm for i in inner]
        outer_s = self.outer_line_width_mm / 2.0 / self.outer_wall_mm_s if self.wall_count > 0 else 0.0
        return outer_s + sum(depths_mm) / self.inner_wall_mm_s

    @property
    def skin_s_mm(self) -> float:
        """Seconds for a mm of line in each layer of a skin; every second skin lies on the bed."""
        layers = min(self.speeding_layers, round(self.skin_layers))
        faster = (self.skin_mm_s - self.brim_mm_s) / max(self.speeding_layers, 1)
        first = sum(1.0 / (self.brim_mm_s + i * faster) for i in range(layers))
        return self.skin_layers / self.skin_mm_s + (first - layers / self.skin_mm_s) / 2.0

    @property
    def supported_deg(self) -> float:
        """Faces that lean out further from the vertical are supported: by a hair sooner than they are to."""
        out_mm = self.layer_height_mm * math.tan(math.radians(self.support_angle_deg)) - OUTLINE_MM
        return math.degrees(math.atan2(max(0.0, out_mm), self.layer_height_mm))

    @property
    def skin_cos(self) -> float:
        """Faces with a larger |n| get skin: there the next few layers leave bare more than the walls."""
        bare_mm = self.skin_layers * self.layer_height_mm
        return math.cos(math.atan(bare_mm / (self.walls_mm + self.line_width_mm / 2.0)))


def time_terms(recipe: Recipe) -> dict[str, Floats]:
    """Seconds of each term for one unit of each of `FEATURES`: (12,) vectors, under the names of `FACTORS`.

    An end is where a line of infill or of a slope's narrow skin turns round: the nozzle stops and starts.
    Walls cover the rim of a skin.
    """

    def vector(**features: float) -> Floats:
        return np.array([features.get(name, 0.0) for name in FEATURES])

    r, layer = recipe, recipe.layer_height_mm
    inner_walls = max(r.wall_count - 1, 0) / r.inner_wall_mm_s
    walls = (1.0 / r.outer_wall_mm_s if r.wall_count > 0 else 0.0) + inner_walls
    lines = 1.0 / r.infill_line_distance_mm if r.infill_line_distance_mm > 0.0 else 0.0
    supports = 1.0 / r.support_line_distance_mm if r.support_line_distance_mm > 0.0 else 0.0
    infill = lines / (layer * r.infill_mm_s)
    connected = r.infill_connected and lines > 0.0
    ends = lines * r.infill_mm_s / r.acceleration_mm_s2 / layer
    skin = r.skin_s_mm / r.line_width_mm
    return {
        "infill": vector(
            volume_mm3=infill, lateral_mm2=-infill * r.walls_mm, skin_mm2=-infill * r.skin_layers * layer
        ),
        "walls": vector(lateral_mm2=walls / layer, height_mm=-INSET * r.insets_s / layer),
        "connections": vector(lateral_mm2=1.0 / (layer * r.infill_mm_s) if connected else 0.0),
        "skin": vector(skin_mm2=skin),
        "skin rim": vector(skin_rim_mm=-skin * r.walls_mm),
        "slope ends": vector(slope_mm2=r.skin_mm_s / r.acceleration_mm_s2 / (layer * r.line_width_mm)),
        "columns": vector(column_mm3=supports / (layer * r.support_mm_s)),
        "support": vector(support_mm3=supports / (layer * r.support_mm_s)),
        "support sides": vector(support_side_mm2=1.0 / (layer * r.support_mm_s) if supports else 0.0),
        "islands": vector(islands_mm=1.0 / layer, towers_mm=TOWER / layer if supports else 0.0),
        "brim": vector(brim_mm2=1.0 / (r.outer_line_width_mm * r.brim_mm_s)),
        "infill ends": vector(lateral_mm2=ends * (TURNED if connected else 1.0)),
        "travel": vector(lateral_mm2=1.0 / (layer * r.travel_mm_s)),
    }


@dataclass(frozen=True, slots=True)
class CostModel:
    """Coefficients of the print time, in seconds for each unit of a feature, and what the features depend on.

    ``t = fixed + max(volume V + lateral L - inset H, least H) + skin S - rim sqrt(S) + slope X + overhang O
    + brim B``; see `ADDITIVE` for V, L, S, X and O. B is the ring of the brim about the part's rectangle in
    mm2, H the height in mm. Where a part's columns are known, `support_price_s` takes the place of O.

    Held out by model, over parts that the decomposition makes, a part with its own supports errs by 1.5 % on
    average, and in each of five settings by 2.3 % at most, also where three of them are not fitted on; the
    tables, with supports down to the bed, by 2.8 % (bench/print_time_model.py, bench/print_time.csv).
    """

    fixed_s: float
    volume_s_mm3: float
    lateral_s_mm2: float
    skin_s_mm2: float
    slope_s_mm2: float
    overhang_s_mm3: float
    brim_s_mm2: float
    least_s_mm: float  # the least time of the layers in a mm of height
    brim_mm: float
    supported_deg: float = 45.0  # faces that lean out further from the vertical get support
    skin_cos: float = 0.7  # faces with a larger |n| get skin
    inset_s_mm: float = 0.0
    skin_rim_s_mm: float = 0.0
    support_s_mm3: float = 0.0
    support_side_s_mm2: float = 0.0
    tower_s_mm: float = 0.0
    island_s_mm: float = 0.0
    shrinkage: float = 0.007  # how wide a brim has to be against warping; no part of the price

    @property
    def overhang_cos(self) -> float:
        """Faces whose normal points down by more than this get support."""
        return math.sin(math.radians(self.supported_deg))

    @classmethod
    def from_recipe(cls, recipe: Recipe, factors: Mapping[str, float] = FACTORS) -> CostModel:
        """The terms of the settings, each times its factor."""
        each = sum(
            (factors[name] * vector for name, vector in time_terms(recipe).items()), np.zeros(len(FEATURES))
        )
        seconds = dict(zip(FEATURES, each.tolist(), strict=True))
        return cls(
            fixed_s=recipe.prelude_s,
            volume_s_mm3=seconds["volume_mm3"],
            lateral_s_mm2=max(0.0, seconds["lateral_mm2"]),
            skin_s_mm2=max(0.0, seconds["skin_mm2"]),
            slope_s_mm2=seconds["slope_mm2"],
            overhang_s_mm3=seconds["column_mm3"],
            brim_s_mm2=seconds["brim_mm2"],
            least_s_mm=recipe.least_layer_s / recipe.layer_height_mm,
            brim_mm=recipe.brim_mm,
            supported_deg=recipe.supported_deg,
            shrinkage=recipe.shrinkage,
            skin_cos=recipe.skin_cos,
            inset_s_mm=max(0.0, -seconds["height_mm"]),
            skin_rim_s_mm=max(0.0, -seconds["skin_rim_mm"]),
            support_s_mm3=seconds["support_mm3"],
            support_side_s_mm2=seconds["support_side_mm2"],
            tower_s_mm=seconds["towers_mm"],
            island_s_mm=seconds["islands_mm"],
        )

    def support_price_s(
        self, support_mm3: float, side_mm2: float, towers_mm: float = 0.0, islands_mm: float = 0.0
    ) -> float:
        """The time of a support of this volume and these upright sides, with towers and islands this high."""
        support = self.support_s_mm3 * support_mm3 + self.support_side_s_mm2 * side_mm2
        return support + self.tower_s_mm * towers_mm + self.island_s_mm * islands_mm

    def coefficients(self) -> Floats:
        """The coefficients in the order of the fields, for compiled code."""
        return np.array([getattr(self, f.name) for f in fields(self)], dtype=np.float64)

    def price_s(self, additive: Sequence[float] | Floats, extents: Sequence[float] | Floats) -> float:
        """The print time for one pose: `ADDITIVE` features (5,), and width, depth and height in mm."""
        c = self.coefficients()
        return float(price(c, *map(float, additive), *map(float, extents)))


@jit
def price(
    c: Floats,
    volume: float,
    lateral: float,
    skin: float,
    slope: float,
    column: float,
    width: float,
    depth: float,
    height: float,
) -> float:
    """Seconds, by `CostModel.coefficients`: one formula for tables and parts."""
    ring = c[8] * (2.0 * (width + depth) + np.pi * c[8])
    inset = min(c[11] * height, MAX_INSET_SHARE * c[2] * lateral)
    body = max(c[1] * volume + c[2] * lateral - inset, c[7] * height)
    flat = max(0.0, c[3] * skin - c[12] * np.sqrt(skin))
    seconds: float = c[0] + body + flat + c[4] * slope + c[5] * column + c[6] * ring
    return seconds


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
    normals: Floats,
    areas: Floats,
    centres: Floats,
    up: Floats,
    bed_mm: float,
    skin_cos: float,
    overhang_cos: float,
) -> tuple[float, float, float, float]:
    """The `ADDITIVE` features of faces, without the volume; the bed lies at `bed_mm` along `up`."""
    lateral, skin, slope, column = 0.0, 0.0, 0.0, 0.0
    for i in range(len(areas)):
        n = normals[i, 0] * up[0] + normals[i, 1] * up[1] + normals[i, 2] * up[2]
        upright = areas[i] * np.sqrt(max(0.0, 1.0 - n * n))
        lateral += upright
        if abs(n) > skin_cos:
            skin += areas[i] * abs(n)
            slope += upright
        if n < -overhang_cos:
            z = centres[i, 0] * up[0] + centres[i, 1] * up[1] + centres[i, 2] * up[2]
            column -= areas[i] * n * (z - bed_mm)
    return lateral, skin, slope, column


def pose_features(
    vertices: Floats,
    faces: npt.NDArray[np.int64],
    rotations: Floats,
    cost: CostModel,
    hull: Floats | None = None,
) -> tuple[Floats, Floats]:
    """`ADDITIVE` features (k, 5) of a closed mesh in each of k poses, and its extents (k, 3) in mm.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3), outward by the right-hand rule, closed.
    rotations
        (k, 3, 3) The rows are the bed's x, y and z in the model's frame: ``v_bed = rotation @ v_model``.
    hull
        (h, 3) those vertices that span the convex hull, where they are known: sooner.
    """
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    keep = doubled > 0.0
    corners, cross, doubled = corners[keep], cross[keep], doubled[keep]
    normals, areas, centres = cross / doubled[:, None], doubled / 2.0, corners.mean(axis=1)
    features, extents = np.zeros((len(rotations), len(ADDITIVE))), np.zeros((len(rotations), 3))
    features[:, 0] = np.einsum("ij,ij->i", corners[:, 0], cross).sum() / 6.0
    for i, rotation in enumerate(np.ascontiguousarray(rotations, dtype=np.float64)):
        placed = (vertices if hull is None else hull) @ rotation.T
        bottom = placed.min(axis=0)
        extents[i] = placed.max(axis=0) - bottom
        up = rotation[2]
        features[i, 1:] = _surface_sums(
            normals, areas, centres, up, float(bottom[2]), cost.skin_cos, cost.overhang_cos
        )
    return features, extents


def pose_prices_s(
    vertices: Floats, faces: npt.NDArray[np.int64], rotations: Floats, cost: CostModel
) -> Floats:
    """Print time (k,) in seconds of a closed mesh in each of k poses; see `pose_features`."""
    features, extents = pose_features(vertices, faces, rotations, cost)
    return np.array([cost.price_s(*each) for each in zip(features, extents, strict=True)])


def axis_prices_s(vertices: Floats, faces: npt.NDArray[np.int64], cost: CostModel) -> Floats:
    """Print time (6,) in seconds of a closed mesh in each axis pose."""
    return pose_prices_s(vertices, faces, POSE_ROTATIONS, cost)
