"""Plan of the pins, marks and gutters of all parts, and the cutting of their holes and grooves."""

from __future__ import annotations

from collections.abc import Sequence

from decompose.assembly import Assembly
from decompose.connectors.faces import Blank, Workpieces
from decompose.connectors.gutters import place_gutters
from decompose.connectors.marks import place_marks
from decompose.connectors.pins import place_pins
from decompose.connectors.records import Connectors
from decompose.geometry import Solid
from decompose.options import ConnectorOptions
from decompose.pieces import Joint


def plan_connectors(
    blanks: Sequence[Blank],
    joints: Sequence[Joint],
    assembly: Assembly,
    options: ConnectorOptions,
    min_glue_mm2: float,
) -> Connectors:
    """Place pins, then marks beside them, then gutters for the seams.

    Parameters
    ----------
    blanks
        Parts with their poses.
    joints, assembly
        Joints of these parts, and their assembly, in the same frame.
    options
        Diameter of the pins, shapes of existing pairs, from which those of new pairs must differ, and whether
        there are marks and gutters. The clearance of a hole comes from each blank.
    min_glue_mm2
        Minimum area of a joint whose glue counts as holding.
    """
    workpieces = Workpieces(blanks)
    pins, unpinned_steps = place_pins(workpieces, joints, assembly, options, min_glue_mm2)
    marks, unmarked_joints = place_marks(workpieces, joints, assembly) if options.marks else ([], [])
    gutters = place_gutters(workpieces, joints) if options.marks else []
    return Connectors(
        tuple(pins), tuple(marks), tuple(unpinned_steps), tuple(unmarked_joints), gutters=tuple(gutters)
    )


def drill_parts(blanks: Sequence[Blank], connectors: Connectors) -> list[Solid]:
    """Cut the holes and grooves out of the parts; return the solids in the order of the parts.

    Parameters
    ----------
    blanks
        Parts without holes.
    connectors
        Connectors of all parts.

    Raises
    ------
    ModelNotSolid
        An operation on solids failed.
    """
    tools: list[list[Solid]] = [[] for _ in blanks]
    for tool in connectors.tools:
        tools[tool.part].append(Solid.hull(tool.points_mm))
    return [
        blank.solid.subtract(Solid.union(part_tools)) if part_tools else blank.solid
        for blank, part_tools in zip(blanks, tools, strict=True)
    ]
