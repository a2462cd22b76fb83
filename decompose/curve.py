"""The curve of makespan over the number of printers, and the number of printers that is worth its work.

One search serves all numbers: the fewest parts at a time T say of every number whether it reaches T, so that
each solve narrows down many of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decompose.boxes import Boxes
from decompose.guillotine import Partitioner

CLOSE = 0.005  # share of a makespan to which it is known
AT_ONCE = 2  # solves side by side; their number is fixed, so that the answer is
CLEAR_S = 120.0
"""A person's time to take a part off a bed and to make the bed clear, an estimate."""
ASSEMBLE_S = 216.0
"""A person's time to clean and glue a part: 3.6 min, as the literature on such models has it."""


@dataclass(frozen=True, slots=True)
class Point:
    """The least makespan in seconds that a search found for a number of printers."""

    printers: int
    makespan_s: float


class _Narrowing:
    """What is known of each number of printers, from none to the most."""

    def __init__(self, boxes: Boxes, most: int) -> None:
        self._boxes = boxes
        self.reached_s = np.full(most + 1, np.inf)
        self.refuted_s = np.zeros(most + 1)

    def solve(self, limit_s: float) -> tuple[float, int, float]:
        """A limit, the parts that it needs, and the time of the longest of them."""
        solver = Partitioner(self._boxes)
        parts = solver.parts(limit_s)
        return limit_s, parts, solver.longest_s() if parts < len(self.reached_s) else math.inf

    def learn(self, limit_s: float, parts: int, longest_s: float) -> None:
        """What a solve says of every number."""
        self.reached_s[parts:] = np.minimum(self.reached_s[parts:], longest_s)
        self.refuted_s[:parts] = np.maximum(self.refuted_s[:parts], limit_s)

    def next_limits(self) -> list[float]:
        """Limits that are worth a solve: in the widest gaps; none where all are narrow."""
        known = np.isfinite(self.reached_s)
        gaps: dict[tuple[float, float], float] = {}
        for low, high in zip(self.refuted_s[known].tolist(), self.reached_s[known].tolist(), strict=True):
            if high - low > CLOSE * high:
                gaps[low, high] = (high - low) / high
        widest = sorted(gaps, key=lambda gap: (-gaps[gap], gap))[:AT_ONCE]
        return [(low + high) / 2.0 for low, high in widest]


def curve(boxes: Boxes, most: int, executor: Executor | None = None) -> tuple[Point, ...]:
    """The least makespan of guillotine partitions for each number of printers up to `most`.

    Each is known to `CLOSE`; numbers that are too few for any partition are left out.
    """
    finite: npt.NDArray[np.float32] = boxes.seconds[np.isfinite(boxes.seconds)]
    if not len(finite):
        return ()
    narrowing = _Narrowing(boxes, most)
    limits = [float(finite.max())]
    run = map if executor is None else executor.map
    while limits:
        for found in run(narrowing.solve, limits):
            narrowing.learn(*found)
        limits = narrowing.next_limits()
    return tuple(Point(n, s) for n, s in enumerate(narrowing.reached_s.tolist()) if n and math.isfinite(s))


def knee(points: Sequence[Point], clear_s: float = CLEAR_S, assemble_s: float = ASSEMBLE_S) -> Point:
    """The point where printing and what a person does after it, part by part, take least together."""
    return min(points, key=lambda p: (p.makespan_s + p.printers * (clear_s + assemble_s), p.printers))


def in_time(points: Sequence[Point], within_s: float) -> Point:
    """The fewest printers that are done within so many seconds; where none are, the soonest."""
    enough = [point for point in points if point.makespan_s <= within_s]
    if enough:
        return min(enough, key=lambda point: point.printers)
    return min(points, key=lambda point: (point.makespan_s, point.printers))
