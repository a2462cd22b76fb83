"""Time factor of a printer: a weighted mean over its finished prints; the latest weighs most. Pure."""

from __future__ import annotations

MIN_TIME_FACTOR, MAX_TIME_FACTOR = 0.8, 1.25
"""Limits of the time factor of a healthy printer."""
MIN_LEARNED_S = 600.0
"""Minimum duration of a print that updates the factor, because the heat-up dominates in shorter prints."""
MAX_STARVED_SHARE = 0.01
"""Maximum share of a print's time that a simulated printer may have waited for its host."""
_IMPLAUSIBLE_RATIO = 2.0
_MAX_DIFFERENCE = 0.1  # larger differences of a print's ratio from the factor are reduced to this
_LATEST_WEIGHT = 0.25  # weight of the latest print in the weighted mean


def is_learnable(sliced_s: float, actual_s: float, starved_s: float = 0.0) -> bool:
    """Return whether the time of a print is usable for learning factors; see `update_time_factor`.

    Times of less than half or more than twice the sliced time are not usable, because the print was paused or
    the clock was set.
    """
    if sliced_s < MIN_LEARNED_S or actual_s <= 0.0 or starved_s > MAX_STARVED_SHARE * actual_s:
        return False
    return 1 / _IMPLAUSIBLE_RATIO < actual_s / sliced_s < _IMPLAUSIBLE_RATIO


def update_time_factor(factor: float, sliced_s: float, actual_s: float, starved_s: float = 0.0) -> float:
    """Compute a printer's factor after one more print, as an exponentially weighted mean with bounded steps.

    Parameters
    ----------
    factor
        The factor before this print; 1 for a new printer.
    sliced_s
        Seconds of the layers according to the slicer, not multiplied by a factor.
    actual_s
        Seconds that the layers took, without heat-up, start and end code.
    starved_s
        Seconds within `actual_s` in which a simulated printer waited for its host.

    Returns
    -------
    float
        New factor, between MIN_TIME_FACTOR and MAX_TIME_FACTOR, and at most 1/40 away from `factor`; `factor`
        itself if nothing can be learned from the print.
    """
    if not is_learnable(sliced_s, actual_s, starved_s):
        return factor
    difference = min(_MAX_DIFFERENCE, max(-_MAX_DIFFERENCE, actual_s / sliced_s - factor))
    return min(MAX_TIME_FACTOR, max(MIN_TIME_FACTOR, factor + _LATEST_WEIGHT * difference))
