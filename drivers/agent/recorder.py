"""Recorder of a board in its journal: changes are written down before the board goes on."""

from __future__ import annotations

import logging

from drivers.agent.alarm import Alarms
from drivers.agent.board import UNWATCHED, Board
from drivers.clock import Clock
from drivers.errors import Fault, JournalError
from drivers.gcode import Program
from drivers.messages import Filament, PrintPhase, PrintSnapshot
from drivers.printers import Profile
from drivers.records import ESTOPPED, Journal
from drivers.session import Session, SessionContext

log = logging.getLogger(__name__)

_NEEDS_ATTENTION = frozenset(
    (
        Fault.STOPPED, Fault.MAXTEMP, Fault.MINTEMP, Fault.KILL, Fault.ENDSTOP, Fault.HEATER_TIMEOUT,
        Fault.THERMAL_RUNAWAY, Fault.HEATER_STUCK_ON, Fault.TARGET_CHANGED, Fault.WRONG_PRINTER,
    )
)  # fmt: skip


class Recorder:
    """Keeps board and journal in step, and the open print with both.

    Parameters
    ----------
    printer, profile
        Its name in the fleet, and its model.
    board
        Gets what the journal knows of it.
    journal
        Of this agent.
    clock
        The farm's clock.
    power_off_cmd
        See `mains.PowerOff`.

    Attributes
    ----------
    alarms
        What was found of a heater that cannot be switched off.
    journal_error
        Why the journal is behind, where it is.
    """

    def __init__(
        self,
        printer: str,
        profile: Profile,
        board: Board,
        journal: Journal,
        clock: Clock,
        power_off_cmd: str | None,
    ) -> None:
        self.journal_error: str | None = None
        self._profile = profile
        self.alarms = Alarms(printer, power_off_cmd, journal.state.alarm)
        self._board, self._journal, self._clock = board, journal, clock
        self._program: Program | None = None
        self._starved_before_s = 0.0
        board.state = journal.state.board.model_copy()
        if board.state.bed_unknown_reason is None and not board.simulated:
            board.state.bed_unknown_reason = UNWATCHED

    def begin(
        self, program: Program | None, filament: Filament, extruded: bool, ends_by_s: float | None = None
    ) -> None:
        """Open a print; without a program, recover from one that an agent left behind."""
        now_s, memory = self._clock.now(), self._journal.state
        left = Fault.ESTOP if memory.board.attention_reason == ESTOPPED else Fault.AGENT_DIED
        context = SessionContext(
            link=self._board.link,
            program=program,
            profile=self._profile,
            filament=filament,
            pace=self._board.pace,
            now_s=now_s,
            identity=memory.identity,
            left_by=left,
            suspicion=self.alarms.suspicion,
            extruded=extruded,
            board_resets=not self._board.refuted,
            ends_by_s=ends_by_s,
        )
        self._program = program
        status = self._board.status()
        self._starved_before_s = status.starved_s if status is not None else 0.0
        self._board.begin(Session(context))

    def record_changes(self) -> None:
        """Write down what changed, before the board goes on.

        A full disk stops no print: it is tried again at every step, and until then no print is over.
        """
        self._look_for_alarm()
        try:
            self._write_down()
        except JournalError as error:
            if self.journal_error is None:
                log.error("%s", error)
            self.journal_error = str(error)
        else:
            self.journal_error = None
        self.alarms.act()

    def _look_for_alarm(self) -> None:
        session, board, alarms, now_s = self._board.session, self._board, self.alarms, self._clock.now()
        if board.back:
            board.back = False
            alarms.printer_back()
        if session is not None:
            alarms.of_session(session, now_s)
        elif (news := alarms.of_idle(board.stuck, now_s)) is not None:
            board.state.attention_reason = _joined(board.state.attention_reason, f"{news}: switch it off")
        board.stuck = None
        said = alarms.outcome()
        if said is None:
            return
        if session is not None:
            session.add_reason(said)
        else:
            board.state.attention_reason = _joined(
                board.state.attention_reason or (alarms.alarm.text if alarms.alarm is not None else None),
                said,
            )

    def _write_down(self) -> None:
        session, memory, now_s = self._board.session, self._journal.state, self._clock.now()
        state, alarm = self._board.state, self.alarms.alarm
        if alarm != memory.alarm or state != memory.board:
            known = None if alarm is None else alarm.record()
            self._journal.write(now_s, **state.record(), alarm=known)
        if session is None or memory.print is None:
            return
        context, saved = session.context, memory.print
        if self._held_back(context):
            return
        changed = (context.phase, context.extruded) != (saved.phase, saved.extruded)
        if not changed and context.filament is memory.filament:
            return
        attention = context.fault in _NEEDS_ATTENTION or context.wants_power_off or not context.heaters_off
        if context.ended and attention:
            self._board.state.attention_reason = context.reason
        if context.ended:
            self._board.state.hot = not context.heaters_off
        shot = self.describe_print(saved, context)
        self._journal.write(
            now_s,
            print=shot.model_dump(mode="json"),
            filament=context.filament.value,
            **state.record(),
            identity=context.identity,
        )
        log.info("print %s: %s%s", shot.print_id, shot.phase, f" ({shot.reason})" if shot.reason else "")
        if context.ended:
            self._board.session = None
            self._program = None

    def _held_back(self, context: SessionContext) -> bool:
        """Whether a print has ended whose reason lacks what came of `power_off_cmd`."""
        return context.ended and self.alarms.pending

    def describe_print(self, saved: PrintSnapshot, context: SessionContext) -> PrintSnapshot:
        """The open print as it is now."""
        status = self._board.status()
        starved_s = saved.starved_s if status is None else status.starved_s - self._starved_before_s
        held_back = self._held_back(context)
        known: dict[str, object] = {
            "phase": PrintPhase.ENDING if held_back else context.phase,
            "fault": context.fault,
            "reason": context.reason,
            "extruded": context.extruded,
            "ended_s": None if held_back else context.ended_s,
            "ends_by_s": context.ends_by_s,
            "pause_ends_s": context.pause_ends_s if context.phase is PrintPhase.PAUSED else None,
            "starved_s": max(0.0, starved_s),
        }
        if self._program is not None:
            known["line"] = context.streamed
            mark = self._program.progress_at(context.streamed)
            known["progress_s"] = mark.seconds
            known["layers"] = self._program.layers
            if mark.layer is not None:
                known |= {"layer": mark.layer + 1, "z_mm": mark.z_mm, "feature": mark.feature}
            known["started_s"] = context.started_s
        return saved.model_copy(update=known)


def _joined(text: str | None, more: str) -> str:
    return more if text is None else f"{text}; {more}"
