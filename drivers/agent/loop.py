"""Main loop of the agent: one thread and one selector for port, socket, clients and timers."""

from __future__ import annotations

import logging
import selectors
import signal
import socket
from pathlib import Path

from drivers.agent.board import Board
from drivers.agent.recorder import Recorder
from drivers.agent.requests import RequestHandler
from drivers.agent.server import Server
from drivers.agent.sleep_inhibitor import Inhibitor
from drivers.agent.snapshots import describe_link, list_prints, make_snapshot
from drivers.agent.spool import Spool
from drivers.clock import read_wall_s
from drivers.errors import DriverError, TooLate
from drivers.log_file import rotate_log
from drivers.messages import ListLines, ListPrints, Reply, Request, Snapshot, WireLine
from drivers.printers import PROFILES
from drivers.records import AGENT_LOG, JOURNAL, Journal, StartFile

log = logging.getLogger(__name__)

EMULATOR_FOLDER = "emulator"
PUSH_INTERVAL_S = 1.0  # wall seconds between two snapshots while the printer is warm or printing
IDLE_PUSH_INTERVAL_S = 5.0
LOG_CHECK_INTERVAL_S = 60.0  # wall seconds between two checks of the log's size
MIN_WARM_C = 40.0  # temperature above which a heater counts as warm


