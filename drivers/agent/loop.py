"""The agent: one thread, one select loop over port, socket, clients and time."""

from __future__ import annotations

import logging
import os
import selectors
import signal
import socket
import time
from pathlib import Path

from drivers import mains
from drivers.agent.board import UNWATCHED, Board
from drivers.agent.idle import CARD
from drivers.agent.inhibit import Inhibitor
from drivers.agent.journal import Journal
from drivers.agent.server import Server
from drivers.agent.spool import Spool
from drivers.clock import Clock
from drivers.errors import AgentError, BadGcode, DriverError, Fault, JournalError
from drivers.gcode import Program
from drivers.marlin import Phase
from drivers.messages import (
    BedCleared,
    CancelPrint,
    Commission,
    Filament,
    ForgetPrint,
    Heater,
    Hello,
    LinkState,
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
from drivers.profiles import Profile
from drivers.session import PARKED_MM, Session

log = logging.getLogger(__name__)

EMULATOR = "emulator"
PUSH_S = 1.0  # wall seconds between snapshots while anything is warm or prints
IDLE_PUSH_S = 5.0
WARM_C = 40.0
_PARKED_SLACK_MM = 1.0
UNPROVEN = "nobody has seen that DTR resets its board: that is tried when somebody says that it is idle"
_KEPT = ("look", "doubt", "hot", "opened", "reset_verified")  # of the board, in the journal
_NEEDS_A_LOOK = frozenset(
    (
        Fault.STOPPED, Fault.MAXTEMP, Fault.MINTEMP, Fault.KILL, Fault.ENDSTOP, Fault.HEATER_TIMEOUT,
        Fault.THERMAL_RUNAWAY, Fault.HEATER_STUCK_ON, Fault.TARGET_CHANGED, Fault.WRONG_PRINTER,
    )
)  # fmt: skip


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
        See `mains.cut`.
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
        self._power_off_cmd = power_off_cmd
        self._printer = printer
        self._profile = profile
        self._clock = clock
        self._selector = selectors.DefaultSelector()
        self._port_fd: int | None = None
        self._over = False
        self._ending = False  # shut down when the open print has ended
        self._journal = Journal(folder / "journal.jsonl")
        self._spool = Spool(folder / "spool")
        self._board = Board(url, folder / EMULATOR, clock, self._remember, self._port_moved)
        for name in _KEPT:
            setattr(self._board, name, getattr(self._journal.memory, name))
        if self._board.doubt is None and not self._board.simulated:
            self._board.doubt = UNWATCHED
        self._url = url
        self._program: Program | None = None
        self._starved_before_s = 0.0
        self._pushed: tuple[object, ...] = ()
        self._push_wall_s = 0.0
        self._folder = folder
        self._server: Server | None = None
        self._unsaid: str | None = None  # why the journal is behind
        self._signals = self._listen_to_signals()

    def run(self) -> None:
        """Until it is told to end. Whatever else ends it, the board is reset: nobody will watch its heat."""
        try:
            self._serve()
        except BaseException:
            log.exception("the agent ends by a fault of its own: resetting the board")
            self._board.cut()
            raise
        finally:
            self._board.close()
            self._inhibitor.hold(False)
            if self._server is not None:
                self._server.close()
            signal.set_wakeup_fd(-1)
            for end in self._signals:
                end.close()
            self._selector.close()

    def _serve(self) -> None:
        left = self._journal.memory.print
        if left is not None and not left.phase.ended:
            log.warning("print %s was open when the last agent died: resetting the board", left.print_id)
            self._begin(None, self._journal.memory.filament, left.extruded)
        self._board.open()
        self._board.tick()
        self._server = Server(self._folder, self._selector, self._answer, self._snapshot)
        wake_wall_s = 0.0
        while not self._over:
            wait_s = wake_wall_s - time.time()
            for key, mask in self._selector.select(wait_s if wait_s > 0.0 else 0.0):
                key.data(mask)
            due = time.time() >= wake_wall_s
            if due:
                self._board.tick()
            if due or self._board.stirred:  # else the wire alone moved, and no deadline came nearer
                self._board.stirred = False
                self._push()
                wake_wall_s = min(self._board.wake_wall_s(), self._push_wall_s)

    # --- the open print ---

    def _begin(self, program: Program | None, filament: Filament, extruded: bool) -> None:
        now_s = self._clock.now()
        known = self._journal.memory.identity
        session = Session(self._board.link, program, self._profile, filament, self._board.pace, now_s, known)
        session.extruded = extruded
        self._program = program
        status = self._board.status()
        self._starved_before_s = status.starved_s if status is not None else 0.0
        self._board.begin(session)

    def _remember(self) -> None:
        """Write down what changed, before the board is told to go on.

        A full disk stops no print: it is tried again at every step, and until then no print is over.
        """
        try:
            self._write_down()
        except JournalError as error:
            if self._unsaid is None:
                log.error("%s", error)
            self._unsaid = str(error)
        else:
            self._unsaid = None

    def _write_down(self) -> None:
        session, memory, now_s = self._board.session, self._journal.memory, self._clock.now()
        if self._board.wants_power_off:
            self._cut_mains()
        kept = {name: getattr(self._board, name) for name in _KEPT}
        if any(getattr(memory, name) != value for name, value in kept.items()):
            self._journal.write(now_s, **kept)
        if session is None or memory.print is None:
            return
        if session.wants_power_off:
            session.wants_power_off = False
            session.reason = f"{session.reason or 'heaters were not shown off'}; {self._cut_mains()}"
        told = memory.print
        changed = (session.phase, session.extruded) != (told.phase, told.extruded)
        if not changed and session.filament is memory.filament:
            return
        if session.ended and (session.fault in _NEEDS_A_LOOK or not session.heaters_off):
            self._board.look = session.reason
        if session.ended:
            self._board.hot = not session.heaters_off
        shot = self._shot(told, session)
        self._journal.write(
            now_s,
            print=shot.model_dump(mode="json"),
            filament=session.filament.value,
            look=self._board.look,
            identity=session.identity,
        )
        log.info("print %s: %s%s", shot.print_id, shot.phase, f" ({shot.reason})" if shot.reason else "")
        if session.ended:
            self._board.session = None
            self._program = None
            self._over = self._over or self._ending

    def _cut_mains(self) -> str:
        """Switch the printer off by its relay, if it has one; nothing else goes on meanwhile."""
        self._board.wants_power_off = False
        if self._power_off_cmd is None:
            return "it has no power_off_cmd: switch it off by hand"
        said = mains.cut(self._power_off_cmd, self._printer)
        if self._board.look is not None:
            self._board.look = f"{self._board.look}; {said}"
        return said

    def _shot(self, told: PrintSnapshot, session: Session) -> PrintSnapshot:
        """The open print as it is now."""
        status = self._board.status()
        starved_s = told.starved_s if status is None else status.starved_s - self._starved_before_s
        known: dict[str, object] = {
            "phase": session.phase,
            "fault": session.fault,
            "reason": session.reason,
            "extruded": session.extruded,
            "ended_s": session.ended_s,
            "starved_s": max(0.0, starved_s),
        }
        if self._program is not None:
            known["line"] = session.streamed
            mark = self._program.at(session.streamed)
            known["progress_s"] = mark.seconds
            known["layers"] = self._program.layers
            if mark.layer is not None:
                known |= {"layer": mark.layer + 1, "z_mm": mark.z_mm, "feature": mark.feature}
            known["started_s"] = session.started_s
        return told.model_copy(update=known)

    # --- what is told ---

    def _link_state(self) -> tuple[LinkState, str | None]:
        board = self._board
        if board.untouched:
            return LinkState.FAULT, board.absent
        if board.session is not None:
            return LinkState.BUSY, board.absent or self._unsaid
        if board.absent is not None:
            return LinkState.ABSENT, board.absent
        if board.proving:
            return LinkState.CONNECTING, None
        if board.look is not None:
            return LinkState.FAULT, board.look
        if board.idle.card:
            return LinkState.FAULT, CARD
        if not board.proven:
            return LinkState.FAULT, UNPROVEN
        return (LinkState.READY if board.link.phase is Phase.LIVE else LinkState.CONNECTING), None

    def _snapshot(self) -> Snapshot:
        board, memory = self._board, self._journal.memory
        session, report, status = board.session, board.report, board.status()
        link, reason = self._link_state()
        filament = memory.filament if session is None else session.filament
        if filament is Filament.UNKNOWN and session is None and status is not None:
            filament = _filament(status.filament_end_mm)
        told = memory.print
        if session is not None and told is not None:
            told = self._shot(told, session)
        off = report is not None and report.nozzle_target_c == 0 and report.bed_target_c == 0
        return Snapshot(
            printer=self._printer,
            agent_pid=os.getpid(),
            model=self._profile.model,
            port=self._url,
            link=link,
            reason=reason,
            nozzle=Heater(now_c=report.nozzle_c, target_c=report.nozzle_target_c) if report else None,
            bed=Heater(now_c=report.bed_c, target_c=report.bed_target_c) if report else None,
            heaters_off=off if session is None else session.heaters_off,
            filament=filament,
            bed_clear=status.bed_clear if status is not None else None,
            starved_s=status.starved_s if status is not None else 0.0,
            board_resets=board.resets,
            doubt=board.doubt,
            reset_verified=board.proven,
            print=told,
        )

    def _push(self) -> None:
        """Tell every client at once what changed, and from time to time what goes on."""
        session, memory = self._board.session, self._journal.memory
        self._inhibitor.hold(session is not None)
        key = (
            self._link_state(),
            self._board.resets,
            self._board.doubt,
            self._board.report is None,
            memory.print.print_id if memory.print is not None else None,
            (session.phase, session.extruded, session.filament, session.heaters_off) if session else None,
        )
        wall_s = time.time()
        if key == self._pushed and wall_s < self._push_wall_s:
            return
        self._pushed = key
        report = self._board.report
        warm = report is not None and max(report.nozzle_c, report.bed_c) > WARM_C
        self._push_wall_s = wall_s + (PUSH_S if warm or session is not None else IDLE_PUSH_S)
        if self._server is not None:
            self._server.push(self._snapshot())

    # --- requests ---

    def _answer(self, request: Request) -> Reply:
        try:
            self._obey(request)
        except (DriverError, OSError) as error:
            log.warning("%s refused: %s", request.do, error)
            return Reply(id=request.id, error=str(error), snapshot=self._snapshot())
        return Reply(id=request.id, snapshot=self._snapshot())

    def _obey(self, request: Request) -> None:
        told = self._journal.memory.print
        match request:
            case Hello():
                pass
            case StartPrint():
                self._start(request)
            case Upload():
                self._spool.put(request.print_id, request.at, request.data)
            case CancelPrint():
                if told is not None and told.print_id == request.print_id:
                    self._board.cancel(request.reason)
            case PausePrint() | ResumePrint():
                if told is not None and told.print_id == request.print_id:
                    self._board.pause(isinstance(request, PausePrint))
            case ForgetPrint():
                if told is not None and told.print_id == request.print_id:
                    if not told.phase.ended:
                        raise AgentError(f"print {told.print_id} is still open: cancel it first")
                    self._journal.write(self._clock.now(), print=None)
                    self._spool.drop(request.print_id)
            case BedCleared():
                self._cleared(request)
            case Commission():
                self._board.prove()
            case Shutdown():
                if self._board.session is None:
                    self._over = True
                elif request.now:
                    self._ending = True
                    self._board.cancel("the farm was shut down")
                else:
                    raise AgentError(f"{self._printer} prints: cancel it, or shut down with `now`")

    def _start(self, request: StartPrint) -> None:
        self._spool.check(request.print_id)
        memory = self._journal.memory
        if request.print_id in memory.ended or (memory.print and memory.print.print_id == request.print_id):
            return  # told before
        link, reason = self._link_state()
        if link is not LinkState.READY:
            raise AgentError(f"{self._printer} is {link}{': ' + reason if reason else ''}")
        if self._board.doubt is not None:
            raise AgentError(f"{self._printer}: its bed is not known to be clear: {self._board.doubt}")
        if request.filament is Filament.UNKNOWN:
            raise AgentError(f"{self._printer}: nobody knows where its filament is: load it first")
        now_s = self._clock.now()
        shot = PrintSnapshot(
            print_id=request.print_id, phase=PrintPhase.SPOOLED, print_time_s=request.print_time_s
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
        self._begin(program, request.filament, extruded=False)

    def _cleared(self, request: BedCleared) -> None:
        if self._board.session is not None:
            raise AgentError(f"{self._printer} prints: its bed is cleared when that has ended")
        told = self._journal.memory.print
        if self._board.look is not None and told is not None and told.fault == Fault.WRONG_PRINTER:
            self._journal.write(
                self._clock.now(), identity=None
            )  # a person has seen that it is the right one
        self._board.clear_bed()
        self._board.looked_at()
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
        if self._board.session is None:
            self._over = True
            return
        self._ending = True
        log.warning("asked to end by a signal: %s", "at once" if now else "when the open print has ended")
        if now:
            self._board.cancel("its agent was told to end")


def _filament(end_mm: float) -> Filament:
    """Where an emulator's filament is."""
    if abs(end_mm + PARKED_MM) <= _PARKED_SLACK_MM:
        return Filament.PARKED
    return Filament.AT_NOZZLE if abs(end_mm) <= 1.0 else Filament.UNKNOWN
