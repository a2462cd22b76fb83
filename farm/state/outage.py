"""Outages: several printers lost at the same time by a common cause (power, hub or host). Pure."""

from __future__ import annotations

from collections.abc import Iterable

from farm.model import HostLoss, Printer

OUTAGE_WINDOW_S = 10.0
"""Maximum time between two losses with a common cause, in seconds."""
_MIN_WINDOW_WALL_S = 1.0


def compute_outage_window_s(scale: float) -> float:
    """Return the window in farm seconds, for a clock of `scale` farm seconds per wall second.

    It is at least the time that the host takes to report several losses one after another.
    """
    return max(OUTAGE_WINDOW_S, _MIN_WINDOW_WALL_S * scale)


def find_common_losses(
    name: str, printers: Iterable[Printer], window_s: float = OUTAGE_WINDOW_S
) -> tuple[str, ...]:
    """Find the printers that were lost together with a printer, each within the window of another.

    Parameters
    ----------
    name
        A printer that has just been lost.
    printers
        The fleet, with the time of each last loss.
    window_s
        Farm seconds.

    Returns
    -------
    tuple of str
        Their names in order, including `name`.
    """
    lost_at_s = {
        printer.name: printer.disconnected_at_s
        for printer in printers
        if printer.disconnected_at_s is not None
    }
    group, todo = {name}, [name]
    while todo:
        at_s = lost_at_s[todo.pop()]
        neighbours = {n for n, lost_s in lost_at_s.items() if abs(lost_s - at_s) <= window_s} - group
        group |= neighbours
        todo += neighbours
    return tuple(sorted(group))


def find_common_host_loss_s(
    at_s: float, losses: Iterable[HostLoss], window_s: float = OUTAGE_WINDOW_S
) -> float:
    """Find the time of the first loss among those of hosts that were lost together.

    Parameters
    ----------
    at_s
        Time of the latest loss, seconds since the epoch.
    losses
        Earlier losses.
    window_s
        Farm seconds.

    Returns
    -------
    float
        Time of the first loss, seconds since the epoch; `at_s` without an earlier one in the window.
    """
    # The notice of the first loss is sent at the end of the window and cannot include a loss at that moment.
    return min((loss.at_s for loss in losses if 0.0 <= at_s - loss.at_s < window_s), default=at_s)
