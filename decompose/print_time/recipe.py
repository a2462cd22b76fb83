"""Print settings, and the seconds that each feature of a part takes with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats

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
    bed: the support's volume, if it reaches the bed.
"""


FEATURES = (
    *ADDITIVE,
    *("height_mm", "skin_rim_mm", "brim_mm2"),
    *("support_mm3", "support_side_mm2", "towers_mm", "islands_mm"),
)
"""All features. Those that do not add up are the height, the root of `skin_mm2`, the ring of the brim about
the part's rectangle and, if the columns of a part are measured (`columns`), its islands, and its support
in place of `column_mm3`."""


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
"""Factors of the seconds of each term of `time_terms`: one set for all settings.

``columns`` replaces all of `SUPPORT` where only tables are available. The factor of ``islands`` is in seconds
a layer: there and back, with a retraction each way.
"""


SUPPORT = ("support", "support sides", "islands")
TOWER = 2.7
"""Time of a layer of a tower of support, as a multiple of an island's: it is printed, too."""


INSET = 8.0
"""Length by which a loop is shorter for each mm that it lies inside the outline: two mm at each right
angle."""


OUTLINE_MM = 0.004
"""Margin below the greatest overhang of a layer, beyond which it gets support: outlines are rounded, and a
line of support grows to the whole face. Without it a face at just the support angle would be priced without
one."""


TURN_TIME_SHARE = 0.5
"""Time lost at a turn of an infill line along the wall, as a share of the time lost at its end."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """Slicer settings that decide print time, in mm, mm/s and s."""

    layer_height_mm: float = 0.25
    line_width_mm: float = 0.35
    outer_line_width_mm: float = 0.35
    wall_count: int = 2
    skin_layers: float = 3.0  # mean of top and bottom
    bed_layers_saved: float = 0.0  # layers of skin that a hidden face on the bed has less, see `hidden_faces`
    top_layers_saved: float = 0.0  # and that hidden tops have less
    infill_line_distance_mm: float = 7.0  # mean spacing, all directions together; 0 without infill
    infill_connected: bool = True  # along the walls, as a zigzag is
    infill_steps: int = 0  # times that the infill gets half as dense with its depth below the tops
    infill_step_mm: float = 0.0  # depth of each step
    support_line_distance_mm: float = 2.333  # 0 without support
    outer_wall_mm_s: float = 40.0
    inner_wall_mm_s: float = 50.0
    infill_mm_s: float = 60.0
    skin_mm_s: float = 30.0
    support_mm_s: float = 40.0
    support_angle_deg: float = 45.0  # from the vertical; faces that lean out further get support
    brim_mm: float = 8.0
    brim_mm_s: float = 30.0  # of the first layer
    speeding_layers: int = 2  # number of layers over which the speed rises to that of the others
    travel_mm_s: float = 150.0
    acceleration_mm_s2: float = 3000.0
    min_layer_s: float = 5.0  # the slicer slows down shorter layers to this time
    shrinkage: float = 0.007  # of the material, a share of its length, which makes parts warp
    prelude_s: float = 0.0  # heating, homing, start and end code, once for each part

    @property
    def walls_mm(self) -> float:
        """Width of all walls together."""
        return self.outer_line_width_mm + max(self.wall_count - 1, 0) * self.line_width_mm

    @property
    def insets_s(self) -> float:
        """Sum over the walls of a layer: mm that each lies inside the outline, over its speed."""
        inner = range(1, self.wall_count)
        depths_mm = [self.outer_line_width_mm + (i - 0.5) * self.line_width_mm for i in inner]
        outer_s = self.outer_line_width_mm / 2.0 / self.outer_wall_mm_s if self.wall_count > 0 else 0.0
        return outer_s + sum(depths_mm) / self.inner_wall_mm_s

    @property
    def skin_s_mm(self) -> float:
        """Seconds for a mm of line in all layers of a skin; every second skin lies on the bed."""
        layers = min(self.speeding_layers, round(self.skin_layers))
        faster = (self.skin_mm_s - self.brim_mm_s) / max(self.speeding_layers, 1)
        first = sum(1.0 / (self.brim_mm_s + i * faster) for i in range(layers))
        return self.skin_layers / self.skin_mm_s + (first - layers / self.skin_mm_s) / 2.0

    @property
    def deep_lines_mm(self) -> float:
        """Lines of infill in a mm, all directions together, where it is sparsest."""
        distance_mm = self.infill_line_distance_mm * 2.0**self.infill_steps
        return 1.0 / distance_mm if distance_mm > 0.0 else 0.0

    @property
    def top_lines(self) -> float:
        """Mm of lines below each mm2 of a top that its infill has more than elsewhere, over a mm of depth."""
        return (
            self.infill_step_mm
            * self.deep_lines_mm
            * (2.0 ** (self.infill_steps + 1) - 2.0 - self.infill_steps)
        )

    @property
    def supported_deg(self) -> float:
        """Angle from the vertical beyond which faces count as supported: slightly less than the setting."""
        out_mm = self.layer_height_mm * math.tan(math.radians(self.support_angle_deg)) - OUTLINE_MM
        return math.degrees(math.atan2(max(0.0, out_mm), self.layer_height_mm))

    @property
    def skin_cos(self) -> float:
        """Minimum |n| of faces with skin: on flatter faces the next few layers cover less than the walls."""
        bare_mm = self.skin_layers * self.layer_height_mm
        return math.cos(math.atan(bare_mm / (self.walls_mm + self.line_width_mm / 2.0)))


def time_terms(recipe: Recipe) -> dict[str, Floats]:
    """Compute the seconds of each term, by name, for one unit of each of `FEATURES`.

    A line of infill or of a slope's narrow skin ends where it turns round: the nozzle stops and starts. Walls
    cover the rim of a skin.

    Parameters
    ----------
    recipe
        Settings of the slicer.

    Returns
    -------
    dict
        (12,) float64 vectors in the order of `FEATURES`, before `FACTORS`.
    """

    def vector(**features: float) -> Floats:
        return np.array([features.get(name, 0.0) for name in FEATURES])

    r, layer = recipe, recipe.layer_height_mm
    inner_walls = max(r.wall_count - 1, 0) / r.inner_wall_mm_s
    walls = (1.0 / r.outer_wall_mm_s if r.wall_count > 0 else 0.0) + inner_walls
    lines = r.deep_lines_mm
    supports = 1.0 / r.support_line_distance_mm if r.support_line_distance_mm > 0.0 else 0.0
    infill = lines / (layer * r.infill_mm_s)
    connected = r.infill_connected and lines > 0.0
    ends = lines * r.infill_mm_s / r.acceleration_mm_s2 / layer
    skin = r.skin_s_mm / r.line_width_mm
    return {
        "infill": vector(
            volume_mm3=infill,
            lateral_mm2=-infill * r.walls_mm,
            # Every second skin is a top.
            skin_mm2=-infill * r.skin_layers * layer + r.top_lines / 2.0 / (layer * r.infill_mm_s),
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
        "infill ends": vector(lateral_mm2=ends * (TURN_TIME_SHARE if connected else 1.0)),
        "travel": vector(lateral_mm2=1.0 / (layer * r.travel_mm_s)),
    }
