"""Qualities of this project: each is one of Cura's qualities with changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from slicing.settings.formula import Formula
from slicing.settings.resolver import ProfileIndex

SUPPORT_VALUES = {"support_enable": True, "support_type": "everywhere"}
_BRIM_SETTINGS = {
    "adhesion_type": "brim",
    "brim_width": 8.0,
    # Cura's own formula: its profiles for nylon, TPU and others name a count, which would take precedence
    # over the width.
    "brim_line_count": Formula(
        "math.ceil(brim_width / (skirt_brim_line_width * initial_layer_line_width_factor / 100.0))"
    ),
}
# Values of Cura's own profiles, below the changes of a quality and the user's settings.
(
    _CURA_WALL_SPEED,
    _CURA_SKIN_SPEED,
    _CURA_ROOF_SPEED,
    _CURA_SKIN_ORDER,
    _CURA_BRIM_LINE_WIDTH,
    _CURA_FIRST_LINE_FACTOR,
) = (
    f"extruderValueFromContainer(0, '{key}', {int(ProfileIndex.QUALITY)})"
    for key in (
        "speed_wall_x",
        "speed_topbottom",
        "speed_roofing",
        "skin_monotonic",
        "skirt_brim_line_width",
        "initial_layer_line_width_factor",
    )
)
# Fewer and wider lines with the same plastic, at most 1.1 times as wide as the nozzle. The flow is that of
# the infill in the prints of the Parallelobox paper (0.35 mm x 0.25 mm x 60 mm/s = 5.25 mm3/s, nozzle of
# 0.4 mm), and 4 % more in the thickest layers to which heights are fitted.
_MAX_FLOW_MM3_S = 5.5
MAX_FAST_FLOW_MM3_S = 8.5  # [assumed] maximum flow of lines that are made faster, with a large nozzle
DEPENDENT_SPEEDS: Mapping[str, frozenset[str]] = {
    "speed_wall_x": frozenset(("speed_print", "speed_wall")),
    "speed_topbottom": frozenset(("speed_print",)),
}
"""Speeds of a quality that Cura's own formulas replace if the user sets one of these."""
SMALL_OVERHANG_MM2 = 25.0  # [assumed] area of the small overhangs of `EngineSettings.small_overhang_deg`
_INFILL_LINE_WIDTH, _SKIN_LINE_WIDTH = (
    "max(line_width, min(1.1 * machine_nozzle_size,"
    f" {_MAX_FLOW_MM3_S} / (resolveOrValue('layer_height') * {speed})))"
    " if machine_nozzle_size >= 0.4 else line_width"
    for speed in ("speed_infill", "speed_topbottom")
)
_FIRST_LINE_FACTOR = (
    # The thickest first layer to which heights are fitted, so that a part's height does not matter.
    f"{_CURA_FIRST_LINE_FACTOR} if {_CURA_FIRST_LINE_FACTOR} != 100 else"
    " 120.0 if 1.2 * skin_line_width * max(resolveOrValue('layer_height_0'), 0.85 * machine_nozzle_size)"
    f" * (speed_print_layer_0 if speed_slowdown_layers else speed_topbottom) <= {_MAX_FLOW_MM3_S} else 100.0"
)


_FAST_FLOW = f"min({MAX_FAST_FLOW_MM3_S}, {_MAX_FLOW_MM3_S} * max(1.0, machine_nozzle_size / 0.4))"


def compute_fast_flow_mm3_s(nozzle_mm: float) -> float:
    """Compute the maximum flow, as `_FAST_FLOW` does, of lines that are made faster than Cura's own.

    Parameters
    ----------
    nozzle_mm
        Diameter of the nozzle.
    """
    return min(MAX_FAST_FLOW_MM3_S, _MAX_FLOW_MM3_S * max(1.0, nozzle_mm / 0.4))


