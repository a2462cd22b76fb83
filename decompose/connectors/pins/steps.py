"""Pins and keys of all assembly steps, without those that others make redundant.

The pairs of any two steps are unlike (`pair_shapes`), so that a body fits only in its own place.
"""

from __future__ import annotations

from collections.abc import Sequence

from decompose.arrays import Floats
from decompose.assembly import Assembly, AssemblyStep
from decompose.connectors.coverage import Site, sample_glue
from decompose.connectors.faces import Side, Workpieces, find_sides
from decompose.connectors.pair_shapes import measure_pair
from decompose.connectors.pins.placer import PinPlacer
from decompose.connectors.pins.redundant import find_redundant_pins
from decompose.connectors.records import Pin, find_pairs
from decompose.options import ConnectorOptions
from decompose.pieces import Joint

MIN_ALIGNED_COS = 0.999  # minimum cosine between a step's direction and the normal of a face that closes
SLIDING_SIN = 1e-7  # maximum sine of the angle between a face that slides and the direction of the step
NO_PERPENDICULAR_FACE_REASON = "no glued face is perpendicular to the direction in which the parts are joined"


def place_pins(
    workpieces: Workpieces,
    joints: Sequence[Joint],
    assembly: Assembly,
    options: ConnectorOptions,
    min_glue_mm2: float,
) -> tuple[list[Pin], list[tuple[int, str]]]:
    """Place the pins of all steps, and add their holes to the tools of the workpieces.

    No pair is like another one, or like those in `options`.

    Parameters
    ----------
    workpieces
        Parts, with the tools placed so far; the new tools are added.
    joints, assembly
        Joints of these parts, and the order in which they are glued.
    options
        Diameter of the pins, and shapes that pairs must not have.
    min_glue_mm2
        Minimum area of a joint whose glue counts as holding.

    Returns
    -------
    list of Pin
        Pins in the order of the steps.
    list of (int, str)
        Steps without a pin, each with the reason.
    """
    pins: list[Pin] = []
    unpinned_steps: list[tuple[int, str]] = []
    glue_points_by_step_mm: list[Floats] = []
    if options.pin_mm is None:
        return pins, unpinned_steps
    for number, step in enumerate(assembly.steps):
        holding_joints = [j for j in step.joints if joints[j].holds(min_glue_mm2)]
        pairs = [pair for j in holding_joints for pair in find_sides(workpieces.blanks, j, joints[j])]
        sites, sliding_sites = _find_sites(pairs, step), _find_sites(pairs, step, is_sliding=True)
        glue_points_mm = sample_glue([side for side, _ in pairs])
        glue_points_by_step_mm.append(glue_points_mm)
        placer = PinPlacer(workpieces, number, step, sites, sliding_sites, glue_points_mm, options.pin_mm)
        pair_shapes = [measure_pair(*pair) for pair in find_pairs(pins).values()]
        new_pins = placer.place_connectors([*options.used_shapes, *pair_shapes])
        pins += new_pins
        if not new_pins:
            unpinned_steps.append((number, "too small for a pin" if sites else NO_PERPENDICULAR_FACE_REASON))
    redundant_pins = find_redundant_pins(workpieces, glue_points_by_step_mm, pins)
    workpieces.remove_tools(hole for pin in redundant_pins for hole in pin.holes)
    return [pin for pin in pins if pin not in redundant_pins], unpinned_steps


def _find_sites(
    pairs: Sequence[tuple[Side, Side]], step: AssemblyStep, *, is_sliding: bool = False
) -> list[Site]:
    """Find the faces that close along the direction of a step, or those that slide along it.

    Faces that close are perpendicular to the direction, and meet only at the end of the movement. Faces that
    slide are parallel to it, and move over each other. `pairs` are the sides of all faces that a step glues.
    """
    sites = []
    for one, other in pairs:
        moved, fixed = (one, other) if one.part in step.moved_parts else (other, one)
        alignment_cos = float(moved.inward_normal @ step.direction)
        if abs(alignment_cos) < SLIDING_SIN if is_sliding else alignment_cos > MIN_ALIGNED_COS:
            sites.append(Site(moved, fixed))
    return sites
