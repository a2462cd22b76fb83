"""Marks and pins of an assembly step, as rows for the page of instructions."""

from __future__ import annotations

from collections import Counter
from typing import Any

from decompose.connectors import Mark, Pin
from decompose.export.pin_sheet import format_pin_size
from decompose.files.names import find_part_number
from decompose.results import Decomposition

# Characters with which the page shows the arrow and the dots of a mark.
SIGN_TABLE = str.maketrans({"^": " ↑", ".": "●"})


def list_mark_texts(decomposition: Decomposition, joint: int) -> list[dict[str, str]]:
    """List the texts of the marks on both faces of a joint, each with the number of its part.

    The entry "key" identifies a mark on the page (`data-mark`); it has nothing to do with keys in grooves.

    Parameters
    ----------
    decomposition
        Decomposition with its connectors.
    joint
        Index of the joint.
    """
    pair = decomposition.joints[joint]
    return [
        {
            "text": mark.text.translate(SIGN_TABLE),
            "part": find_part_number(decomposition.parts[mark.part].id),
            "key": f"{name_mark(decomposition, mark)} {mark.text}",
        }
        for mark in decomposition.connectors.marks
        if mark.joint == joint and mark.part in (pair.a, pair.b)
    ]


def list_unmarked_parts(decomposition: Decomposition, joint: int) -> list[str]:
    """List the numbers of the parts that have no mark on a joint; empty if no marks were requested.

    Parameters
    ----------
    decomposition, joint
        As in `list_mark_texts`.
    """
    if not decomposition.options.connectors.marks:
        return []
    marked_parts = {mark.part for mark in decomposition.connectors.marks if mark.joint == joint}
    pair = decomposition.joints[joint]
    return [
        find_part_number(decomposition.parts[part].id)
        for part in (pair.a, pair.b)
        if part not in marked_parts
    ]


def list_pins(decomposition: Decomposition, joint: int) -> list[dict[str, str]]:
    """List the pins of a joint, with their numbers in the report.

    Parameters
    ----------
    decomposition, joint
        As in `list_mark_texts`.
    """
    return [
        {"id": str(number), "kind": name_pin_kind(pin), "size": format_pin_size(pin)}
        for number, pin in enumerate(decomposition.connectors.pins, 1)
        if pin.joint == joint
    ]


def name_pin_kind(pin: Pin) -> str:
    """Name the kind of a pin."""
    return "pin" if pin.key_direction is None else "sliding key" if pin.slides else "key"


def explain_pins(decomposition: Decomposition, step: int) -> str:
    """Explain how to use the pins of a step, or why it has none; empty if no pins were requested.

    Parameters
    ----------
    decomposition
        Decomposition with its connectors.
    step
        Index of the step.
    """
    pins = [pin for pin in decomposition.connectors.pins if pin.step == step]
    pin_mm = decomposition.options.connectors.pin_mm
    if pin_mm is None:
        return ""
    if not pins:
        reasons = dict(decomposition.connectors.unpinned_steps)
        reason = reasons.get(step, "the holes were left out")
        return f"No pins ({reason}): align the faces by their rims."
    pins_in_holes = [pin for pin in pins if pin.key_direction is None]
    keys = [pin for pin in pins if pin.key_direction is not None and not pin.slides]
    sentences = []
    if pins_in_holes:
        sentences.append(f"Put {_describe_sizes(pins_in_holes, 'pin')} into the lower body first, as drawn.")
    if len({round(pin.length_mm, 1) for pin in pins_in_holes}) > 1:
        sentences.append(
            "The longer one belongs in the deeper hole; if they are exchanged, the joint stays open."
        )
    if keys:
        sentences.append(f"Lay {_describe_sizes(keys, 'key')} into the grooves of the lower body, as drawn.")
    for n, body in enumerate(("lower", "upper")):
        sliding = [pin for pin in pins if pin.slides and pin.holes[n].exit_direction is not None]
        if sliding:
            sentences.append(
                f"Glue {_describe_sizes(sliding, 'sliding key')} into the short grooves of the {body} body "
                "first: the long grooves of the other body slide over them."
            )
    if any(pin.key_direction is not None and pin.diameter_mm < pin_mm for pin in pins):
        sentences.append(
            "If you have no filament for the thin keys, leave their grooves empty and align the rims."
        )
    if len(pins) == 1 and pins_in_holes:
        sentences.append("One pin does not prevent a rotation: align the rims.")
    return " ".join(sentences)


def name_mark(decomposition: Decomposition, mark: Mark) -> str:
    """Build the name of a mark from the id of its part and the ids of both parts of its joint."""
    joint = decomposition.joints[mark.joint]
    return " ".join(decomposition.parts[part].id for part in (mark.part, joint.a, joint.b))


def list_unglued_mark_texts(decomposition: Decomposition) -> list[dict[str, Any]]:
    """List the texts of the marks on joints that no step glues."""
    used_joints = {joint for step in decomposition.assembly.steps for joint in step.joints}
    joints = dict.fromkeys(mark.joint for mark in decomposition.connectors.marks)
    return [
        text for joint in joints if joint not in used_joints for text in list_mark_texts(decomposition, joint)
    ]


def _describe_sizes(pins: list[Pin], noun: str) -> str:
    """Describe the number of pins of each size, as part of a sentence."""
    sizes = Counter(format_pin_size(pin) for pin in pins)
    return " and ".join(f"{count} {noun}{'s' * (count > 1)} of {size} mm" for size, count in sizes.items())
