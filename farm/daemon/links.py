"""The links to the agents: starting and adopting them, sending instructions, hearing snapshots."""

from __future__ import annotations

import logging

from drivers import messages as m
from farm.model import AgentPrint, AgentSnapshot, FilamentState, Link, PrintState

log = logging.getLogger(__name__)

_PHASES = {
    m.PrintPhase.SPOOLED: PrintState.ASSIGNED,
    m.PrintPhase.CONNECTING: PrintState.HEATING,
    m.PrintPhase.HEATING: PrintState.HEATING,
    m.PrintPhase.PRINTING: PrintState.PRINTING,
    m.PrintPhase.ENDING: PrintState.ENDING,
    m.PrintPhase.DONE: PrintState.DONE,
    m.PrintPhase.FAILED: PrintState.FAILED,
    m.PrintPhase.CANCELLED: PrintState.CANCELLED,
}
_RETRY_S = 0.5  # wall seconds between attempts to reach an agent
_RESTARTS_PER_MINUTE = 6


def translate(said: m.Snapshot) -> AgentSnapshot:
    """An agent's words in the farm's."""
    attempt = None
    if said.print is not None:
        attempt = AgentPrint(
            print_id=said.print.print_id,
            state=_PHASES[said.print.phase],
            fault=said.print.fault,
            reason=said.print.reason,
            progress_s=said.print.progress_s,
            print_time_s=said.print.print_time_s,
            extruded=said.print.extruded,
            started_s=said.print.started_s,
            ended_s=said.print.ended_s,
            starved_s=said.print.starved_s,
        )
    return AgentSnapshot(
        printer=said.printer,
        link=Link(said.link),
        agent_pid=said.agent_pid,
        reason=said.reason,
        nozzle_c=said.nozzle.now_c if said.nozzle else None,
        bed_c=said.bed.now_c if said.bed else None,
        nozzle_target_c=said.nozzle.target_c if said.nozzle else None,
        bed_target_c=said.bed.target_c if said.bed else None,
        heaters_off=said.heaters_off,
        filament=FilamentState(said.filament),
        bed_clear=said.bed_clear,
        board_resets=said.board_resets,
        print=attempt,
    )
