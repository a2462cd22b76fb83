"""Outages: several printers lost at the same time by a common cause (power, hub or host). Pure."""

from __future__ import annotations

from collections.abc import Iterable

from farm.model import HostLoss, Printer

OUTAGE_WINDOW_S = 10.0
"""Maximum time between two losses with a common cause, in farm seconds."""
_MIN_WINDOW_WALL_S = 1.0


def compute_outage_window_s(scale: float) -> float:
    """Compute the outage window in farm seconds, for a clock with `scale` farm seconds per wall second.

    The window is at least the time in which the host reports several losses one after another.
    """
    return max(OUTAGE_WINDOW_S, _MIN_WINDOW_WALL_S * scale)


def find_printers_lost_together(
    name: str, printers: Iterable[Printer], window_s: float = OUTAGE_WINDOW_S
) -> tuple[str, ...]:
    """Find the printers lost together with one printer: each within `window_s` of another one of them.

    Parameters
    ----------
    name
        A printer that has just been lost.
    printers
        The fleet, with the time at which each printer was last lost.
    window_s
        Maximum time between two losses with a common cause, in farm seconds.

    Returns
    -------
    tuple of str
        Names of these printers in alphabetical order, including `name`.
    """
    lost_at_s = {
        printer.name: printer.disconnected_at_s
        for printer in printers
        if printer.disconnected_at_s is not None
    }
    group, unvisited = {name}, [name]
    while unvisited:
        at_s = lost_at_s[unvisited.pop()]
        neighbours = {n for n, lost_s in lost_at_s.items() if abs(lost_s - at_s) <= window_s} - group
        group |= neighbours
        unvisited += neighbours
    return tuple(sorted(group))


def find_first_host_loss_s(
    at_s: float, losses: Iterable[HostLoss], window_s: float = OUTAGE_WINDOW_S
) -> float:
    """Find when the first of several host losses with a common cause occurred.

    Parameters
    ----------
    at_s
        Time of the latest loss, seconds since the epoch.
    losses
        Earlier losses.
    window_s
        Maximum time between two losses with a common cause, in farm seconds.

    Returns
    -------
    float
        Time of the first loss, seconds since the epoch; `at_s` if the window contains no earlier loss.
    """
    # A loss at the end of the window is too late for the notice of the first loss, which is sent just then.
    return min((loss.at_s for loss in losses if 0.0 <= at_s - loss.at_s < window_s), default=at_s)
