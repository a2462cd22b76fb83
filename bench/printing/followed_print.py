"""Print that a bench starts on an agent and follows to its end."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator
from pathlib import Path

from drivers import messages as m
from drivers.remote import AgentClient


def make_start_request(
    gcode: Path, print_time_s: float = 1.0, filament: m.Filament = m.Filament.PARKED
) -> m.StartPrint:
    """Make the request to print a file."""
    sha256 = hashlib.sha256(gcode.read_bytes()).hexdigest()
    return m.StartPrint(
        id=0, print_id="bench", gcode=str(gcode), sha256=sha256, print_time_s=print_time_s, filament=filament
    )


async def follow_print(
    client: AgentClient, request: m.StartPrint, *, clears_bed: bool = False
) -> AsyncIterator[m.PrintSnapshot]:
    """Start a print when the printer is ready; yield its snapshots until one is done.

    Parameters
    ----------
    client
        Connection to the agent.
    request
        Request to start the print.
    clears_bed
        Whether to report a clear bed first, which allows the agent to open a port that it does not know.

    Raises
    ------
    RuntimeError
        If the print is refused, fails, or the agent is disconnected.
    """
    is_clear_sent, is_start_sent = not clears_bed, False
    async for snapshot in client.receive_snapshots():
        if snapshot.link is m.LinkState.FAULT and not is_clear_sent:
            is_clear_sent = True
            await client.request(m.BedCleared(id=0))
        elif snapshot.link is m.LinkState.READY and not is_start_sent:
            is_start_sent = True
            reply = await client.request(request)
            if reply.error:
                raise RuntimeError(reply.error)
        if snapshot.print is None:
            continue
        yield snapshot.print
        if snapshot.print.phase.ended:
            if snapshot.print.phase is not m.PrintPhase.DONE:
                raise RuntimeError(f"the print ended {snapshot.print.phase}: {snapshot.print.reason}")
            return
    raise RuntimeError("the agent was disconnected")
