"""The port with its link and, while a print is open, its session: bytes in, bytes out, resets."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers.agent.idle_watch import CARD, IdleWatch
from drivers.clock import Clock, wall_s
from drivers.emulator.launch import control, read_status
from drivers.emulator.status import EmulatorStatus
from drivers.errors import AgentError, Fault, PortError, PortNotIdle
from drivers.link import Event, Events, Link, Phase, Report, Said, Trouble, Up
from drivers.ports import Port, identify_device, open_port
from drivers.printers import Profile
from drivers.records import BoardState
from drivers.safety import send_abort, send_abort_until_accepted
from drivers.session import Pace, Session

log = logging.getLogger(__name__)

RETRY_S = 2.0  # wall seconds between attempts to open a port
PULSES = 2
UNWATCHED = "nobody watched it before its agent was started"
NOT_IDLE = "its port is opened when somebody has said that it does not print: opening it may reset it"
NO_RESET = "its board does not start again at a pulse of DTR: it prints only while somebody is there"


class Board:
    """One printer's board behind its port.

    Parameters
    ----------
    url
        The port, as `fleet.yaml` names it.
    profile
        The printer's model.
    folder
        Where an emulator of a ``sim://`` port lives.
    clock
        The farm's clock.
    remember
        Called before anything is written to the port and after anything changed: the journal's chance.
    moved
        Called with the new descriptor of the port, or None where it went.
    """

    def __init__(
        self,
        url: str,
        profile: Profile,
        folder: Path,
        clock: Clock,
        remember: Callable[[], None],
        moved: Callable[[int | None], None],
    ) -> None:
        self.simulated = url.startswith("sim://")
        self.pace = Pace.of(clock)
        self._firmware = profile.firmware
        self.link = Link(self._firmware, self.pace.floor_s)
        self.session: Session | None = None
        self.report: Report | None = None
        self.absent: str | None = "the port was not opened yet"
        self.untouched = False  # it is there, but nobody has said that it may be opened
        self.state = BoardState()
        self.resets = 0  # that the agent did not cause
        self.stuck: str | None = None  # a heater that is off and gets hotter, while idle; taken by the record
        self.back = False  # the printer was away, or seen cold: what is found from now on is news
        self.idle = IdleWatch()
        self.stirred = False  # something other than the next line of a program happened
        self._url, self._folder, self._clock = url, folder, clock
        self._remember, self._moved = remember, moved
        self._port: Port | None = None
        self._retry_wall_s = 0.0
        self._said_idle = False  # by a person: its port may be opened
        self.proving = 0  # pulses of DTR that are left to show that it resets the board

    # --- what the loop does ---

    def readable(self, _: int = 0) -> None:
        """Bytes came."""
        port = self._port
        if port is None:
            return
        try:
            data = port.read()
            now_s = self._clock.now()
            events = self.link.receive(data, now_s)
            if events is None:
                port.write(self.link.take())
                return
        except PortError as error:
            self._gone(error)
            return
        self._go_on(events, now_s)

    def tick(self) -> None:
        """Look what is due."""
        if self._port is None and wall_s() >= self._retry_wall_s:
            self.open()
        now_s = self._clock.now()
        self._go_on(self.link.tick(now_s), now_s)

    def wake_wall_s(self) -> float:
        """Wall time at which `tick` wants to be called."""
        due_s = self.link.deadline_s
        if self.session is not None:
            due_s = min(due_s, self.session.deadline_s)
        wall_s = self._clock.wall(due_s)
        return min(wall_s, self._retry_wall_s) if self._port is None else wall_s

    def open(self) -> None:
        """Open the port, which resets the board. Where that fails, it is tried again later.

        A port that the kernel has not opened since it was plugged in raises DTR, and nothing can be asked
        before: it is left alone until somebody has said that the printer does not print by itself.
        """
        try:
            device = identify_device(self._url)
            if not (
                self.simulated or self._ours or self._said_idle or (device and device == self.state.opened)
            ):
                raise PortNotIdle(NOT_IDLE)
            self._port = open_port(self._url, self._folder, self._clock, self._firmware.baud_rate)
            self.state.opened = device
        except PortError as error:
            self.untouched = isinstance(error, PortNotIdle)
            if self.absent != str(error):
                log.warning("%s", error)
            self.absent = str(error)
            self._retry_wall_s = wall_s() + RETRY_S
            return
        if not self._ours:
            self._opened()
        elif self.simulated:
            send_abort(self._port, self._firmware)
            self._opened()
        else:
            self._reset()  # opening alone resets no board whose last host left DTR up, as ours do

    @property
    def _ours(self) -> bool:
        """Whether what moves and heats there is ours to stop."""
        return self.session is not None or self.state.hot

    def begin(self, session: Session) -> None:
        """Let a session have the board, from a reset on."""
        self.session = session
        self.stuck = None
        self.idle.reset()
        self._go_on((), self._clock.now())

    def cancel(self, reason: str) -> None:
        """End the open print safely."""
        if self.session is not None:
            now_s = self._clock.now()
            self.session.cancel(reason, now_s)
            self._go_on((), now_s)

    def pause(self, wanted: bool) -> None:
        """Have the open print wait, or go on."""
        if self.session is not None:
            now_s = self._clock.now()
            (self.session.pause if wanted else self.session.resume)(now_s)
            self._go_on((), now_s)

    def end_by(self, at_s: float | None) -> None:
        """End the open print safely where it has not ended by then."""
        if self.session is not None:
            now_s = self._clock.now()
            self.session.end_by(at_s, now_s)
            self._go_on((), now_s)

    def clear_attention(self) -> None:
        """A person saw to the printer: whatever was the matter is over."""
        if self.idle.card:
            raise AgentError(CARD)
        self.state.bed_unknown_reason = self.stuck = None
        self.state.hot = False
        well = self.state.attention_reason is None and self.link.phase is not Phase.DEAD
        self.state.attention_reason = None
        if not (well and (self.proven or self.refuted) and self._port is not None):
            self.prove()

    @property
    def proven(self) -> bool:
        """Whether DTR was seen to reset the board behind this port."""
        return self.simulated or self.state.reset_verified == self._url

    @property
    def refuted(self) -> bool:
        """Whether DTR was seen not to reset it."""
        return not self.proven and self.state.reset_failed == self._url

    def prove(self) -> None:
        """Reset the board, and see whether it starts again; somebody has said that it does not print.

        Raises
        ------
        AgentError
            It prints.
        """
        if self.session is not None or self.idle.card:
            raise AgentError(CARD if self.idle.card else "it prints")
        self._said_idle = True
        self.state.reset_verified = self.state.reset_failed = None
        if self._port is None:
            self.open()
        if self._port is not None:
            self._reset()
        if self._port is not None:
            self.proving = PULSES
        else:
            self._said_idle = False  # that was said of a printer that is not there
        self.stirred = True

    def cut(self) -> None:
        """Switch everything off by a reset, where heat of ours may be on: the agent is about to end."""
        if self._port is None or not self._ours:
            return
        (send_abort_until_accepted if self.refuted else send_abort)(self._port, self._firmware)
        with suppress(PortError):
            self._port.reset()

    def close(self) -> None:
        """Give the port up."""
        if self._port is not None:
            self._port.close()
            self._port = None

    # --- the emulator's own word ---

    def status(self) -> EmulatorStatus | None:
        """Read the status of an emulator; None for a real printer, which has none."""
        if not self.simulated:
            return None
        try:
            return read_status(self._folder)
        except PortError:
            return None

    def clear_bed(self) -> None:
        """Take what was printed off an emulator's bed.

        Raises
        ------
        PortError
            The emulator does not answer.
        """
        if self.simulated:
            control(self._folder, "clear_bed")

    # --- inside ---

    def _go_on(self, events: Events, now_s: float) -> None:
        self.stirred = True
        for event in events:
            self._notice(event, now_s)
        if self.session is not None:
            self._advance(self.session, events, now_s)
        self._remember()
        out = self.link.take()
        if self._port is not None and (out or self._port.unwritten):
            try:
                self._port.write(out)
            except PortError as error:
                self._gone(error)

    def _advance(self, session: Session, events: Events, now_s: float) -> None:
        session.advance(events, now_s)
        while session.context.wants_reset and self._port is not None and not session.context.ended:
            self._remember()
            self._reset()
            session.advance((), now_s)

    def _notice(self, event: Event, now_s: float) -> None:
        if isinstance(event, Report):
            self.report = event
            if self.session is None:
                self._idle_report(event, now_s)
        elif isinstance(event, Up):
            log.info("the board answers%s", " after a reset" if event.restarted else "")
            self._answers(event)
        elif isinstance(event, Said):
            understood, cause = self.idle.said(event.text) if self.session is None else (False, None)
            if cause is not None:
                self._lose_track(cause)
            if not understood:
                log.info("board: %s", event.text.decode("ascii", "replace"))
        else:
            log.warning("board: %s (%s)", event.text, event.fault)
            if event.fault is Fault.REBOOT:
                self.resets += 1
            if self.session is None:
                self._idle_trouble(event, now_s)

    def _answers(self, up: Up) -> None:
        """See whether the pulse of DTR before had reset the board."""
        self.idle.reset()
        if up.restarted and (self.proving or self.session is not None):
            self.state.reset_verified, self.state.reset_failed = self._url, None
        elif self.proving > 1:
            self.proving -= 1
            self._reset()  # its `start` may have been lost on the way
            return
        elif self.proving:
            log.warning("%s", NO_RESET)
            self.state.reset_failed = self._url
        self.proving = 0

    def _idle_report(self, report: Report, now_s: float) -> None:
        self.state.hot = self.state.hot and not report.off
        cause, trouble = self.idle.report(report)
        if cause is not None:
            self._lose_track(cause)
        self.stuck = self.stuck if trouble is None else trouble.text
        self.back = self.back or self.idle.cold
        if self.link.drained:
            # what a port that went left hot, and no reset ends; asking alone would feed the dead-man for ever
            firmware = self._firmware
            self.link.send(now_s, *(firmware.heaters_off if self.state.hot else firmware.idle_queries))

    def _idle_trouble(self, trouble: Trouble, now_s: float) -> None:
        if trouble.fault is Fault.REBOOT:
            self._lose_track("its board was reset, and not by the farm")
            self.link.restarted(now_s)
        elif trouble.fault in (Fault.NO_ANSWER, Fault.NOISY_LINE):
            self._gone(PortError(f"{self._url}: {trouble.text}; is the printer switched on?"))
        elif trouble.fault is Fault.MAXTEMP:  # nothing of ours heats: it burns, or nobody can tell
            self.stuck = f"both heaters are off, and the board says {trouble.text.lstrip(' :')}"
        else:
            self.state.attention_reason = trouble.text

    def _opened(self) -> None:
        assert self._port is not None
        self.back = self.back or (self.absent is not None and self.session is None)
        self.absent = None
        self.untouched = False
        self.report = self.stuck = None
        self.idle.reset()
        if self.session is None:
            self.link.poll_every_s = self.pace.idle_s
        else:
            self.session.port_was_reset()
        self.link.opened(self._clock.now(), self._firmware.abort_unnumbered if self._ours else b"")
        self._moved(self._port.fileno())

    def _reset(self) -> None:
        assert self._port is not None
        self._moved(None)
        if self._ours:
            send_abort(self._port, self._firmware)  # a reset that does not get through is noticed late
        try:
            self._port.reset()
        except PortError as error:
            self._gone(error)
            return
        self._opened()

    def _lose_track(self, reason: str) -> None:
        """Bed and filament are not known any more; the first reason is kept."""
        if self.state.bed_unknown_reason is None:
            log.warning("not known to be clear any more: %s", reason)
            self.state.bed_unknown_reason = reason

    def _gone(self, error: PortError) -> None:
        log.warning("%s", error)
        if self.session is None and self.absent is None:
            self._lose_track("its port went away: it may have been used meanwhile")
        self._moved(None)
        self.close()
        self.absent = str(error)
        self.report = None
        self._said_idle, self.proving = False, 0
        self.link.closed()
        self._retry_wall_s = wall_s() + RETRY_S
        session = self.session
        if session is not None and not session.context.wants_reset:
            session.fail(Fault.PORT_LOST, str(error), self._clock.now())
        self._remember()
