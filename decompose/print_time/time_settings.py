"""Print settings, and the seconds that each feature of a part takes with these settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats

ADDITIVE_FEATURES = ("volume_mm3", "lateral_mm2", "skin_mm2", "slope_mm2", "column_mm3")
"""Features that are sums over the volume and the surface of a part, and thus over the cells of a grid.

Below, A is the area of a face, and n is the upward component of its unit normal.

volume_mm3
    Volume of the solid.
lateral_mm2
    Sum of A sqrt(1 - n^2) over all faces: walls, in every layer.
skin_mm2, slope_mm2
    Sums of A |n| and of A sqrt(1 - n^2) over the faces that are flat enough for top or bottom skin.
column_mm3
    Sum of A |n| z over the faces that overhang by more than the support angle; z is the height of a face
    above the bed. This is the support's volume if all support reaches down to the bed.
"""


FEATURES = (
    *ADDITIVE_FEATURES,
    *("height_mm", "skin_rim_mm", "brim_mm2"),
    *("support_mm3", "support_side_mm2", "towers_mm", "islands_mm"),
    *("island_paths_mm2", "holes_mm", "rim_mm", "rim_ends_mm", "ring_mm2", "steep_top_mm2"),
    *("single_wall_mm2", "gap_mm2", "solid_wall_mm2", "overlap_mm3"),
)
"""All features. Those after `ADDITIVE_FEATURES` are not additive:

height_mm, skin_rim_mm, brim_mm2
    Height of the part, square root of `skin_mm2`, and area of the brim around the part's bounding rectangle.

The others are known only if a part is measured in a pose:

support_mm3, support_side_mm2, towers_mm, islands_mm, island_paths_mm2, holes_mm
    See `columns.Columns`; the sides are its `fine_support_side_mm2`. The terms of the support replace that of
    `column_mm3`.
rim_mm, rim_ends_mm, ring_mm2, steep_top_mm2
    See `contours.Contours`. The term of `rim_mm` replaces that of `skin_rim_mm`.
single_wall_mm2, gap_mm2, solid_wall_mm2, overlap_mm3
    See `thin_walls.ThinWalls`.
"""


FACTORS: Mapping[str, float] = {
    "infill": 1.005,
    "walls": 1.0,
    "connections": 0.361,
    "skin": 1.005,
    "skin rim": 6.1,
    "slope ends": 2.0,
    "support to bed": 1.26,
    "support": 0.93,
    "support sides": 0.635,
    "islands": 0.75,
    "island paths": 1.95,
    "brim": 0.963,
    "infill ends": 0.808,
    "travel": 0.67,
    "holes": 1.0,
    "rims": 1.0,
    "rim ends": 5.0,
    "rings": 0.6,
    "steep tops": 1.0,
    "thin walls": 1.0,
    "thin sheets": 1.0,
}
"""Factors of the seconds of each term of `compute_time_terms`, the same for all settings.

