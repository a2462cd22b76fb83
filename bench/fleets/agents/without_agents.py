"""Stand-ins for the agents of a controller: effects that do nothing, and reports of printers."""

from __future__ import annotations

from farm.model import AgentPrint, AgentSnapshot, FilamentState, Link, Print, PrintState


class NoEffects:
    """Performer of effects for a farm without agents."""

    def perform(self, effect: object, books: object) -> None:
        """Do nothing."""


def make_snapshot(
    printer: str, attempt: Print | None = None, progress_s: float = 0.0, print_time_s: float = 9000.0
) -> AgentSnapshot:
    """Make the report of a printer that is ready, or that prints with varying temperatures."""
    if attempt is None:
        return AgentSnapshot(
            printer=printer, link=Link.READY, agent_pid=9, filament=FilamentState.PARKED, bed_clear=True
        )
    started_s = attempt.assigned_s if attempt.started_s is None else attempt.started_s
    agent_print = AgentPrint(
        print_id=attempt.id, state=PrintState.PRINTING, fault=None, reason=None, progress_s=progress_s,
        print_time_s=print_time_s, extruded=True, started_s=started_s, ended_s=None,
        layer=80, layers=500,
    )  # fmt: skip
    return AgentSnapshot(
        printer=printer, link=Link.BUSY, agent_pid=9, nozzle_c=200.0 + progress_s % 3, bed_c=60.0,
        nozzle_target_c=200.0, bed_target_c=60.0, filament=FilamentState.AT_NOZZLE, print=agent_print,
    )  # fmt: skip
