"""Recorder that writes a board's changes to the journal before the board continues."""

from __future__ import annotations

import logging

from drivers.agent.alarm import Alarms
from drivers.agent.board import NOT_WATCHED_REASON, Board
from drivers.agent.idle_watch import FilamentWatch
from drivers.clock import Clock
from drivers.errors import Fault, JournalError
from drivers.gcode import Program
from drivers.messages import Filament, PrintPhase, PrintSnapshot
from drivers.records import ESTOP_REASON, Journal, StartFile
from drivers.session import Session, SessionContext

log = logging.getLogger(__name__)

_ATTENTION_FAULTS = frozenset(
    (
        Fault.STOPPED, Fault.MAXTEMP, Fault.MINTEMP, Fault.KILL, Fault.ENDSTOP, Fault.HEATER_TIMEOUT,
        Fault.THERMAL_RUNAWAY, Fault.HEATER_STUCK_ON, Fault.TARGET_CHANGED, Fault.WRONG_PRINTER,
    )
)  # fmt: skip


class Recorder:
    """Recorder that keeps board, journal and the open print consistent.

    Parameters
    ----------
    start
        The agent's start file.
    board
        The board, whose state is restored from the journal.
    journal
        The agent's journal.
    clock
        The farm's clock.

    Attributes
    ----------
    alarms
        Alarms for heaters that cannot be switched off.
    journal_error
        Reason for which the last change is not in the journal; None if it is.
    """

    def __init__(self, start: StartFile, board: Board, journal: Journal, clock: Clock) -> None:
        self.journal_error: str | None = None
        self.alarms = Alarms(start.printer, start.power_off_cmd, journal.state.alarm)
        self.board, self.journal, self._clock = board, journal, clock
        self._program: Program | None = None
        self._starvation_before_s = 0.0
        board.state = journal.state.board.model_copy()
        is_watched = board.is_simulated and board.state.bed_unknown_reason is None
        board.idle_watch.filament_watch = FilamentWatch(is_watched, board.state.rest_position)
        if board.state.bed_unknown_reason is None and not board.is_simulated:
            board.state.bed_unknown_reason = NOT_WATCHED_REASON

    def begin(
        self, program: Program | None, filament: Filament, has_extruded: bool, ends_by_s: float | None = None
    ) -> None:
        """Begin a print; without a program, end the print that a dead agent left open.

        Parameters
        ----------
        program
            The program to print.
        filament
            Position of the filament's tip.
        has_extruded
            True if material of the print may be on the bed already.
        ends_by_s
            Farm time at which the print is ended safely; None for no limit.
        """
        now_s, saved_state = self._clock.now(), self.journal.state
        fault = Fault.ESTOP if saved_state.board.attention_reason == ESTOP_REASON else Fault.AGENT_DIED
        context = SessionContext(
            link=self.board.link,
            program=program,
            profile=self.board.profile,
            filament=filament,
            pace=self.board.pace,
            now_s=now_s,
            identity=saved_state.identity,
            previous_fault=fault,
            suspicion=self.alarms.suspicion,
            has_extruded=has_extruded,
            can_reset_board=not self.board.reset_failed,
            ends_by_s=ends_by_s,
        )
        self._program = program
        self.board.idle_watch.filament_watch.trust_journal()
        status = self.board.emulator.read_status()
        self._starvation_before_s = status.starvation_s if status is not None else 0.0
        self.board.begin(Session(context))

    def record_changes(self) -> None:
        """Write all changes to the journal.

        A full disk does not stop a print: every later step tries again, and no print counts as ended before
        its end is written.
        """
        self._update_alarm()
        try:
            self._write_changes()
        except JournalError as error:
            if self.journal_error is None:
                log.error("%s", error)
            self.journal_error = str(error)
        else:
            self.journal_error = None
        self.alarms.run_command()

    def _update_alarm(self) -> None:
        session, board, alarms, now_s = self.board.session, self.board, self.alarms, self._clock.now()
        if board.alarm_is_over:
            board.alarm_is_over = False
            alarms.mark_over()
        if session is not None:
            alarms.take_session_finding(session, now_s)
        elif (stuck_text := alarms.take_idle_finding(board.stuck_heater_text, now_s)) is not None:
            board.state.attention_reason = _join_clauses(
                board.state.attention_reason, f"{stuck_text}: switch it off"
            )
        board.stuck_heater_text = None
        outcome = alarms.poll_outcome()
        if outcome is None:
            return
        if session is not None:
            session.add_reason(outcome)
        else:
            finding = None if alarms.alarm is None else alarms.alarm.text
            board.state.attention_reason = _join_clauses(board.state.attention_reason or finding, outcome)

    def _write_changes(self) -> None:
        session, saved_state, now_s = self.board.session, self.journal.state, self._clock.now()
        state, alarm = self.board.state, self.alarms.alarm
        state.rest_position = self.board.idle_watch.filament_watch.rest_position
        if alarm != saved_state.alarm or state != saved_state.board:
            alarm_record = None if alarm is None else alarm.dump_record()
            self.journal.write(now_s, **state.dump_record(), alarm=alarm_record)
        if session is None or saved_state.print is None:
            return
        context, saved_print = session.context, saved_state.print
        if self._lacks_outcome(context):
            return
        if context.phase is PrintPhase.PRINTING:
            self.board.idle_watch.filament_watch.note_print()
        has_changed = (context.phase, context.has_extruded) != (saved_print.phase, saved_print.extruded)
        if not has_changed and context.filament is saved_state.filament:
            return
        needs_attention = (
            context.fault in _ATTENTION_FAULTS or context.wants_power_off or not context.heaters_off
        )
        if context.has_ended and needs_attention:
            self.board.state.attention_reason = context.reason
        if context.has_ended:
            self.board.state.hot = not context.heaters_off
        snapshot = self.describe_print(saved_print, context)
        self.journal.write(
            now_s,
            print=snapshot.model_dump(mode="json"),
            filament=context.filament.value,
            **state.dump_record(),
            identity=context.identity,
        )
        log.info(
            "print %s: %s%s",
            snapshot.print_id,
            snapshot.phase,
            f" ({snapshot.reason})" if snapshot.reason else "",
        )
        if context.has_ended:
            self.board.session = None
            self._program = None

    def _lacks_outcome(self, context: SessionContext) -> bool:
        """Return True if the reason of an ended print still lacks the outcome of `power_off_cmd`."""
        return context.has_ended and self.alarms.is_pending

    def describe_print(self, saved_print: PrintSnapshot, context: SessionContext) -> PrintSnapshot:
        """Return the current state of the open print."""
        status = self.board.emulator.read_status()
        starved_s = (
            saved_print.starved_s if status is None else status.starvation_s - self._starvation_before_s
        )
        awaits_outcome = self._lacks_outcome(context)
        readings: dict[str, object] = {
            "phase": PrintPhase.ENDING if awaits_outcome else context.phase,
            "fault": context.fault,
            "reason": context.reason,
            "extruded": context.has_extruded,
            "ended_s": None if awaits_outcome else context.ended_s,
            "ends_by_s": context.ends_by_s,
            "pause_ends_s": context.pause_ends_s if context.phase is PrintPhase.PAUSED else None,
            "starved_s": max(0.0, starved_s),
        }
        if self._program is not None:
            readings["line"] = context.acknowledged_line_count
            progress = self._program.compute_progress(context.acknowledged_line_count)
            readings["progress_s"] = progress.time_s
            readings["layers"] = self._program.layer_count
            if progress.layer is not None:
                readings |= {
                    "layer": progress.layer + 1,
                    "z_mm": progress.z_mm,
                    "feature": progress.feature,
                }
            readings["started_s"] = context.started_s
        return saved_print.model_copy(update=readings)


def _join_clauses(text: str | None, addition: str) -> str:
    return addition if text is None else f"{text}; {addition}"
