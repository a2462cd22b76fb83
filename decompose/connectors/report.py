"""Connectors as an object in decomposition.json."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from decompose.connectors.pair_shapes import measure_shape
from decompose.connectors.records import SLIDING_COS, Connectors, Mark, Pin
from decompose.options import PairShape
from decompose.pieces import Joint


def list_pin_sizes(pins: Sequence[Pin]) -> list[tuple[float, float, int]]:
    """List the pins and keys to cut, the largest first: diameter and length in mm, and the number of each."""
    counts = Counter((pin.diameter_mm, round(pin.length_mm, 1)) for pin in pins)
    return sorted(((*size_mm, count) for size_mm, count in counts.items()), reverse=True)


def describe_connectors(
    connectors: Connectors, names: Sequence[str], joints: Sequence[Joint]
) -> dict[str, Any]:
    """Describe pins, marks and gutters, and the steps and joints without them.

    Parameters
    ----------
    connectors
        Connectors of a decomposition.
    names
        Ids of the parts.
    joints
        Joints of the parts.
    """

    def name_joint_parts(number: int) -> list[str]:
        return [names[joints[number].a], names[joints[number].b]]

    return {
        "pins": [
            {"id": number, "joint": name_joint_parts(pin.joint), **_describe_pin(pin)}
            for number, pin in enumerate(connectors.pins, 1)
        ],
        "cut_list": [
            {"length_mm": length_mm, "diameter_mm": diameter_mm, "count": count}
            for diameter_mm, length_mm, count in list_pin_sizes(connectors.pins)
        ],
        "marks": [
            {"part": names[mark.part], "joint": name_joint_parts(mark.joint), **_describe_mark(mark)}
            for mark in connectors.marks
        ],
        "gutters": [
            {
                "part": names[gutter.part],
                "joint": name_joint_parts(gutter.joint),
                "line_mm": gutter.line_mm.tolist(),
            }
            for gutter in connectors.gutters
        ],
        "unpinned": [{"step": step + 1, "reason": reason} for step, reason in connectors.unpinned_steps],
        "unmarked": [
            {"joint": name_joint_parts(joint), "reason": reason}
            for joint, reason in connectors.unmarked_joints
        ],
        "failures": list(connectors.failures),
    }


def read_pair_shapes(report: Mapping[str, Any]) -> tuple[PairShape, ...]:
    """Read the shape of the pair of each step from decomposition.json.

    Parameters
    ----------
    report
        Content of decomposition.json; files of older versions have no connectors.
    """
    pins_by_step: dict[int, list[Mapping[str, Any]]] = {}
    for pin in (report.get("connectors") or {}).get("pins", ()):
        if pin.get("along") is None or abs(np.dot(pin["along"], pin["axis"])) <= SLIDING_COS:
            pins_by_step.setdefault(pin["step"], []).append(pin)
    return tuple(_measure_described_pair(*pins[:2]) for pins in pins_by_step.values() if len(pins) > 1)


def _measure_described_pair(first: Mapping[str, Any], second: Mapping[str, Any]) -> PairShape:
    """Measure the shape of a pair of described pins."""
    directions = [None if pin.get("along") is None else np.array(pin["along"]) for pin in (first, second)]
    points_mm = np.array(first["at_mm"]), np.array(second["at_mm"])
    lengths_mm = first["length_mm"], second["length_mm"]
    return measure_shape(np.array(first["axis"]), points_mm, (directions[0], directions[1]), lengths_mm)


def _describe_pin(pin: Pin) -> dict[str, Any]:
    """Describe a pin or key."""
    return {
        "step": pin.step + 1,
        "at_mm": pin.position_mm.tolist(),
        "axis": (pin.axis + 0.0).tolist(),  # without -0
        "diameter_mm": pin.diameter_mm,
        "depth_mm": pin.depth_mm,
        "length_mm": pin.length_mm,
        "kind": "key" if pin.key_direction is not None else "slot" if pin.is_slotted else "round",
        "along": None if pin.key_direction is None else (pin.key_direction + 0.0).tolist(),
    }


def _describe_mark(mark: Mark) -> dict[str, Any]:
    """Describe the text of a mark."""
    return {"text": mark.text, "height_mm": mark.height_mm, "lines_mm": mark.lines_mm.tolist()}
