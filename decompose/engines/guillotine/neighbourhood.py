"""Neighbourhood search: a partition made better where it is slowest, not bound to guillotine cuts.

The slowest box and a few about it are cut anew between all the others (`window`), with no more
parts, so that the slowest of them ends sooner. Their union need not be a box. A move of one face, a slab that
goes from one box to the next, two boxes merged and split elsewhere: all are such windows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from decompose.engines.guillotine.window import Window
from decompose.grid import Box, BoxTables, box_index
from decompose.problem import Effort, Work

MAX_WINDOWS = 200  # that are solved in one search
MAX_TOGETHER = 5  # boxes in a window
MAX_ABOUT = 10  # neighbours of a box that are looked at, the quickest first
MAX_EACH = 24  # windows about one box, the one with the most slack first
MAX_BOXES = 150_000  # of all sizes in a window: larger ones take too long
WORTH = 0.999  # a window has to end sooner than this share of its time


def improve_locally(
    boxes: BoxTables,
    chosen: Sequence[Box],
    printers: int,
    most_windows: int = MAX_WINDOWS,
    effort: Effort | None = None,
) -> list[Box]:
    """Partition whose times, the longest first, are lexicographically less, or the same partition.

    Parameters
    ----------
    boxes
        The tables.
    chosen
        A partition: trimmed boxes that do not overlap and cover every needed cell.
    printers
        The greatest number of pieces; at least as many as there are.
    effort
        Where the work is booked, and what may be done.
    """
    effort = effort or Effort()
    parts = list(chosen)
    failed: set[frozenset[Box]] = set()
    groups = _groups(boxes, parts)
    for _ in range(most_windows):
        group = next((g for g in groups if g not in failed), None)
        if group is None or effort.is_spent():
            break
        spare = printers - _pieces(boxes, parts)
        others = [box for box in parts if box not in group]
        times = [_seconds(boxes, box) for box in group]
        window = Window(boxes, group, others)
        found = window.solve(_pieces(boxes, group) + spare, WORTH * max(times), 0.5 * float(np.mean(times)))
        effort.book(Work.BOX_PRICED, window.boxes)
        effort.book(Work.SUM, window.sums)
        if found is None:
            failed.add(group)
        else:
            parts = others + found
            groups = _groups(boxes, parts)
    return parts


def sorted_times_s(boxes: BoxTables, chosen: Sequence[Box]) -> list[float]:
    """Times of a partition, the longest first; lexicographically less is better."""
    return sorted((_seconds(boxes, box) for box in chosen), reverse=True)


def _seconds(boxes: BoxTables, box: Box) -> float:
    return float(boxes.seconds[box_index(box, boxes.shape)])


def _pieces(boxes: BoxTables, chosen: Iterator[Box] | Sequence[Box] | frozenset[Box]) -> int:
    return sum(int(boxes.pieces[box_index(box, boxes.shape)]) for box in chosen)


def _groups(boxes: BoxTables, parts: list[Box]) -> Iterator[frozenset[Box]]:
    """Windows about each part, the slowest part first; of its windows the one with the most slack first."""
    ends = np.array(parts)
    seconds = np.array([_seconds(boxes, box) for box in parts])
    for centre in np.lexsort((*ends.T, -seconds)):
        lo, hi = ends[centre, :3], ends[centre, 3:]
        gap = np.maximum(ends[:, :3] - hi, lo - ends[:, 3:]).max(axis=1)
        about = [i for i in np.flatnonzero(gap <= 0).tolist() if i != centre and seconds[i] < seconds[centre]]
        about = sorted(about, key=lambda i: seconds[i])[:MAX_ABOUT]
        found = []
        for more in range(MAX_TOGETHER):
            for rest in combinations(about, more):
                group = [int(centre), *rest]
                sides = ends[group, 3:].max(axis=0) - ends[group, :3].min(axis=0)
                if np.prod(sides * (sides + 1) // 2) <= MAX_BOXES:
                    found.append((float(seconds[group].mean()), sorted(parts[i] for i in group)))
        for _, window in sorted(found)[:MAX_EACH]:
            yield frozenset(window)
