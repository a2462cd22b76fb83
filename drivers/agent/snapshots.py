"""Snapshots of an agent, made from its board and its journal."""

from __future__ import annotations

import os

from drivers.agent.board import NO_RESET_REASON, Board
from drivers.agent.idle_watch import SD_PRINT_REASON
from drivers.agent.recorder import Recorder
from drivers.link import Phase
from drivers.messages import PROTOCOL, Filament, Heater, LinkState, PrintSnapshot, Snapshot
from drivers.records import StartFile

UNVERIFIED_REASON = (
    "it is not verified that DTR resets its board: this is tested when a person confirms that it is idle"
)
_POSITION_TOLERANCE_MM = 1.0


def describe_link(board: Board, journal_error: str | None) -> tuple[LinkState, str | None]:
    """Return the state of the link, and the reason for it as a user-facing sentence.

    Parameters
    ----------
    board
        The board.
    journal_error
        See `Recorder.journal_error`.
    """
    if board.needs_idle_confirmation:
        return LinkState.FAULT, board.absent_reason
    if board.session is not None:
        return LinkState.BUSY, board.absent_reason or journal_error
    if board.absent_reason is not None:
        return LinkState.ABSENT, board.absent_reason
    if board.is_verifying_reset:
        return LinkState.CONNECTING, None
    if board.state.attention_reason is not None:
        return LinkState.FAULT, board.state.attention_reason
    if board.idle_watch.is_printing_from_card:
        return LinkState.FAULT, SD_PRINT_REASON
    if not (board.reset_verified or board.reset_failed):
        return LinkState.FAULT, UNVERIFIED_REASON
    state = LinkState.READY if board.link.phase is Phase.LIVE else LinkState.CONNECTING
    return state, NO_RESET_REASON if board.reset_failed else None


def make_snapshot(start: StartFile, recorder: Recorder, now_s: float) -> Snapshot:
    """Make a snapshot for the daemon.

    Parameters
    ----------
    start
        The agent's start file.
    recorder
        The recorder, with board and journal.
    now_s
        Farm time in seconds.
    """
    board, journal_state = recorder.board, recorder.journal.state
    session, report, emulator = board.session, board.report, board.emulator.read_status()
    link, reason = describe_link(board, recorder.journal_error)
    if session is not None:
        filament = session.context.filament
    else:
        filament = journal_state.filament if board.idle_watch.filament_watch.is_certain else Filament.UNKNOWN
        if filament is Filament.UNKNOWN and emulator is not None and board.state.bed_unknown_reason is None:
            filament = _classify_filament(emulator.filament_end_mm, board.profile.park_retraction_mm)
    heaters_off = report is not None and report.targets_off
    return Snapshot(
        protocol=PROTOCOL,
        printer=start.printer,
        agent_pid=os.getpid(),
        now_s=now_s,
        model=board.profile.model,
        port=start.port,
        link=link,
        reason=reason,
        nozzle=Heater(now_c=report.nozzle_c, target_c=report.nozzle_target_c) if report else None,
        bed=Heater(now_c=report.bed_c, target_c=report.bed_target_c) if report else None,
        heaters_off=heaters_off if session is None else session.context.heaters_off,
        filament=filament,
        bed_clear=emulator.bed_clear if emulator is not None else None,
        starved_s=emulator.starvation_s if emulator is not None else 0.0,
        board_resets=board.reset_count,
        bed_unknown_reason=board.state.bed_unknown_reason,
        alarm=recorder.alarms.message,
        reset_verified=board.reset_verified,
        print=describe_print(recorder),
    )


def describe_print(recorder: Recorder) -> PrintSnapshot | None:
    """Return the current state of the open print, or the last print unless it was forgotten."""
    last_print, session = recorder.journal.state.print, recorder.board.session
    if last_print is None or session is None:
        return last_print
    return recorder.describe_print(last_print, session.context)


def list_prints(recorder: Recorder, since_s: float) -> tuple[PrintSnapshot, ...]:
    """List all prints that had not ended at `since_s` of the farm's clock, with the open one last."""
    journal_state, open_print = recorder.journal.state, describe_print(recorder)
    prints = [
        record
        for record in journal_state.recent_prints
        if record.ended_s is None or record.ended_s >= since_s
    ]
    if open_print is not None and open_print.print_id not in journal_state.ended_print_ids:
        prints.append(open_print)
    return tuple(prints)


def _classify_filament(end_mm: float, park_retraction_mm: float) -> Filament:
    """Classify the position of the filament's tip in an emulator."""
    if abs(end_mm + park_retraction_mm) <= _POSITION_TOLERANCE_MM:
        return Filament.PARKED
    return Filament.AT_NOZZLE if abs(end_mm) <= _POSITION_TOLERANCE_MM else Filament.UNKNOWN
