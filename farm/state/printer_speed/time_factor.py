"""Time factor of a printer: an average over its finished prints, the latest with the largest weight."""

from __future__ import annotations

MIN_TIME_FACTOR, MAX_TIME_FACTOR = 0.8, 1.25
"""Limits of the time factor of a healthy printer."""
MIN_LEARNED_S = 600.0
"""Least duration of a print that updates the factor: in shorter ones the heat-up dominates."""
MAX_STARVED_SHARE = 0.01
"""Largest share of a print for which a simulated printer may have waited for its host."""
_IMPLAUSIBLE_RATIO = 2.0
_STEP = 0.1
_WEIGHT = 0.25


def shows_speed(expected_s: float, reached_s: float, starved_s: float = 0.0) -> bool:
    """Return whether a print's time shows the speed of its printer; see `update_time_factor`.

    It does not if it is less than half or more than twice the expected time: the print was paused, or the
    clock was set.
    """
    if expected_s < MIN_LEARNED_S or reached_s <= 0.0 or starved_s > MAX_STARVED_SHARE * reached_s:
        return False
    return 1 / _IMPLAUSIBLE_RATIO < reached_s / expected_s < _IMPLAUSIBLE_RATIO


def update_time_factor(factor: float, expected_s: float, reached_s: float, starved_s: float = 0.0) -> float:
    """Update a printer's factor by one print: an exponentially weighted mean of bounded steps.

    Parameters
    ----------
    factor
        The factor so far; 1 at first.
    expected_s
        Seconds of the layers according to the slicer, without a factor.
    reached_s
        Seconds that the layers took, without heat-up, start and end code.
    starved_s
        Part of `reached_s` for which a simulated printer waited for its host.

    Returns
    -------
    float
        New factor, between MIN_TIME_FACTOR and MAX_TIME_FACTOR, and at most 1/40 away from `factor`; `factor`
        itself if the print does not show the speed.
    """
    if not shows_speed(expected_s, reached_s, starved_s):
        return factor
    step = min(_STEP, max(-_STEP, reached_s / expected_s - factor))
    return min(MAX_TIME_FACTOR, max(MIN_TIME_FACTOR, factor + _WEIGHT * step))
