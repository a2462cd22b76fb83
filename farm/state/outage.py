"""Outages: several printers lost at once by one cause, the power, a hub, or the host. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from farm.model import Printer

WINDOW_S = 10.0
"""Most seconds between two losses with one cause."""
_LEAST_WALL_S = 1.0


def outage_window_s(scale: float) -> float:
    """Return the window in farm seconds, on a clock of `scale` of them in a wall second.

    It is no shorter than the time in which the host reports several losses one after the other.
    """
    return max(WINDOW_S, _LEAST_WALL_S * scale)


def lost_together(name: str, printers: Iterable[Printer], window_s: float = WINDOW_S) -> tuple[str, ...]:
    """Find the printers that were lost with this one, each within the window of another of them.

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
        Their names in order, with this one.
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
