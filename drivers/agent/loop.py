"""The agent: one thread, one select loop over port, socket, clients and time."""

from __future__ import annotations

import logging
import os
import selectors
import signal
import socket
from pathlib import Path

from drivers.agent.board import NO_RESET, Board
from drivers.agent.idle_watch import CARD
from drivers.agent.recorder import Recorder
from drivers.agent.server import Server
from drivers.agent.sleep_inhibitor import Inhibitor
from drivers.agent.spool import Spool
from drivers.clock import Clock, wall_s
from drivers.errors import AgentError, BadGcode, DriverError, Fault, TooLate
from drivers.link import Phase
from drivers.messages import (
    PROTOCOL,
    BedCleared,
    CancelPrint,
    Commission,
    EndPrintBy,
    Filament,
    ForgetPrint,
    Heater,
    Hello,
    LinkState,
    ListPrints,
    PausePrint,
    PrintPhase,
    PrintSnapshot,
    Reply,
    Request,
    ResumePrint,
    Shutdown,
    Snapshot,
    StartPrint,
    Upload,
)
from drivers.printers import Profile
from drivers.records import JOURNAL, Journal

log = logging.getLogger(__name__)

EMULATOR = "emulator"
PUSH_S = 1.0  # wall seconds between snapshots while anything is warm or prints
IDLE_PUSH_S = 5.0
WARM_C = 40.0
_PARKED_SLACK_MM = 1.0
UNPROVEN = "nobody has seen that DTR resets its board: that is tried when somebody says that it is idle"


