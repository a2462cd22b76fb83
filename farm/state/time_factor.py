"""Time factor of a printer: its layers' time over the slicer's, learned from its prints. Pure."""

from __future__ import annotations

LEAST, MOST = 0.8, 1.25
"""Limits of the factor of a printer that works; beyond them something else is wrong."""
SHORTEST_S = 600.0
"""Least duration of a print to learn from: shorter ones say more of the heat-up than of the layers."""
MOST_STARVED = 0.01
"""Largest share of a print in which a simulated printer may have waited for its host."""
_WILD = 2.0
_STEP = 0.1
_WEIGHT = 0.25


def update_time_factor(factor: float, expected_s: float, reached_s: float, starved_s: float = 0.0) -> float:
    """Update a printer's factor by one more print: an exponentially weighted mean of bounded steps.

    Parameters
    ----------
    factor
        As learned so far; 1 at first.
    expected_s
        Seconds that the layers take by the slicer, without any factor.
    reached_s
        Seconds that they took, without heat-up, start and end code.
    starved_s
        Seconds of that in which a simulated printer waited for its host.

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
