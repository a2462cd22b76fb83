"""Redundant pins, which can be left out because other pins reach enough of the glued area of all steps.

Each step gets pins until they reach enough of its own glued area (`coverage`). Some of these pins reach only
a corner of a face, but their holes take as long to print as those of other pins.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist

from decompose.arrays import Bools, Floats
from decompose.connectors.coverage import REACH_MM
from decompose.connectors.faces import Workpieces
from decompose.connectors.records import Pin, find_pairs

# Minimum share of the glued area of all steps, and of each single step, that the remaining pins reach. If a
# share is smaller already, no pin is left out that would reduce it.
MIN_TOTAL_SHARE, MIN_STEP_SHARE = 0.96, 0.8
# Print time of a groove on a level face (`Workpieces.is_level`), as a multiple of that on an upright face.
LEVEL_COST = 4.0


def find_redundant_pins(
    workpieces: Workpieces, glue_points_mm: Sequence[Floats], pins: Sequence[Pin]
) -> list[Pin]:
    """Find the pins that can be left out.

    They are chosen one after another: the pin with the smallest ratio of the glued area that only this pin
    reaches to its print time.

    Print time counts more in parts with many pins, because the job ends with the slowest part. The first two
    pins of a step, which align its parts, always stay.

    Parameters
    ----------
    workpieces
        Parts with their poses.
    glue_points_mm
        For each step, (n, 3) points from `sample_glue`, each of which represents the same area.
    pins
        Pins and keys of all steps.
    """
    costs = [[LEVEL_COST if workpieces.is_level(hole) else 1.0 for hole in pin.holes] for pin in pins]
    loads = np.zeros(len(workpieces.blanks))  # sum of the costs in each part
    for pin, hole_costs in zip(pins, costs, strict=True):
        loads[[hole.part for hole in pin.holes]] += hole_costs
    numbers = [[n for n, pin in enumerate(pins) if pin.step == step] for step in range(len(glue_points_mm))]
    reached = [
        cdist([pins[n].position_mm for n in step_numbers] or np.zeros((0, 3)), points_mm) < REACH_MM
        for step_numbers, points_mm in zip(numbers, glue_points_mm, strict=True)
    ]
    pairs = find_pairs(pins)
    total = sum(map(len, glue_points_mm))
    redundant_pins: list[Pin] = []
    while True:
        counts = [_count_reached(rows) for rows in reached]
        best: tuple[float, int, int] | None = None
        for step, (first, second) in pairs.items():
            for row, n in enumerate(numbers[step]):
                if pins[n] is first or pins[n] is second:
                    continue
                remaining_count = _count_reached(np.delete(reached[step], row, axis=0))
                lost_count = counts[step] - remaining_count
                is_enough = remaining_count >= min(counts[step], MIN_STEP_SHARE * reached[step].shape[1])
                if is_enough and sum(counts) - lost_count >= min(sum(counts), MIN_TOTAL_SHARE * total):
                    cost = float(loads[[hole.part for hole in pins[n].holes]] @ costs[n])
                    candidate = (lost_count / cost, step, row)
                    best = candidate if best is None else min(best, candidate)
        if best is None:
            return redundant_pins
        _, step, row = best
        n = numbers[step].pop(row)
        redundant_pins.append(pins[n])
        loads[[hole.part for hole in pins[n].holes]] -= costs[n]
        reached[step] = np.delete(reached[step], row, axis=0)


def _count_reached(rows: Bools) -> int:
    """Count the points that at least one pin reaches; `rows[k, n]` is true if pin k reaches point n."""
    return int(np.count_nonzero(rows.any(axis=0)))
