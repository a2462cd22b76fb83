"""Adapter between the farm's records and the messages of the agent protocol. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from drivers import messages as m
from drivers.clock import Clock
from farm.model import AgentPrint, AgentSnapshot, FilamentState, Link, PrintState
from farm.state import Books
from farm.state import events as ev
from farm.text import flatten_text

_CLOCK_TOLERANCE_S = 60.0  # wall seconds; longer than any message takes
_MAX_TIME_S = datetime(9000, 1, 1, tzinfo=UTC).timestamp()
_OUTDATED_REASON = "its agent has an older version: replace it with `farm up --replace {}`"
_PRINT_STATES = {
    m.PrintPhase.SPOOLED: PrintState.ASSIGNED,
    m.PrintPhase.CONNECTING: PrintState.HEATING,
    m.PrintPhase.HEATING: PrintState.HEATING,
    m.PrintPhase.PRINTING: PrintState.PRINTING,
    m.PrintPhase.PAUSED: PrintState.PAUSED,
    m.PrintPhase.ENDING: PrintState.ENDING,
    m.PrintPhase.DONE: PrintState.DONE,
    m.PrintPhase.FAILED: PrintState.FAILED,
    m.PrintPhase.CANCELLED: PrintState.CANCELLED,
}


def compute_clock_offset_s(report: m.Snapshot, clock: Clock) -> float:
    """Return the farm's clock minus the agent's, in seconds, ignoring the delay of the report.

    A difference of up to a minute may be that delay, and counts as 0. Steps of the host's clock are added in
    any case: the farm's clock follows them, an agent's clock does not.
    """
    if not report.now_s:
        return 0.0
    offset_s = clock.now() - clock.host_shift_s - report.now_s
    differs = abs(clock.to_wall_duration_s(offset_s)) > _CLOCK_TOLERANCE_S
    return clock.host_shift_s + (offset_s if differs else 0.0)


def make_agent_request(instruction: ev.AnyInstruction, books: Books, files: Path) -> m.Request | None:
    """Return an instruction as a request to an agent; None if the instruction is not for an agent.

    Parameters
    ----------
    instruction
        The instruction, which contains the id of a print or the name of a printer.
    books
        The committed books.
    files
        Folder of the G-code files.
    """
    match instruction:
        case ev.SendStart():
            attempt = books.prints[instruction.print_id]
            plate = books.plates[attempt.plate]
            return m.StartPrint(
                id=0,
                print_id=attempt.id,
                gcode=str(files / plate.gcode),
                sha256=plate.sha256,
                print_time_s=plate.sliced_s,
                filament=m.Filament(books.get_printer(instruction.printer).filament),
                not_after_s=instruction.not_after_s,
                ends_by_s=instruction.ends_by_s,
            )
        case ev.SendEndBy():
            return m.EndPrintBy(id=0, print_id=instruction.print_id, ends_by_s=instruction.ends_by_s)
        case ev.SendCancel():
            return m.CancelPrint(id=0, print_id=instruction.print_id, reason=instruction.reason)
        case ev.SendPause():
            request_type = m.PausePrint if instruction.pause else m.ResumePrint
            return request_type(id=0, print_id=instruction.print_id)
        case ev.SendForget():
            return m.ForgetPrint(id=0, print_id=instruction.print_id)
        case ev.SendCleared():
            filament = m.Filament(instruction.filament) if instruction.filament else None
            return m.BedCleared(id=0, filament=filament)
        case ev.StopPlanning() | ev.LinkFiles():
            return None


def to_agent_clock(request: m.Request, clock_offset_s: float, latest_start_s: float) -> m.Request:
    """Convert the times in a request to the agent's clock.

    Parameters
    ----------
    request
        The request, with times on the farm's clock.
    clock_offset_s
        The farm's clock minus the agent's.
    latest_start_s
        Time on the farm's clock after which the agent must refuse to start the print.
    """
    match request:
        case m.StartPrint(not_after_s=not_after_s, ends_by_s=ends_by_s):
            latest_start_s = latest_start_s if not_after_s is None else min(latest_start_s, not_after_s)
            times_s = {"not_after_s": latest_start_s - clock_offset_s}
        case m.EndPrintBy(ends_by_s=ends_by_s):
            times_s = {}
        case m.ListPrints(since_s=since_s):
            return request.model_copy(update={"since_s": since_s - clock_offset_s})
        case _:
            return request
    if ends_by_s is not None:
        times_s["ends_by_s"] = ends_by_s - clock_offset_s
    return request.model_copy(update=times_s)


def to_farm_snapshot(
    report: m.Snapshot, clock: Clock, printer: str, is_simulated: bool, is_bed_cleared: bool
) -> AgentSnapshot:
    """Convert an agent's snapshot to the farm's record, with times on the farm's clock.

    Fields that the agent cannot measure are left out.

    Parameters
    ----------
    report
        The agent's snapshot.
    clock
        The farm's clock.
    printer
        The printer of this connection; the name in the snapshot is ignored.
    is_simulated
        True if the printer is an emulator: only emulators know the state of their bed.
    is_bed_cleared
        True if a person has cleared the bed, and the agent does not know this yet: the alarm and the
        unknown bed in its snapshot are then out of date, and are left out.
    """
    is_outdated = report.protocol < m.StartPrint.min_protocol and report.print is None
    is_filament_unreported = (
        report.protocol < m.Snapshot.filament_protocol and report.bed_unknown_reason is not None
    )
    return AgentSnapshot(
        **report.dump_readings(),
        printer=printer,
        link=Link.FAULT if is_outdated else Link(report.link),
        agent_pid=report.agent_pid,
        reason=_OUTDATED_REASON.format(printer) if is_outdated else _flatten_reason(report.reason),
        nozzle_c=report.nozzle.now_c if report.nozzle else None,
        bed_c=report.bed.now_c if report.bed else None,
        nozzle_target_c=report.nozzle.target_c if report.nozzle else None,
        bed_target_c=report.bed.target_c if report.bed else None,
        filament=FilamentState.UNKNOWN if is_filament_unreported else FilamentState(report.filament),
        bed_clear=report.bed_clear if is_simulated else None,
        bed_unknown_reason=None if is_bed_cleared else _flatten_reason(report.bed_unknown_reason),
        alarm=None if is_bed_cleared else _flatten_reason(report.alarm),
        reset_verified=report.reset_verified,
        outdated=is_outdated,
        print=None
        if report.print is None
        else to_farm_print(report.print, compute_clock_offset_s(report, clock)),
    )


def to_farm_print(report: m.PrintSnapshot, clock_offset_s: float) -> AgentPrint:
    """Convert an agent's report on a print; `clock_offset_s` is the farm's clock minus the agent's.

    Times are limited to those that datetime can represent, and negative durations become 0, because both are
    displayed.
    """

    def convert(at_s: float | None) -> float | None:
        return None if at_s is None else _convert_time_s(at_s, clock_offset_s)

    return AgentPrint(
        **report.dump_readings(),
        print_id=report.print_id,
        state=_PRINT_STATES[report.phase],
        fault=report.fault,
        reason=_flatten_reason(report.reason),
        progress_s=max(0.0, report.progress_s),
        print_time_s=max(0.0, report.print_time_s),
        extruded=report.extruded,
        started_s=convert(report.started_s),
        ended_s=convert(report.ended_s),
        starved_s=max(0.0, report.starved_s),
        layers=report.layers,
        pause_ends_s=convert(report.pause_ends_s),
        ends_by_s=convert(report.ends_by_s),
        sha256=report.sha256,
    )


def to_farm_lines(lines: Sequence[m.WireLine], clock_offset_s: float) -> list[m.WireLine]:
    """Convert lines that an agent recorded; `clock_offset_s` is the farm's clock minus the agent's.

    Times are limited to those that datetime can represent, because they are displayed.
    """
    return [line.model_copy(update={"at_s": _convert_time_s(line.at_s, clock_offset_s)}) for line in lines]


def _convert_time_s(at_s: float, clock_offset_s: float) -> float:
    """Convert an agent's time to the farm's clock, limited to the range of datetime."""
    return min(max(0.0, at_s + clock_offset_s), _MAX_TIME_S)


def _flatten_reason(text: str | None) -> str | None:
    """Return a text without control characters, because it may contain noise from a serial line."""
    return None if text is None else flatten_text(text)