Tables of box prices contain the term ``support to bed``, which applies to `column_mm3`, instead of all
`SUPPORT_TERMS`. The factors of travel, of supports and of the terms that need a pose were fitted to the
features of sliced parts (`bench/prices/features.py`), and the others to five settings
(`bench/prices/model.py`).
"""


SUPPORT_TERMS = ("support", "support sides", "islands", "island paths")
TOWER_LAYER_S = 4.0
"""Time in s that each layer of a support tower (see `Columns.towers_mm`) takes in addition to its lines. It
is multiplied by the factor of "islands"."""


LOOP_SHORTENING = 8.0
"""Length in mm by which a wall line around a part is shorter than the outline, for each mm of its distance
from the outline: 2 mm at each of four corners."""


OUTLINE_MARGIN_MM = 0.004
"""Length that is subtracted, when a part is priced, from the maximum overhang of a layer without support. The
slicer rounds outlines, so a face at exactly the support angle exceeds this maximum in some layers. The
support that begins in these layers spreads to the whole face. Without the margin, the price of the face would
not include support."""


HOLE_S = 0.25
"""Time in s of the travel to and around a hole in a layer. The fit to sliced parts with up to 36 holes gave
no additional time for the distance between holes."""


MAX_STOP_MM_S = 30.0
"""Speed of skin above which the time lost at line ends no longer grows: sliced parts lose the same time at 30
and at 50 mm/s."""


TURN_TIME_SHARE = 0.5
"""Time lost where a connected infill line turns along the wall, as a share of the time lost where an infill
line ends."""


RIM_TURN_TIME_SHARE, SLOPE_TURN_TIME_SHARE = 0.75, 0.3
"""The same shares for connected lines of skin, on flat faces and on slopes. They were fitted to parts of
`bench.prices.features` that were sliced with both patterns."""


LayerFitter = Callable[[float], float]
"""Hashable function that returns the layer height in mm for a part whose height in mm is given."""


@dataclass(frozen=True, slots=True)
class PrintTimeSettings:
    """Slicer settings that determine print time, in mm, mm/s and s."""

    layer_height_mm: float = 0.25  # mean over all parts, if the layer height depends on the height of a part
    fit_layer_mm: LayerFitter | None = None
    line_width_mm: float = 0.35
    outer_line_width_mm: float = 0.35
    wall_count: int = 2
    skin_layer_count: float = 3.0  # mean of top and bottom
    saved_bed_layer_count: float = 0.0  # layers of skin saved at a hidden face on the bed, see `hidden_faces`
    saved_top_layer_count: float = 0.0  # layers of skin saved at hidden tops
    infill_line_distance_mm: float = 7.0  # mean spacing, all directions together; 0 without infill
    is_infill_connected: bool = True  # along the walls, as in the pattern zigzag
    infill_step_count: int = 0  # number of steps below the tops at which the density of the infill halves
    infill_step_mm: float = 0.0  # depth of each step
    support_line_distance_mm: float = 2.333  # 0 without support
    outer_wall_mm_s: float = 40.0
    inner_wall_mm_s: float = 50.0
    infill_mm_s: float = 60.0
    hidden_outer_wall_mm_s: float = 0.0  # on upright sides hidden after gluing; 0 if not faster
    hidden_inner_wall_mm_s: float = 0.0
    skin_line_width_mm: float = 0.35
    skin_mm_s: float = 30.0
    is_skin_connected: bool = False  # along the walls, as in the pattern zigzag
    roof_line_width_mm: float = 0.35
    roof_layer_count: int = 0  # uppermost layers of tops, printed at another speed unless all tops are hidden
    roof_mm_s: float = 30.0
    support_mm_s: float = 40.0
    support_angle_deg: float = 45.0  # from the vertical; faces at a larger angle get support
    small_overhang_deg: float = 0.0  # faces up to this angle get no support if their area is small
    small_overhang_mm2: float = 0.0  # these faces get no support if their total area is below this
    brim_mm: float = 8.0
    brim_mm_s: float = 30.0  # speed of the first layer
    first_line_ratio: float = 1.0  # width of the first layer's lines, except the brim, as a multiple
    slow_layer_count: int = 2  # number of layers over which the speed rises to that of the other layers
    travel_mm_s: float = 150.0
    retraction_s: float = 0.52  # time to retract the filament and to push it back
    acceleration_mm_s2: float = 3000.0
    min_layer_s: float = 5.0  # the slicer slows down shorter layers to this time
    shrinkage: float = 0.007  # share of the length by which the material shrinks, which makes parts warp
    overhead_s: float = 0.0  # time of heating, homing, start and end code, once for each part

    @property
    def wall_thickness_mm(self) -> float:
        """Width of all walls on one side together."""
        return self.outer_line_width_mm + max(self.wall_count - 1, 0) * self.line_width_mm

    @property
    def insets_s(self) -> float:
        """Sum over the wall lines along an outline: distance from the outline divided by the line's speed."""
        inner_walls = range(1, self.wall_count)
        depths_mm = [self.outer_line_width_mm + (i - 0.5) * self.line_width_mm for i in inner_walls]
        outer_s = self.outer_line_width_mm / 2.0 / self.outer_wall_mm_s if self.wall_count > 0 else 0.0
        return outer_s + sum(depths_mm) / self.inner_wall_mm_s

    @property
    def skin_s_per_mm2(self) -> float:
        """Seconds per mm2 for all layers of a skin: the mean of a skin on the bed and one at the top."""
        layer_count = min(self.slow_layer_count, round(self.skin_layer_count))
        speed_step_mm_s = (self.skin_mm_s - self.brim_mm_s) / max(self.slow_layer_count, 1)
        first_s_per_mm = sum(
            1.0 / (self.brim_mm_s + i * speed_step_mm_s) / (1.0 if i else self.first_line_ratio)
            for i in range(layer_count)
        )
        bed_s_per_mm = first_s_per_mm - layer_count / self.skin_mm_s
        lines_s_per_mm = self.skin_layer_count / self.skin_mm_s + bed_s_per_mm / 2.0
        return lines_s_per_mm / self.skin_line_width_mm + self.roof_s_per_mm2 / 2.0

    def compute_skin_stop_s(self, turn_share: float) -> float:
        """Compute the seconds lost at the end of a line of skin, before multiplication by a factor.

        If lines are connected, it is `turn_share` of the time lost where a line ends.
        """
        stop_s = min(self.skin_mm_s, MAX_STOP_MM_S) / self.acceleration_mm_s2
        return stop_s * turn_share if self.is_skin_connected else stop_s

    @property
    def skin_layer_s_per_mm2(self) -> float:
        """Seconds per mm2 of a layer of skin that is neither one of the first layers nor a roof layer."""
        return 1.0 / (self.skin_mm_s * self.skin_line_width_mm)

    @property
    def roof_s_per_mm2(self) -> float:
        """Additional seconds per mm2 for all layers of a top, due to the different lines of roof layers."""
        layer_count = min(self.roof_layer_count, self.skin_layer_count)
        return layer_count * (1.0 / (self.roof_mm_s * self.roof_line_width_mm) - self.skin_layer_s_per_mm2)

    @property
    def hidden_wall_s_per_mm2(self) -> float:
        """Seconds saved by faster walls, per mm2 of a hidden upright side."""
        outer_s_per_mm = _compute_gain_s_per_mm(self.outer_wall_mm_s, self.hidden_outer_wall_mm_s)
        inner_s_per_mm = _compute_gain_s_per_mm(self.inner_wall_mm_s, self.hidden_inner_wall_mm_s)
        walls_s_per_mm = outer_s_per_mm + (self.wall_count - 1) * inner_s_per_mm
        return walls_s_per_mm / self.layer_height_mm if self.wall_count > 0 else 0.0

    @property
    def hidden_bed_share(self) -> float:
        """Share of the time of a skin that is saved at a hidden face on the bed."""
        return (
            self.saved_bed_layer_count * self.skin_layer_s_per_mm2 / self.skin_s_per_mm2
            if self.skin_layer_count > 0.0
            else 0.0
        )

    @property
    def hidden_top_share(self) -> float:
        """Share of the time of a skin that is saved at hidden tops."""
        saved_s_per_mm2 = self.saved_top_layer_count * self.skin_layer_s_per_mm2 + self.roof_s_per_mm2
        return saved_s_per_mm2 / self.skin_s_per_mm2 if self.skin_layer_count > 0.0 else 0.0

    @property
    def sparse_lines_per_mm(self) -> float:
        """Number of infill lines per mm, all directions together, at the lowest density."""
        distance_mm = self.infill_line_distance_mm * 2.0**self.infill_step_count
        return 1.0 / distance_mm if distance_mm > 0.0 else 0.0

    @property
    def connection_s_per_mm2(self) -> float:
        """Seconds for the connections of infill lines along the wall, per mm2 of wall; 0 if not connected."""
        is_connected = self.is_infill_connected and self.sparse_lines_per_mm > 0.0
        return 1.0 / (self.layer_height_mm * self.infill_mm_s) if is_connected else 0.0

    @property
    def infill_ends_s_per_mm2(self) -> float:
        """Seconds lost at the ends of infill lines, per mm2 of wall."""
        stop_s = self.infill_mm_s / self.acceleration_mm_s2
        share = TURN_TIME_SHARE if self.connection_s_per_mm2 > 0.0 else 1.0
        return share * self.sparse_lines_per_mm * stop_s / self.layer_height_mm

    @property
    def top_line_ratio(self) -> float:
        """Additional infill below a top, where the density doubles at each step towards the top.

        The ratio is the length of the additional lines in a layer, divided by the area of the top, and
        integrated over the depth below the top.
        """
        return (
            self.infill_step_mm
            * self.sparse_lines_per_mm
            * (2.0 ** (self.infill_step_count + 1) - 2.0 - self.infill_step_count)
        )

    @property
    def ring_cos(self) -> float:
        """Minimum upward component of the unit normal of a slope with denser infill below it.

        Gradual infill is denser in a ring-shaped strip below each slope. Below a steeper slope, this strip
        would be narrower than a line.
        """
        depth_mm = self.infill_step_mm * self.infill_step_count
        return self.line_width_mm / math.hypot(depth_mm, self.line_width_mm) if depth_mm > 0.0 else 1.0

    @property
    def effective_support_angle_deg(self) -> float:
        """Angle from the vertical beyond which faces count as supported: slightly less than the setting."""
        return self._compute_effective_angle_deg(self.support_angle_deg)

    @property
    def effective_small_overhang_deg(self) -> float:
        """Angle up to which small faces get no support: slightly less than `small_overhang_deg`, or 0."""
        return self._compute_effective_angle_deg(self.small_overhang_deg)

    def _compute_effective_angle_deg(self, support_angle_deg: float) -> float:
        """Compute the angle beyond which the slicer supports faces, from the angle in its settings."""
        overhang_mm = self.layer_height_mm * math.tan(math.radians(support_angle_deg)) - OUTLINE_MARGIN_MM
        return math.degrees(math.atan2(max(0.0, overhang_mm), self.layer_height_mm))

    @property
    def skin_cos(self) -> float:
        """Minimum |n| of faces with skin; n is the upward component of a face's unit normal.

        On a flatter face, the layers above leave a strip of each layer uncovered that is wider than the
        walls, so this strip gets skin.
        """
        skin_height_mm = self.skin_layer_count * self.layer_height_mm
        return math.cos(math.atan(skin_height_mm / (self.wall_thickness_mm + self.line_width_mm / 2.0)))


