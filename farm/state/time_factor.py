"""How much slower than the slicer says a printer prints, learned from the prints that it ended. Pure."""

from __future__ import annotations

LEAST, MOST = 0.8, 1.25
"""What a printer that works can differ; beyond it something else is wrong."""
SHORTEST_S = 600.0
"""Shorter prints say more of the heat-up than of the layers."""
MOST_STARVED = 0.01
"""A simulated printer that waited for its host for a larger share did not print at its own speed."""
_WILD = 2.0
_STEP = 0.1
_WEIGHT = 0.25


def update_time_factor(factor: float, expected_s: float, reached_s: float, starved_s: float = 0.0) -> float:
    """A printer's factor after one more print: an exponentially weighted mean of bounded steps.

    Parameters
    ----------
    factor
        What was learned so far; 1 at first.
    expected_s
        What the slicer says that the layers take, without any factor.
    reached_s
        What they took, without heat-up, start and end code.
    starved_s
        How long of that a simulated printer waited for its host.

    Returns
    -------
    float
        Between LEAST and MOST, and at most a fortieth away from `factor`. A print that took twice or half as
        long was paused, or its clock was set: it teaches nothing.
    """
    if expected_s < SHORTEST_S or reached_s <= 0.0 or starved_s > MOST_STARVED * reached_s:
        return factor
    ratio = reached_s / expected_s
    if not 1 / _WILD < ratio < _WILD:
        return factor
    step = min(_STEP, max(-_STEP, ratio - factor))
    return min(MOST, max(LEAST, factor + _WEIGHT * step))
