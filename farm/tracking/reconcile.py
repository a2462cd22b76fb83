"""Bringing the books in line with what an agent says. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from farm.model import AgentSnapshot, Bed, FilamentState, Link, Print, Printer, PrintState
from farm.tracking import events as ev

LOST_FAULT = "print_lost"
"""The fault of a print that its agent knows nothing of any more."""


def reconcile(attempt: Print, snapshot: AgentSnapshot, now_s: float) -> Iterator[ev.AnyEvent]:
    """What has happened to an open print, by its agent's word.

    Parameters
    ----------
    attempt
        An open print of the books, on the printer of the snapshot.
    snapshot
        The agent's latest word. An agent that has just been started has read its journal before it speaks.
    now_s
        Farm time, for what has no time of its own.
    """
    said = snapshot.print
    if said is None or said.print_id != attempt.id:
        if snapshot.link is Link.STARTING:
            return
        if attempt.state is PrintState.ASSIGNED and attempt.cancel_asked is None:
            return  # it has not been told yet: `owed` tells it again
        known = attempt.state is not PrintState.ASSIGNED
        yield ev.PrintEnded(
            at_s=now_s,
            print_id=attempt.id,
            state=PrintState.FAILED if known else PrintState.CANCELLED,
            fault=LOST_FAULT if known else None,
            reason="its agent has no record of this print" if known else attempt.cancel_asked,
            started_s=None,
            ended_s=now_s,
            extruded=False,
            filament=snapshot.filament,
        )
    elif said.state.ended:
        yield ev.PrintEnded(
            at_s=now_s,
            print_id=attempt.id,
            state=said.state,
            fault=said.fault,
            reason=said.reason,
            started_s=said.started_s,
            ended_s=said.ended_s if said.ended_s is not None else now_s,
            extruded=said.extruded,
            filament=snapshot.filament,
            starved_s=said.starved_s,
        )
    elif said.state is not attempt.state or said.extruded != attempt.extruded:
        yield ev.PrintProgressed(
            at_s=now_s,
            print_id=attempt.id,
            state=said.state,
            started_s=said.started_s,
            extruded=said.extruded,
        )


def owed(attempt: Print, snapshot: AgentSnapshot) -> Iterator[ev.AnyInstruction]:
    """What the agent of an open print has to be told (again): every message is idempotent by print id."""
    said = snapshot.print
    if said is not None and said.print_id == attempt.id:
        if attempt.cancel_asked is not None and not said.state.ended:
            reason = attempt.cancel_asked
            yield ev.SendCancel(print_id=attempt.id, printer=attempt.printer, reason=reason)
    elif (
        attempt.state is PrintState.ASSIGNED and attempt.cancel_asked is None and snapshot.link is Link.READY
    ):
        yield ev.SendStart(print_id=attempt.id, printer=attempt.printer)


def observe(
    printer: Printer, before: AgentSnapshot | None, snapshot: AgentSnapshot, now_s: float
) -> Iterator[ev.AnyEvent]:
    """What an idle printer's snapshot says of its bed and filament.

    An emulator is asked where the books do not know. A board reset that the agent did not cause makes both
    unknown: somebody was at the printer, or its power went.
    """
    reset = (
        before is not None
        and before.agent_pid == snapshot.agent_pid
        and snapshot.board_resets > before.board_resets
    )
    if reset:
        reason = "its board was reset, and not by the farm: look whether its bed is clear"
        yield ev.PrinterDoubted(at_s=now_s, printer=printer.name, reason=reason)
        return
    if snapshot.link is not Link.READY:
        return
    asks_bed = printer.bed is Bed.UNKNOWN and snapshot.bed_clear is not None
    asks_filament = (
        printer.filament is FilamentState.UNKNOWN and snapshot.filament is not FilamentState.UNKNOWN
    )
    if asks_bed or asks_filament:
        bed = printer.bed
        if snapshot.bed_clear is not None:
            bed = Bed.CLEAR if snapshot.bed_clear else Bed.NOT_CLEAR
        yield ev.PrinterSeen(at_s=now_s, printer=printer.name, bed=bed, filament=snapshot.filament)