def compute_time_terms(settings: PrintTimeSettings) -> dict[str, Floats]:
    """Compute the seconds of each term for one unit of each of `FEATURES`.

    The nozzle stops and starts at each end of an infill line, and of a line of the narrow skin on a slope.
    The outermost strip of a flat face is printed as walls instead of skin.

    Parameters
    ----------
    settings
        Settings of the slicer.

    Returns
    -------
    dict
        For the name of each term, a float64 vector in the order of `FEATURES`, not yet multiplied by the
        term's factor in `FACTORS`.
    """
    s, layer_mm = settings, settings.layer_height_mm
    inner_walls_s_per_mm = max(s.wall_count - 1, 0) / s.inner_wall_mm_s
    walls_s_per_mm = (1.0 / s.outer_wall_mm_s if s.wall_count > 0 else 0.0) + inner_walls_s_per_mm
    support_lines_per_mm = 1.0 / s.support_line_distance_mm if s.support_line_distance_mm > 0.0 else 0.0
    infill_s_per_mm3 = s.sparse_lines_per_mm / (layer_mm * s.infill_mm_s)
    return {
        "infill": _build_vector(
            volume_mm3=infill_s_per_mm3,
            lateral_mm2=-infill_s_per_mm3 * s.wall_thickness_mm,
            # Half of the skin is at tops, below which infill is denser.
            skin_mm2=-infill_s_per_mm3 * s.skin_layer_count * layer_mm
            + s.top_line_ratio / 2.0 / (layer_mm * s.infill_mm_s),
        ),
        "walls": _build_vector(
            lateral_mm2=walls_s_per_mm / layer_mm, height_mm=-LOOP_SHORTENING * s.insets_s / layer_mm
        ),
        "connections": _build_vector(
            lateral_mm2=s.connection_s_per_mm2,
            height_mm=-LOOP_SHORTENING * s.wall_thickness_mm * s.connection_s_per_mm2,
        ),
        "skin": _build_vector(skin_mm2=s.skin_s_per_mm2),
        "skin rim": _build_vector(skin_rim_mm=-s.skin_s_per_mm2 * s.wall_thickness_mm),
        "slope ends": _build_vector(
            slope_mm2=s.compute_skin_stop_s(SLOPE_TURN_TIME_SHARE) / (layer_mm * s.skin_line_width_mm)
        ),
        "support to bed": _build_vector(column_mm3=support_lines_per_mm / (layer_mm * s.support_mm_s)),
        "support": _build_vector(support_mm3=support_lines_per_mm / (layer_mm * s.support_mm_s)),
        "support sides": _build_vector(
            support_side_mm2=1.0 / (layer_mm * s.support_mm_s) if support_lines_per_mm else 0.0
        ),
        "brim": _build_vector(brim_mm2=1.0 / (s.outer_line_width_mm * s.brim_mm_s)),
        "infill ends": _build_vector(lateral_mm2=s.infill_ends_s_per_mm2),
        "travel": _build_vector(lateral_mm2=1.0 / (layer_mm * s.travel_mm_s)),
    } | _compute_pose_terms(settings)