class Agent:
    """Owns one printer's port for as long as the process lives.

    Parameters
    ----------
    printer
        Its name in the fleet.
    profile
        Its model.
    url
        Its port.
    folder
        The agent's own: socket, journal, spool, and an emulator's folder.
    clock
        The farm's clock.
    power_off_cmd
        See `mains.PowerOff`.
    inhibitor
        Held while a print is open.
    """

    def __init__(
        self,
        printer: str,
        profile: Profile,
        url: str,
        folder: Path,
        clock: Clock,
        power_off_cmd: str | None = None,
        inhibitor: Inhibitor | None = None,
    ) -> None:
        self._inhibitor = inhibitor or Inhibitor(printer, simulated=True)
        self._printer = printer
        self._profile = profile
        self._clock = clock
        self._selector = selectors.DefaultSelector()
        self._port_fd: int | None = None
        self._over = False
        self._ending = False  # shut down when the open print has ended
        self._journal = Journal(folder / JOURNAL)
        self._spool = Spool(folder / "spool", profile)
        self._board = Board(url, profile, folder / EMULATOR, clock, self._remember, self._port_moved)
        self._recorder = Recorder(printer, profile, self._board, self._journal, clock, power_off_cmd)
        self._url = url
        self._pushed: tuple[object, ...] = ()
        self._push_wall_s = 0.0
        self._folder = folder
        self._server: Server | None = None
        self._signals = self._listen_to_signals()

    def run(self) -> None:
        """Until it is told to end. Where heat may be on then, the board is reset: nobody will watch it."""
        try:
            self._serve()
        except BaseException:
            log.exception("the agent ends by a fault of its own")
            raise
        finally:
            self._board.cut()
            self._board.close()
            self._inhibitor.hold(False)
            if self._server is not None:
                self._server.close()
            signal.set_wakeup_fd(-1)
            for end in self._signals:
                end.close()
            self._selector.close()

    def _serve(self) -> None:
        left = self._journal.state.print
        if left is not None and not left.phase.ended:
            log.warning("print %s was open when the last agent died: resetting the board", left.print_id)
            self._recorder.begin(None, self._journal.state.filament, left.extruded)
        self._board.open()
        self._board.tick()
        self._server = Server(self._folder, self._selector, self._answer, self._snapshot)
        wake_wall_s = 0.0
        while not self._over:
            wait_s = wake_wall_s - wall_s()
            for key, mask in self._selector.select(wait_s if wait_s > 0.0 else 0.0):
                key.data(mask)
            due = wall_s() >= wake_wall_s
            if due:
                self._board.tick()
            if due or self._board.stirred:  # else the wire alone moved, and no deadline came nearer
                self._board.stirred = False
                self._push()
                alarms_wall_s = self._recorder.alarms.wake_wall_s()
                wake_wall_s = min(self._board.wake_wall_s(), self._push_wall_s, alarms_wall_s)

    def _remember(self) -> None:
        self._recorder.record_changes()
        if self._ending and self._board.session is None and not self._board.state.hot:
            self._over = True

    # --- snapshots ---

    def _link_state(self) -> tuple[LinkState, str | None]:
        board = self._board
        if board.untouched:
            return LinkState.FAULT, board.absent
        if board.session is not None:
            return LinkState.BUSY, board.absent or self._recorder.journal_error
        if board.absent is not None:
            return LinkState.ABSENT, board.absent
        if board.proving:
            return LinkState.CONNECTING, None
        if board.state.attention_reason is not None:
            return LinkState.FAULT, board.state.attention_reason
        if board.idle.card:
            return LinkState.FAULT, CARD
        if not (board.proven or board.refuted):
            return LinkState.FAULT, UNPROVEN
        live = LinkState.READY if board.link.phase is Phase.LIVE else LinkState.CONNECTING
        return live, NO_RESET if board.refuted else None

    def _snapshot(self) -> Snapshot:
        board, memory = self._board, self._journal.state
        session, report, status = board.session, board.report, board.status()
        link, reason = self._link_state()
        filament = memory.filament if session is None else session.context.filament
        if filament is Filament.UNKNOWN and session is None and status is not None:
            filament = _filament(status.filament_end_mm, self._profile.parked_mm)
        known = memory.print
        if session is not None and known is not None:
            known = self._recorder.describe_print(known, session.context)
        off = report is not None and report.nozzle_target_c == 0 and report.bed_target_c == 0
        return Snapshot(
            protocol=PROTOCOL,
            printer=self._printer,
            agent_pid=os.getpid(),
            now_s=self._clock.now(),
            model=self._profile.model,
            port=self._url,
            link=link,
            reason=reason,
            nozzle=Heater(now_c=report.nozzle_c, target_c=report.nozzle_target_c) if report else None,
            bed=Heater(now_c=report.bed_c, target_c=report.bed_target_c) if report else None,
            heaters_off=off if session is None else session.context.heaters_off,
            filament=filament,
            bed_clear=status.bed_clear if status is not None else None,
            starved_s=status.starved_s if status is not None else 0.0,
            board_resets=board.resets,
            bed_unknown_reason=board.state.bed_unknown_reason,
            alarm=self._recorder.alarms.message,
            reset_verified=board.proven,
            print=known,
        )

    def _push(self) -> None:
        """Tell every client at once what changed, and from time to time what goes on."""
        session, memory = self._board.session, self._journal.state
        self._inhibitor.hold(session is not None)
        key = (
            self._link_state(),
            self._board.resets,
            self._board.state.bed_unknown_reason,
            self._recorder.alarms.message,
            self._board.report is None,
            memory.print.print_id if memory.print is not None else None,
            session.context.phase if session else None,
            (session.context.extruded, session.context.filament, session.context.heaters_off)
            if session
            else None,
        )
        now_s = wall_s()
        if self._server is not None:
            self._server.end_stalled()
        if key == self._pushed and now_s < self._push_wall_s:
            return
        self._pushed = key
        report = self._board.report
        warm = report is not None and max(report.nozzle_c, report.bed_c) > WARM_C
        self._push_wall_s = now_s + (PUSH_S if warm or session is not None else IDLE_PUSH_S)
        if self._server is not None:
            self._server.push(self._snapshot())

    # --- requests ---

    def _answer(self, request: Request) -> Reply:
        try:
            self._obey(request)
        except (DriverError, OSError) as error:
            log.warning("%s refused: %s", request.do, error)
            late = isinstance(error, TooLate)
            return Reply(id=request.id, error=str(error), late=late, snapshot=self._snapshot())
        prints = self._prints(request.since_s) if isinstance(request, ListPrints) else ()
        return Reply(id=request.id, snapshot=self._snapshot(), prints=prints)

    def _prints(self, since_s: float) -> tuple[PrintSnapshot, ...]:
        """All that had not ended then, the open one last."""
        memory, known = self._journal.state, self._snapshot().print
        late = [said for said in memory.recent if said.ended_s is None or said.ended_s >= since_s]
        if known is not None and known.print_id not in memory.ended:
            late.append(known)
        return tuple(late)

    def _obey(self, request: Request) -> None:
        known = self._journal.state.print
        match request:
            case Hello() | ListPrints():
                pass
            case StartPrint():
                self._start(request)
            case Upload():
                self._spool.put(request.print_id, request.at, request.data)
            case CancelPrint():
                if known is not None and known.print_id == request.print_id:
                    self._board.cancel(request.reason)
            case EndPrintBy():
                if known is not None and known.print_id == request.print_id:
                    self._board.end_by(request.ends_by_s)
            case PausePrint() | ResumePrint():
                if known is not None and known.print_id == request.print_id:
                    self._board.pause(isinstance(request, PausePrint))
            case ForgetPrint():
                if known is not None and known.print_id == request.print_id:
                    if not known.phase.ended:
                        raise AgentError(f"print {known.print_id} is still open: cancel it first")
                    self._journal.write(self._clock.now(), print=None)
                    self._spool.drop(request.print_id)
            case BedCleared():
                self._cleared(request)
            case Commission():
                self._board.prove()
            case Shutdown():
                if self._board.session is None:
                    if self._board.state.hot and not request.now:
                        raise AgentError(
                            f"{self._printer} may still be hot: look at it, or shut down with `now`"
                        )
                    self._over = True
                elif request.now:
                    self._ending = True
                    self._board.cancel("the farm was shut down")
                else:
                    raise AgentError(f"{self._printer} prints: cancel it, or shut down with `now`")

    def _start(self, request: StartPrint) -> None:
        self._spool.check(request.print_id)
        memory = self._journal.state
        if request.print_id in memory.ended or (memory.print and memory.print.print_id == request.print_id):
            return  # it was asked before
        now_s = self._clock.now()
        if request.not_after_s is not None and now_s > request.not_after_s:
            late_s = now_s - request.not_after_s
            raise TooLate(
                f"{self._printer}: the word to begin came {late_s:.0f} s too late: it may not any more"
            )
        link, reason = self._link_state()
        if link is not LinkState.READY:
            raise AgentError(f"{self._printer} is {link}{': ' + reason if reason else ''}")
        if self._board.state.bed_unknown_reason is not None:
            raise AgentError(
                f"{self._printer}: its bed is not known to be clear: {self._board.state.bed_unknown_reason}"
            )
        if request.filament is Filament.UNKNOWN:
            raise AgentError(f"{self._printer}: nobody knows where its filament is: load it first")
        shot = PrintSnapshot(
            print_id=request.print_id,
            phase=PrintPhase.SPOOLED,
            print_time_s=request.print_time_s,
            sha256=request.sha256,
        )
        try:
            source = Path(request.gcode) if request.gcode else self._spool.part(request.print_id)
            program = self._spool.take(request.print_id, source, request.sha256)
            self._spool.part(request.print_id).unlink(missing_ok=True)
        except BadGcode as error:
            update = {"phase": PrintPhase.FAILED, "fault": Fault.BAD_FILE, "reason": str(error)}
            shot = shot.model_copy(update=update | {"started_s": now_s, "ended_s": now_s})
            self._journal.write(now_s, print=shot.model_dump(mode="json"))
            self._board.stirred = True
            return
        shot = shot.model_copy(update={"lines": program.count, "started_s": now_s})
        self._journal.write(now_s, print=shot.model_dump(mode="json"), filament=request.filament.value)
        self._recorder.begin(program, request.filament, extruded=False, ends_by_s=request.ends_by_s)

    def _cleared(self, request: BedCleared) -> None:
        if self._board.session is not None:
            raise AgentError(f"{self._printer} prints: its bed is cleared when that has ended")
        known = self._journal.state.print
        if (
            self._board.state.attention_reason is not None
            and known is not None
            and known.fault == Fault.WRONG_PRINTER
        ):
            self._journal.write(
                self._clock.now(), identity=None
            )  # a person has seen that it is the right one
        self._board.clear_bed()
        self._board.clear_attention()
        self._recorder.alarms.clear()
        if request.filament is not None:
            self._journal.write(self._clock.now(), filament=request.filament.value)
        self._remember()

    # --- around it ---

    def _port_moved(self, fd: int | None) -> None:
        if self._port_fd is not None:
            self._selector.unregister(self._port_fd)
        self._port_fd = fd
        if fd is not None:
            self._selector.register(fd, selectors.EVENT_READ, self._board.readable)

    def _listen_to_signals(self) -> tuple[socket.socket, socket.socket]:
        """SIGTERM and SIGINT wake the loop through a socket, so that they are handled between two steps."""
        ours, theirs = socket.socketpair()
        for end in (ours, theirs):
            end.setblocking(False)
        signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: None)
        self._selector.register(ours, selectors.EVENT_READ, self._signalled)
        return ours, theirs

    def _signalled(self, _: int) -> None:
        """SIGTERM waits for the open print; SIGINT ends it safely."""
        now = signal.SIGINT in self._signals[0].recv(64)
        if self._board.session is None and (now or not self._board.state.hot):
            self._over = True
            return
        self._ending = True
        log.warning("asked to end by a signal: %s", "at once" if now else "when the open print has ended")
        if now:
            self._board.cancel("its agent was told to end")


def _filament(end_mm: float, parked_mm: float) -> Filament:
    """Tell the place of an emulator's filament."""
    if abs(end_mm + parked_mm) <= _PARKED_SLACK_MM:
        return Filament.PARKED
    return Filament.AT_NOZZLE if abs(end_mm) <= 1.0 else Filament.UNKNOWN
