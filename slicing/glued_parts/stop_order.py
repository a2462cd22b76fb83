"""Order of the stops of a way from a start to an end with the least distance, by a local search.

Stops are lines, which begin at one place and end at another. A stop may be reversible, like a line of infill.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slicing.checks.section import Floats

_MIN_GAIN_MM = 0.1  # minimum distance that a change of the order saves


@dataclass(frozen=True, slots=True)
class Stops:
    """Points where k stops begin (k, 2) and end (k, 2), and the start (2,) and the end (2,) of the way."""

    begins_mm: Floats
    ends_mm: Floats
    start_mm: Floats
    end_mm: Floats
    is_reversible: bool

    @property
    def count(self) -> int:
        """Number of the stops."""
        return len(self.begins_mm)

    def list_arrivals_mm(self) -> Floats:
        """List the points (2k + 2, 2) where the head arrives: at the start, the stops, the end.

        Stops are numbered from 1, and again from k + 1 for stops that are reversed.
        """
        return np.vstack([self.start_mm, self.begins_mm, self.ends_mm, self.end_mm])

    def list_departures_mm(self) -> Floats:
        """List the points (2k + 2, 2) where the head departs, with the same numbers."""
        return np.vstack([self.start_mm, self.ends_mm, self.begins_mm, self.end_mm])


def find_order(stops: Stops) -> list[int]:
    """Find an order of the stops that no move of a stop, and no reversal of a section, makes shorter.

    Parameters
    ----------
    stops
        Stops in their present order.

    Returns
    -------
    list of int
        The number of each stop from 1, plus the number of all stops if it is reversed; with 0 for the start
        of the way at the beginning, and the next free number for its end.
    """
    arrivals_mm, departures_mm = stops.list_arrivals_mm(), stops.list_departures_mm()
    distances_mm = np.hypot(*(departures_mm[:, None] - arrivals_mm).transpose(2, 0, 1)).tolist()
    order = [0, *range(1, stops.count + 1), 2 * stops.count + 1]
    while _move_a_stop(order, distances_mm, stops) or _reverse_a_section(order, distances_mm, stops):
        pass
    return order


def _reverse(stop: int, count: int) -> int:
    """Reverse one of a number of stops."""
    return stop - count if stop > count else stop + count


def _move_a_stop(order: list[int], distances_mm: list[list[float]], stops: Stops) -> bool:
    """Move one stop to its best other place, reversed if that is shorter; false if no move gains."""
    for index in range(1, len(order) - 1):
        before, stop, after = order[index - 1 : index + 2]
        saved_mm = (
            distances_mm[before][stop]
            + distances_mm[stop][after]
            - distances_mm[before][after]
            - _MIN_GAIN_MM
        )
        if saved_mm <= 0.0:
            continue
        rest = order[:index] + order[index + 1 :]
        choices = (stop, _reverse(stop, stops.count)) if stops.is_reversible else (stop,)
        added_mm, place, choice = min(
            (distances_mm[a][choice] + distances_mm[choice][b] - distances_mm[a][b], place, choice)
            for place, (a, b) in enumerate(pairwise(rest), 1)
            for choice in choices
        )
        if added_mm < saved_mm:
            order[:] = [*rest[:place], choice, *rest[place:]]
            return True
    return False


def _reverse_a_section(order: list[int], distances_mm: list[list[float]], stops: Stops) -> bool:
    """Reverse a section of the order with all its stops; false if none gains."""
    if not stops.is_reversible:
        return False
    turned = [order[0], *(_reverse(stop, stops.count) for stop in order[1:-1]), order[-1]]
    for first in range(1, len(order) - 1):
        before = distances_mm[order[first - 1]]
        for last in range(first + 1, len(order) - 1):
            after = order[last + 1]
            saved_mm = before[order[first]] + distances_mm[order[last]][after]
            added_mm = before[turned[last]] + distances_mm[turned[first]][after]
            if added_mm < saved_mm - _MIN_GAIN_MM:
                order[first : last + 1] = turned[first : last + 1][::-1]
                return True
    return False
