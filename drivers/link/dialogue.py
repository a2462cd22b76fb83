"""A link on a port for whoever is no agent: an emergency stop, a person who plugs a printer in."""

from __future__ import annotations

import select
import time
from collections.abc import Iterator

from drivers.link.link import Link
from drivers.link.opening import Phase
from drivers.link.replies import Event
from drivers.ports import Port


def talk(
    port: Port, link: Link, patience_s: float, *, anew: bool = True, hail: bytes = b""
) -> Iterator[tuple[float, Event]]:
    """Move bytes between a port and a link.

    Parameters
    ----------
    port, link
        The two; the caller may `send` and `poll` on the link between two events.
    patience_s
        Wall seconds after which it ends.
    anew
        The port was just opened or reset; else the conversation goes on.
    hail
        See `Link.opened`.

    Yields
    ------
    (float, Event)
        The link's time (`time.monotonic`) and what was heard; ends also where the link gives up.

    Raises
    ------
    PortError
        The port went away.
    """
    now_s = time.monotonic()
    until_s = now_s + patience_s
    if anew:
        link.opened(now_s, hail)
    while now_s < until_s and link.phase is not Phase.DEAD:
        port.write(link.take())
        wait_s = min(until_s, link.deadline_s) - now_s
        select.select([port.fileno()], [], [], max(0.0, wait_s))
        data, now_s = port.read(), time.monotonic()
        for event in (*(link.receive(data, now_s) or ()), *link.tick(now_s)):
            yield now_s, event
