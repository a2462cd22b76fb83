"""Outages: several printers lost at once by one cause, the power, a hub, or the host. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from farm.model import Printer

WINDOW_S = 10.0
"""Seconds between two losses that have one cause."""
_LEAST_WALL_S = 1.0


def outage_window_s(scale: float) -> float:
    """Return the window in farm seconds, on a clock of `scale` of them in a wall second.

    The host tells of several losses one after the other: no shorter than that takes it.
    """
    return max(WINDOW_S, _LEAST_WALL_S * scale)


def lost_together(name: str, printers: Iterable[Printer], window_s: float = WINDOW_S) -> tuple[str, ...]:
    """Find the printers that were lost with this one, each within the window of another of them.

    Parameters
    ----------
    name
        A printer that has just been lost.
    printers
        The fleet, with when each was lost last.
    window_s
        Farm seconds.

    Returns
    -------
    tuple of str
        In the order of the names, this one among them.
    """
    when = {
        printer.name: printer.disconnected_at_s
        for printer in printers
        if printer.disconnected_at_s is not None
    }
    group, todo = {name}, [name]
    while todo:
        at_s = when[todo.pop()]
        near = {other for other, s in when.items() if abs(s - at_s) <= window_s} - group
        group |= near
        todo += near
    return tuple(sorted(group))