def _compute_pose_terms(settings: PrintTimeSettings) -> dict[str, Floats]:
    """Compute the seconds of the terms whose features depend on a pose, as in `compute_time_terms`."""
    s, layer_mm = settings, settings.layer_height_mm
    stop_s = s.travel_mm_s / s.acceleration_mm_s2 / 2.0
    return {
        "islands": _build_vector(
            islands_mm=s.retraction_s / layer_mm,
            towers_mm=TOWER_LAYER_S / layer_mm if s.support_line_distance_mm > 0.0 else 0.0,
        ),
        "island paths": _build_vector(
            islands_mm=stop_s / layer_mm, island_paths_mm2=1.0 / (layer_mm * s.travel_mm_s)
        ),
        "holes": _build_vector(holes_mm=HOLE_S / layer_mm),
        "rims": _build_vector(rim_mm=-s.skin_s_per_mm2 * s.wall_thickness_mm),
        # On average over all directions of the rim, a line ends once for every pi line widths along the rim.
        "rim ends": _build_vector(
            rim_ends_mm=s.skin_layer_count
            * s.compute_skin_stop_s(RIM_TURN_TIME_SHARE)
            / (math.pi * s.skin_line_width_mm)
        ),
        "rings": _build_vector(ring_mm2=s.connection_s_per_mm2 if s.infill_step_count else 0.0),
        "thin walls": _build_vector(
            single_wall_mm2=-max(s.wall_count - 1, 0) / s.inner_wall_mm_s / layer_mm,
            gap_mm2=0.5 / (layer_mm * s.skin_mm_s),
            solid_wall_mm2=-FACTORS["connections"] * s.connection_s_per_mm2
            - FACTORS["infill ends"] * s.infill_ends_s_per_mm2,
        ),
        "thin sheets": _build_vector(overlap_mm3=-1.0 / (layer_mm * s.skin_line_width_mm * s.skin_mm_s)),
        "steep tops": _build_vector(steep_top_mm2=s.top_line_ratio / (layer_mm * s.infill_mm_s)),
    }


def _compute_gain_s_per_mm(speed_mm_s: float, fast_mm_s: float) -> float:
    """Compute the seconds that a mm of line saves at a higher speed; 0 if the speed is not higher."""
    return 1.0 / speed_mm_s - 1.0 / fast_mm_s if fast_mm_s > speed_mm_s else 0.0


def _build_vector(**features: float) -> Floats:
    """Build a vector (features,) float64 in the order of `FEATURES`; features that are not named are 0."""
    return np.array([features.get(name, 0.0) for name in FEATURES])
