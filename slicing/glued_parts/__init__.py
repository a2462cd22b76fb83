"""Changes of CuraEngine's G-code for parts that are glued, whose cut faces are invisible afterwards.

CuraEngine prints all faces of a part alike. Along hidden upright sides, inner walls are removed and the
others printed faster; skin that closes hidden marks and grooves is left out; and the lines of each layer are
printed in the order with the least travel.
"""

from __future__ import annotations

from slicing.glued_parts.fast_walls import speed_up_hidden_walls
from slicing.glued_parts.inner_walls import remove_inner_walls, removes_inner_walls
from slicing.glued_parts.line_order import reorder_infill, reorder_outlines
from slicing.glued_parts.recess_skins import HiddenRecess, remove_recess_skins
from slicing.glued_parts.sides import MAX_NOTCH_DEPTH_MM, TRANSITION_MM, HiddenSide, SideGroove
from slicing.glued_parts.wall_order import reorder_inner_walls

__all__ = [
    "MAX_NOTCH_DEPTH_MM",
    "TRANSITION_MM",
    "HiddenRecess",
    "HiddenSide",
    "SideGroove",
    "remove_inner_walls",
    "remove_recess_skins",
    "removes_inner_walls",
    "reorder_infill",
    "reorder_inner_walls",
    "reorder_outlines",
    "speed_up_hidden_walls",
]