@dataclass(frozen=True, slots=True)
class HiddenLayers:
    """Number of solid layers of faces that are hidden once the parts are glued.

    Attributes
    ----------
    bed_layers
        On a cut face that lies on the bed.
    top_layers
        At the top of a part whose tops are all cut faces. None of them is printed at the slow speed
        of the uppermost layer of a visible top.
    """

    bed_layers: int
    top_layers: int


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of the farm: one of Cura's, with changes that the user's own settings override."""

    bases: tuple[str, ...]  # Cura's qualities; the first that exists for the nozzle and the material is used
    changes: Mapping[str, Any]
    fits_layers: bool = False  # layer heights are fitted to each part's height
    compensates_shrinkage: bool = False  # parts are printed larger by the shrinkage of their material
    fits_first_layer: bool = False  # brim and first layer are chosen for each part
    hidden_layers: HiddenLayers | None = None  # None if they have as many as visible faces
    # Walls on hidden sides are printed with the flow of infill, at most this multiple of their own speed.
    hidden_wall_ratio: float = 1.0
    small_overhang_deg: float = 0.0  # see `EngineSettings`
    # Uppermost layers keep Cura's order of lines only in parts with visible flat tops.
    orders_only_flat_tops: bool = False
    # Hidden sides have one wall; not if the user sets the number of walls or their thickness.
    has_single_hidden_walls: bool = False


# The settings of the prints in the Parallelobox paper, to compare print times with it.
_PAPER = Quality(
    ("fast", "standard"),
    {
        **SUPPORT_VALUES,
        **_BRIM_SETTINGS,
        "layer_height": 0.25,
        "infill_sparse_density": 5.0,
        "infill_pattern": "zigzag",
        "support_angle": 45.0,
        "material_bed_temperature": 50.0,
    },
)

# For parts that are glued: closed tops over a light infill, and a brim that holds tall thin blocks.
_GLUE = Quality(
    ("fast", "draft", "normal", "high", "standard", "super"),
    {
        **SUPPORT_VALUES,
        **_BRIM_SETTINGS,
        # Half the nozzle's diameter, where Cura's fast profile has 0.15 mm: a quarter faster, and the
        # seams of a glued model are more visible than its layers.
        "layer_height": Formula("round(max(extruderValues('machine_nozzle_size')) / 2, 2)"),
        "infill_sparse_density": 10.0,
        "infill_pattern": "zigzag",
        "infill_line_width": Formula(_INFILL_LINE_WIDTH),
        "skin_line_width": Formula(_SKIN_LINE_WIDTH),
        "roofing_line_width": Formula("line_width"),  # because the uppermost layer of a top is visible
        # [assumed] The first layer is slow, so its lines are wider, by the factor of Cura's profiles for
        # newer printers of Ultimaker, but not with more flow than that of the infill. Lines of the brim keep
        # their width, so that it is as wide as before.
        "initial_layer_line_width_factor": Formula(_FIRST_LINE_FACTOR),
        "skirt_brim_line_width": Formula(
            f"{_CURA_BRIM_LINE_WIDTH} * {_CURA_FIRST_LINE_FACTOR} / initial_layer_line_width_factor"
        ),
        # Cura's pattern "lines" is as dense, but the head stops and travels between any two lines.
        "top_bottom_pattern": "zigzag",
        # [assumed] Half the infill deeper than 2 mm below any top, where it carries no load. The walls
        # bear the load of a glued joint, as in the paper's prints, whose infill is as light everywhere.
        "gradual_infill_steps": 1,
        "gradual_infill_step_height": 2.0,
        "support_angle": 50.0,
        "top_layers": Formula("max(4, math.ceil(round(top_thickness / resolveOrValue('layer_height'), 4)))"),
        # [assumed] Inner walls may have the speed of infill, whose lines are wider; at most a quarter more
        # than Cura's own, because some materials need slow walls, and not with more flow than is melted.
        "speed_wall_x": Formula(
            f"max({_CURA_WALL_SPEED}, min(speed_infill, 1.25 * {_CURA_WALL_SPEED},"
            f" {_FAST_FLOW} / (line_width * resolveOrValue('layer_height'))))"
        ),
        # [assumed] Only the uppermost layer of a visible top needs Cura's slow speed of skins. The
        # others are printed like inner walls.
        "speed_topbottom": Formula(
            f"max({_CURA_SKIN_SPEED}, min(speed_wall_x, speed_infill, 2 * {_CURA_SKIN_SPEED}))"
        ),
        "speed_roofing": Formula(f"min(speed_topbottom, {_CURA_ROOF_SPEED})"),
        "roofing_layer_count": Formula("1 if top_layers > 1 else 0"),
        # All walls of a hole follow each other; `slicing.glued_parts` chooses the order of the holes.
        "optimize_wall_printing_order": True,
        # Lines in the order of their positions look even, but need more travel where grooves divide them.
        # Only the uppermost layer of a visible top keeps Cura's order.
        "roofing_monotonic": Formula(_CURA_SKIN_ORDER),
        "skin_monotonic": Formula(f"{_CURA_SKIN_ORDER} and roofing_layer_count == 0"),
    },
    fits_layers=True,
    compensates_shrinkage=True,
    fits_first_layer=True,
    # [assumed] Two crossing layers on the bed carry the load of a glued joint to the walls and the
    # infill; three close a top over light infill well enough for glue.
    hidden_layers=HiddenLayers(2, 3),
    # [assumed] A strip of an overhang is printed well up to this angle; support would be a thin tower.
    small_overhang_deg=55.0,
    # [assumed] On slopes, each layer shows narrow strips: the order of their lines is hardly seen.
    orders_only_flat_tops=True,
    # [assumed] Walls with the flow of infill are good enough on hidden sides.
    hidden_wall_ratio=2.0,
    # [assumed] A glued face needs one wall: the infill ends at it, and carries the load through the part.
    has_single_hidden_walls=True,
)

FARM_QUALITIES: Mapping[str, Quality] = {
    "paper": _PAPER,
    # The paper's settings with fewer layers of hidden faces, to measure the saving.
    "paper-hidden": replace(_PAPER, hidden_layers=HiddenLayers(1, 2)),
    "glue": _GLUE,
    # The same without the assumptions on strength, for joints that bear a load.
    "glue-strong": replace(
        _GLUE,
        changes={**_GLUE.changes, "gradual_infill_steps": 0, "optimize_wall_printing_order": False},
        hidden_layers=None,
        hidden_wall_ratio=1.0,
        has_single_hidden_walls=False,
    ),
}
DEFAULT_QUALITY = "glue"
