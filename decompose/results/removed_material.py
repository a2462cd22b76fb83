"""Check that drilling removed nothing but the holes, grooves and marks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from decompose.connectors import Tool
from decompose.geometry import Solid

EPS_MM3 = 1e-3  # maximum rounding error of an operation on solids
ENLARGEMENT_MM = 0.005  # distance by which tools are enlarged for the comparison with the removed material
# Minimum thickness of a real difference; thinner differences are errors at nearly coincident faces.
MIN_THICKNESS_MM = 0.05


def find_other_changes(undrilled_solid: Solid, drilled_solid: Solid, tools: Sequence[Tool]) -> Iterator[str]:
    """Find changes other than the removal of the material inside the tools, and yield a phrase for each.

    Parameters
    ----------
    undrilled_solid, drilled_solid
        Part before and after drilling.
    tools
        Tools that were cut out of the part.
    """
    if _removes_only_tools(undrilled_solid, drilled_solid, tools):
        return
    if is_thick(drilled_solid.subtract(undrilled_solid)):
        yield "material was added"
    removed_solid = undrilled_solid.subtract(drilled_solid)
    if is_thick(removed_solid.subtract(Solid.union([_enlarge_tool(tool) for tool in tools]))):
        yield "more was removed than the holes and marks"


def is_thick(solid: Solid) -> bool:
    """Check whether a difference of two solids contains more than thin films."""
    return solid.volume_mm3 > EPS_MM3 and any(
        piece.volume_mm3 > max(EPS_MM3, MIN_THICKNESS_MM * piece.area_mm2 / 2.0)
        for piece in solid.list_pieces()
    )


def _removes_only_tools(undrilled_solid: Solid, drilled_solid: Solid, tools: Sequence[Tool]) -> bool:
    """Check by volumes and vertices that drilling changed nothing outside the tools.

    This takes a third of the time of subtracting two solids with nearly the same surface. If this check
    fails, the difference may still be only a thin film.
    """
    union = Solid.union([Solid.hull(tool.points_mm) for tool in tools])
    removed_mm3 = undrilled_solid.volume_mm3 - drilled_solid.volume_mm3
    if abs(removed_mm3 - undrilled_solid.intersect(union).volume_mm3) > EPS_MM3:
        return False
    vertices, drilled_vertices = (
        set(map(tuple, solid.arrays()[0].tolist())) for solid in (undrilled_solid, drilled_solid)
    )
    changes_mm = np.array(list(vertices ^ drilled_vertices)).reshape(-1, 1, 3)
    lows_mm = np.array([tool.points_mm.min(axis=0) for tool in tools]) - ENLARGEMENT_MM
    highs_mm = np.array([tool.points_mm.max(axis=0) for tool in tools]) + ENLARGEMENT_MM
    is_in_box = np.all((changes_mm >= lows_mm) & (changes_mm <= highs_mm), axis=2)
    return bool(np.any(is_in_box, axis=1).all())


def _enlarge_tool(tool: Tool) -> Solid:
    """Build a slightly larger tool, because operations on solids fail where faces coincide."""
    offsets = tool.points_mm - tool.points_mm.mean(axis=0)
    return Solid.hull(tool.points_mm + ENLARGEMENT_MM * offsets / np.linalg.norm(offsets, axis=1)[:, None])
