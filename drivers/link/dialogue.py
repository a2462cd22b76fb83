"""Exchange on a port outside an agent, for an emergency stop or to verify a reset."""

from __future__ import annotations

import select
import time
from collections.abc import Iterator

from drivers.link.link import Link
from drivers.link.opening import Phase
from drivers.link.replies import Event
from drivers.ports import Port


def exchange(
    port: Port, link: Link, limit_s: float, *, is_new: bool = True, unconfirmed_commands: bytes = b""
) -> Iterator[tuple[float, Event]]:
    """Pass bytes between a port and a link, and yield the events.

    Parameters
    ----------
    port, link
        The port, and the link behind it. The caller may `send` and `poll` on the link between two events.
    limit_s
        Wall seconds after which the exchange ends.
    is_new
        True if the port was just opened or reset; otherwise the link continues from its current state.
    unconfirmed_commands
        See `Link.on_opened`.

    Yields
    ------
    (float, Event)
        Time (`time.monotonic`) and event. The events end early if the link gives up.

    Raises
    ------
    PortError
        The port was disconnected.
    """
    now_s = time.monotonic()
    deadline_s = now_s + limit_s
    if is_new:
        link.on_opened(now_s, unconfirmed_commands)
    while now_s < deadline_s and link.phase is not Phase.DEAD:
        port.write(link.take())
        wait_s = min(deadline_s, link.deadline_s) - now_s
        select.select([port.fileno()], [], [], max(0.0, wait_s))
        data, now_s = port.read(), time.monotonic()
        for event in (*link.receive(data, now_s), *link.tick(now_s)):
            yield now_s, event