class Agent:
    """Owner of one printer's port until the process ends.

    Parameters
    ----------
    start
        The agent's start file; its model is one of `PROFILES`.
    folder
        The agent's folder: socket, journal, spool, and an emulator's folder.
    inhibitor
        Inhibitor that prevents sleep and shutdown of the host while a print is open.
    """

    def __init__(self, start: StartFile, folder: Path, inhibitor: Inhibitor | None = None) -> None:
        self._start, self._folder, self._clock = start, folder, start.clock
        self._inhibitor = inhibitor or Inhibitor(start.printer, is_simulated=True)
        self._selector = selectors.DefaultSelector()
        self._port_fd: int | None = None
        profile = PROFILES[start.model]
        self._journal = Journal(folder / JOURNAL)
        spool = Spool(folder / "spool", profile)
        saved_print = self._journal.state.print
        spool.delete_others(None if saved_print is None else saved_print.print_id)
        self._journal.shorten()
        emulator_folder = folder / EMULATOR_FOLDER
        self._board = Board(
            start.port, profile, emulator_folder, self._clock, self._save_changes, self._on_port_change
        )
        self._recorder = Recorder(start, self._board, self._journal, self._clock)
        self._request_handler = RequestHandler(start.printer, self._recorder, spool, self._clock)
        self._pushed_key: tuple[object, ...] = ()
        self._push_wall_s = 0.0
        self._log_wall_s = 0.0
        self._server: Server | None = None
        self._signal_sockets = self._listen_to_signals()

    def run(self) -> None:
        """Serve until the agent has to end; then switch off heaters, as nothing would watch them any more."""
        try:
            self._serve()
        except BaseException:
            log.exception("the agent ends because of an internal error")
            raise
        finally:
            self._board.switch_off_heaters()
            self._board.close()
            self._inhibitor.set_lock(False)
            if self._server is not None:
                self._server.close()
            signal.set_wakeup_fd(-1)
            for signal_socket in self._signal_sockets:
                signal_socket.close()
            self._selector.close()

    def _serve(self) -> None:
        saved_print = self._journal.state.print
        if saved_print is not None and not saved_print.phase.ended:
            log.warning(
                "print %s was open when the last agent died: resetting the board", saved_print.print_id
            )
            self._recorder.begin(None, self._journal.state.filament, saved_print.extruded)
        self._board.open()
        self._board.tick()
        self._server = Server(self._folder, self._selector, self._answer_request, self._build_snapshot)
        wake_wall_s = 0.0
        while not self._request_handler.must_end:
            wait_s = wake_wall_s - read_wall_s()
            for key, mask in self._selector.select(wait_s if wait_s > 0.0 else 0.0):
                key.data(mask)
            is_due = read_wall_s() >= wake_wall_s
            if is_due:
                self._board.tick()
                self._limit_log()
            # In all other cases only a line of the program was sent, and no deadline became earlier.
            if is_due or self._board.has_changed:
                self._board.has_changed = False
                self._push_snapshot()
                alarms_wall_s = self._recorder.alarms.compute_wake_wall_s()
                wake_wall_s = min(self._board.compute_wake_wall_s(), self._push_wall_s, alarms_wall_s)

    def _limit_log(self) -> None:
        """Rename the log if it is full; a check takes two microseconds."""
        if read_wall_s() >= self._log_wall_s:
            self._log_wall_s = read_wall_s() + LOG_CHECK_INTERVAL_S
            rotate_log(self._folder / AGENT_LOG)

    def _save_changes(self) -> None:
        self._recorder.record_changes()
        if (
            self._request_handler.must_end_after_print
            and self._board.session is None
            and not self._board.state.hot
        ):
            self._request_handler.must_end = True

    # --- messages ---

    def _build_snapshot(self) -> Snapshot:
        return make_snapshot(self._start, self._recorder, self._clock.now())

    def _answer_request(self, request: Request) -> Reply:
        try:
            self._request_handler.handle(request)
        except (DriverError, OSError) as error:
            log.warning("%s refused: %s", request.do, error)
            is_late = isinstance(error, TooLate)
            return Reply(id=request.id, error=str(error), late=is_late, snapshot=self._build_snapshot())
        prints = list_prints(self._recorder, request.since_s) if isinstance(request, ListPrints) else ()
        lines = self._board.wire_record.list_lines() if isinstance(request, ListLines) else ()
        wire_lines = tuple(WireLine(at_s=line.at_s, sent=line.sent, text=line.text) for line in lines)
        return Reply(id=request.id, snapshot=self._build_snapshot(), prints=prints, lines=wire_lines)

    def _push_snapshot(self) -> None:
        """Send a snapshot to all clients: at once after a change, otherwise at intervals."""
        session, report, journal_state = self._board.session, self._board.report, self._journal.state
        self._inhibitor.set_lock(session is not None)
        context = None if session is None else session.context
        key = (
            describe_link(self._board, self._recorder.journal_error),
            self._board.reset_count,
            self._board.state.bed_unknown_reason,
            self._board.idle_watch.filament_watch.is_certain,
            self._recorder.alarms.message,
            report is None,
            journal_state.print.print_id if journal_state.print is not None else None,
            context and (context.phase, context.has_extruded, context.filament, context.heaters_off),
        )
        now_s = read_wall_s()
        if self._server is not None:
            self._server.drop_stalled_clients()
        if key == self._pushed_key and now_s < self._push_wall_s:
            return
        self._pushed_key = key
        is_warm = report is not None and max(report.nozzle_c, report.bed_c) > MIN_WARM_C
        is_active = is_warm or session is not None
        self._push_wall_s = now_s + (PUSH_INTERVAL_S if is_active else IDLE_PUSH_INTERVAL_S)
        if self._server is not None:
            self._server.push(self._build_snapshot())

    # --- port and signals ---

    def _on_port_change(self, fd: int | None) -> None:
        if self._port_fd is not None:
            self._selector.unregister(self._port_fd)
        self._port_fd = fd
        if fd is not None:
            self._selector.register(fd, selectors.EVENT_READ, self._board.on_readable)

    def _listen_to_signals(self) -> tuple[socket.socket, socket.socket]:
        """Let SIGTERM and SIGINT wake the loop through a socket, so it handles them between two steps."""
        read_end, write_end = socket.socketpair()
        for signal_socket in (read_end, write_end):
            signal_socket.setblocking(False)
        signal.set_wakeup_fd(write_end.fileno(), warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: None)
        self._selector.register(read_end, selectors.EVENT_READ, self._on_signal)
        return read_end, write_end

    def _on_signal(self, _: int) -> None:
        """End after the open print on SIGTERM; on SIGINT, end the print safely first."""
        ends_print = signal.SIGINT in self._signal_sockets[0].recv(64)
        if self._board.session is None and (ends_print or not self._board.state.hot):
            self._request_handler.must_end = True
            return
        self._request_handler.must_end_after_print = True
        log.warning(
            "asked to end by a signal: %s", "at once" if ends_print else "when the open print has ended"
        )
        if ends_print:
            self._board.cancel("its agent was asked to end")
