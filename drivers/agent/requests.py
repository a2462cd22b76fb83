"""Handling of requests to an agent."""

from __future__ import annotations

from pathlib import Path

from drivers.agent.recorder import Recorder
from drivers.agent.snapshots import describe_link
from drivers.agent.spool import Spool
from drivers.clock import Clock
from drivers.errors import AgentError, BadGcode, Fault, TooLate
from drivers.messages import (
    BedCleared,
    CancelPrint,
    Commission,
    EndPrintBy,
    Filament,
    ForgetPrint,
    Hello,
    LinkState,
    ListLines,
    ListPrints,
    PausePrint,
    PrintPhase,
    PrintSnapshot,
    Request,
    ResumePrint,
    Shutdown,
    StartPrint,
    Upload,
)


class RequestHandler:
    """Handler that executes requests on the board, the journal and the spool.

    Parameters
    ----------
    printer
        The printer's name in the fleet.
    recorder
        The recorder, with board and journal.
    spool
        The agent's files.
    clock
        The farm's clock.

    Attributes
    ----------
    must_end
        True if the agent has to end now.
    must_end_after_print
        True if the agent has to end after the open print.
    """

    def __init__(self, printer: str, recorder: Recorder, spool: Spool, clock: Clock) -> None:
        self.must_end = False
        self.must_end_after_print = False
        self._printer = printer
        self._recorder, self._board, self._journal = recorder, recorder.board, recorder.journal
        self._spool, self._clock = spool, clock

    def handle(self, request: Request) -> None:
        """Execute a request.

        Raises
        ------
        DriverError
            The request is refused.
        OSError
            The disk failed.
        """
        match request:
            case Hello() | ListPrints() | ListLines():
                pass
            case StartPrint():
                self._start_print(request)
            case Upload():
                self._spool.append_upload(request.print_id, request.offset, request.data)
            case CancelPrint() | EndPrintBy() | PausePrint() | ResumePrint() | ForgetPrint():
                snapshot = self._journal.state.print
                if snapshot is not None and snapshot.print_id == request.print_id:
                    self._change_print(request, snapshot)
            case BedCleared():
                self._clear_bed(request)
            case Commission():
                self._board.verify_reset()
            case Shutdown():
                self._shut_down(request)

    def _change_print(
        self,
        request: CancelPrint | EndPrintBy | PausePrint | ResumePrint | ForgetPrint,
        snapshot: PrintSnapshot,
    ) -> None:
        match request:
            case CancelPrint():
                self._board.cancel(request.reason)
            case EndPrintBy():
                self._board.set_ends_by(request.ends_by_s)
            case PausePrint() | ResumePrint():
                self._board.set_paused(isinstance(request, PausePrint))
            case ForgetPrint():
                if not snapshot.phase.ended:
                    raise AgentError(f"print {snapshot.print_id} is still open: cancel it first")
                self._journal.write(self._clock.now(), print=None)
                self._spool.delete(request.print_id)
                self._journal.shorten()

    def _start_print(self, request: StartPrint) -> None:
        self._spool.check_print_id(request.print_id)
        journal_state = self._journal.state
        if request.print_id in journal_state.ended_print_ids or (
            journal_state.print and journal_state.print.print_id == request.print_id
        ):
            return  # a repeated request
        now_s = self._clock.now()
        self._check_can_start(request, now_s)
        snapshot = PrintSnapshot(
            print_id=request.print_id,
            phase=PrintPhase.SPOOLED,
            print_time_s=request.print_time_s,
            sha256=request.sha256,
        )
        try:
            source = Path(request.gcode) if request.gcode else self._spool.make_upload_path(request.print_id)
            program = self._spool.import_gcode(request.print_id, source, request.sha256)
            self._spool.make_upload_path(request.print_id).unlink(missing_ok=True)
        except BadGcode as error:
            update = {"phase": PrintPhase.FAILED, "fault": Fault.BAD_FILE, "reason": str(error)}
            snapshot = snapshot.model_copy(update=update | {"started_s": now_s, "ended_s": now_s})
            self._journal.write(now_s, print=snapshot.model_dump(mode="json"))
            self._board.has_changed = True
            return
        snapshot = snapshot.model_copy(update={"lines": program.line_count, "started_s": now_s})
        self._journal.write(now_s, print=snapshot.model_dump(mode="json"), filament=request.filament.value)
        self._recorder.begin(program, request.filament, has_extruded=False, ends_by_s=request.ends_by_s)

    def _check_can_start(self, request: StartPrint, now_s: float) -> None:
        """Raise AgentError unless the printer is ready, its bed clear and its filament known."""
        if request.not_after_s is not None and now_s > request.not_after_s:
            late_s = now_s - request.not_after_s
            raise TooLate(f"{self._printer}: the start came {late_s:.0f} s too late")
        link, reason = describe_link(self._board, self._recorder.journal_error)
        if link is not LinkState.READY:
            raise AgentError(f"{self._printer} is {link}{': ' + reason if reason else ''}")
        bed_unknown_reason = self._board.state.bed_unknown_reason
        if bed_unknown_reason is not None:
            raise AgentError(f"{self._printer}: its bed is not known to be clear: {bed_unknown_reason}")
        if request.filament is Filament.UNKNOWN:
            raise AgentError(f"{self._printer}: the position of its filament is unknown: load it first")

    def _clear_bed(self, request: BedCleared) -> None:
        if self._board.session is not None:
            raise AgentError(f"{self._printer} is printing: clear its bed after the print")
        snapshot, attention = self._journal.state.print, self._board.state.attention_reason
        if attention is not None and snapshot is not None and snapshot.fault == Fault.WRONG_PRINTER:
            self._journal.write(self._clock.now(), identity=None)  # a person has checked which printer it is
        self._board.emulator.clear_bed()
        self._board.clear_attention()
        self._recorder.alarms.clear()
        if request.filament is not None:
            self._journal.write(self._clock.now(), filament=request.filament.value)
            self._board.idle_watch.filament_watch.trust_journal()
        self._recorder.record_changes()

    def _shut_down(self, request: Shutdown) -> None:
        if self._board.session is None:
            if self._board.state.hot and not request.now:
                raise AgentError(f"{self._printer} may still be hot: check it, or shut down with `now`")
            self.must_end = True
        elif request.now:
            self.must_end_after_print = True
            self._board.cancel("the farm was shut down")
        else:
            raise AgentError(f"{self._printer} is printing: cancel it, or shut down with `now`")
