"""Board of one printer: its port, its link and, during a print, its session."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers.agent.emulator_control import EmulatorControl
from drivers.agent.idle_watch import SD_PRINT_REASON, IdleWatch
from drivers.clock import Clock, read_wall_s
from drivers.errors import AgentError, Fault, IdleNotConfirmed, PortError
from drivers.link import BoardConnected, Event, Events, Link, LinkFault, Phase, Report, UnknownLine
from drivers.ports import Port, WireRecord, identify_device, open_port
from drivers.printers import Profile
from drivers.records import BoardState
from drivers.safety import send_abort, send_abort_until_accepted
from drivers.session import Pace, Session

log = logging.getLogger(__name__)

RETRY_INTERVAL_S = 2.0  # wall seconds between attempts to open a port
RESET_PULSE_COUNT = 2  # number of DTR pulses; the answer to one may be lost
NOT_WATCHED_REASON = "it was not watched before its agent was started"
MAY_PRINT_REASON = (
    "its port is opened only after a person confirms that it is not printing: opening may reset the board"
)
MAXTEMP_CAUSE = "both targets are 0, so a heater is stuck on or a sensor is broken"
NO_RESET_REASON = "a pulse of DTR does not reset its board: it prints only while somebody is present"


class Board:
    """One printer's board behind its port.

    Parameters
    ----------
    url
        The port, as in `fleet.yaml`.
    profile
        The printer's model.
    folder
        Folder of the emulator of a ``sim://`` port.
    clock
        The farm's clock.
    save
        Function that writes the journal; called after each change and before bytes are written to the port.
    on_port_change
        Function that is called with the new descriptor of the port, or None if the port was disconnected.

    Attributes
    ----------
    link, session, report
        Link to the board; session of the open print, if any; the last temperatures, if known.
    absent_reason, needs_idle_confirmation
        Reason for which the port is not open; True if a person has to confirm first that the printer is idle.
    state
        State that outlives the agent.
    reset_count
        Number of resets that the agent did not cause.
    stuck_heater_text
        Finding that a heater of the idle board is off but is getting hotter; the recorder handles it.
    alarm_is_over
        True if the printer was reconnected or has cooled; a later finding raises a new alarm.
    idle_watch, emulator, wire_record
        Watch over the idle board; access to the emulator, if any; record of the last bytes on the port.
    has_changed
        True if anything other than the next line of a program has changed.
    """

    def __init__(
        self,
        url: str,
        profile: Profile,
        folder: Path,
        clock: Clock,
        save: Callable[[], None],
        on_port_change: Callable[[int | None], None],
    ) -> None:
        self.is_simulated = url.startswith("sim://")
        self.pace = Pace.from_clock(clock)
        self.profile, self._firmware = profile, profile.firmware
        self.link = Link(self._firmware, self.pace.min_timeout_s)
        self.session: Session | None = None
        self.report: Report | None = None
        self.absent_reason: str | None = "the port has not been opened yet"
        self.needs_idle_confirmation = False
        self.state = BoardState()
        self.reset_count = 0
        self.stuck_heater_text: str | None = None
        self.alarm_is_over = self.has_changed = False
        self.idle_watch = IdleWatch()
        self.emulator = EmulatorControl(folder if self.is_simulated else None)
        self._url, self._folder, self._clock = url, folder, clock
        self._save, self._on_port_change = save, on_port_change
        self._port: Port | None = None
        self.wire_record = WireRecord(clock.now)
        self._retry_wall_s = 0.0
        self._is_idle_confirmed = False  # True if a person has confirmed that the printer is idle
        self._pulses_left = 0  # DTR pulses left before the reset counts as failed

    # --- called by the loop ---

    def on_readable(self, _: int = 0) -> None:
        """Read bytes from the port, and process them."""
        port = self._port
        if port is None:
            return
        try:
            data = port.read()
            now_s = self._clock.now()
            line = self.link.take_line_after_ok(data, now_s)
            if line is not None:
                port.write(line)
                return
        except PortError as error:
            self._on_port_lost(error)
            return
        self._process_events(self.link.receive(data, now_s), now_s)

    def tick(self) -> None:
        """Perform the actions that are due now."""
        if self._port is None and read_wall_s() >= self._retry_wall_s:
            self.open()
        now_s = self._clock.now()
        self._process_events(self.link.tick(now_s), now_s)

    def compute_wake_wall_s(self) -> float:
        """Return the wall time of the next call of `tick`."""
        due_s = self.link.deadline_s
        if self.session is not None:
            due_s = min(due_s, self.session.deadline_s)
        wall_s = self._clock.to_wall_s(due_s)
        return min(wall_s, self._retry_wall_s) if self._port is None else wall_s

    def open(self) -> None:
        """Open the port, which may reset the board. If that fails, `tick` tries again.

        The first opening after a device was plugged in raises DTR, and the printer cannot be queried before
        that. So the port is opened only after a person has confirmed that the printer is not printing.
        """
        try:
            device = identify_device(self._url)
            is_same_device = device is not None and device == self.state.device_id
            if not (self.is_simulated or self._is_responsible or self._is_idle_confirmed or is_same_device):
                raise IdleNotConfirmed(MAY_PRINT_REASON)
            if not is_same_device:
                self.idle_watch.filament_watch.note_reset()
            baud_rate = self._firmware.baud_rate
            self._port = open_port(self._url, self._folder, self._clock, baud_rate, self.wire_record)
            self.state.device_id = device
        except PortError as error:
            self.needs_idle_confirmation = isinstance(error, IdleNotConfirmed)
            if self.absent_reason != str(error):
                log.warning("%s", error)
            self.absent_reason = str(error)
            self._retry_wall_s = read_wall_s() + RETRY_INTERVAL_S
            return
        if not self._is_responsible:
            self._on_opened()
        elif self.is_simulated:
            send_abort(self._port, self._firmware)
            self._on_opened()
        else:
            self._reset_board()  # opening does not reset the board if the last host left DTR up, as agents do

    @property
    def _is_responsible(self) -> bool:
        """True if this agent is responsible for motion and heat on the board."""
        return self.session is not None or self.state.hot

    def begin(self, session: Session) -> None:
        """Start a session, which begins with a reset of the board."""
        self.session = session
        self.stuck_heater_text = None
        self.idle_watch.reset()
        self._process_events((), self._clock.now())

    def cancel(self, reason: str) -> None:
        """End the open print safely."""
        self._call_session(lambda session, now_s: session.cancel(reason, now_s))

    def set_paused(self, is_paused: bool) -> None:
        """Pause or resume the open print."""
        self._call_session(lambda session, now_s: (session.pause if is_paused else session.resume)(now_s))

    def set_ends_by(self, at_s: float | None) -> None:
        """Set the time at which the open print is ended safely; None for no limit."""
        self._call_session(lambda session, now_s: session.set_ends_by(at_s, now_s))

    def _call_session(self, action: Callable[[Session, float], None]) -> None:
        if self.session is not None:
            now_s = self._clock.now()
            action(self.session, now_s)
            self._process_events((), now_s)

    def clear_attention(self) -> None:
        """Clear all findings, as a person has checked; reset the board if its reset is not verified.

        Raises
        ------
        AgentError
            The printer is printing from its SD card.
        """
        if self.idle_watch.is_printing_from_card:
            raise AgentError(SD_PRINT_REASON)
        self.state.bed_unknown_reason = self.stuck_heater_text = None
        self.state.hot = False
        was_ready = self.state.attention_reason is None and self.link.phase is not Phase.DEAD
        self.state.attention_reason = None
        if not (was_ready and (self.reset_verified or self.reset_failed) and self._port is not None):
            self.verify_reset()

    @property
    def reset_verified(self) -> bool:
        """True if DTR was confirmed to reset the board behind this port."""
        return self.is_simulated or self.state.verified_reset_port == self._url

    @property
    def reset_failed(self) -> bool:
        """True if DTR was found not to reset the board behind this port."""
        return not self.reset_verified and self.state.failed_reset_port == self._url

    @property
    def is_verifying_reset(self) -> bool:
        """True while waiting for the answer to a pulse of DTR."""
        return self._pulses_left > 0

    def verify_reset(self) -> None:
        """Reset the board to verify that it restarts; a person has confirmed that it is idle.

        Raises
        ------
        AgentError
            The board is printing.
        """
        if self.session is not None or self.idle_watch.is_printing_from_card:
            raise AgentError(SD_PRINT_REASON if self.idle_watch.is_printing_from_card else "it is printing")
        self._is_idle_confirmed = True
        self.state.verified_reset_port = self.state.failed_reset_port = None
        if self._port is None:
            self.open()
        if self._port is not None:
            self._reset_board()
        if self._port is not None:
            self._pulses_left = RESET_PULSE_COUNT
        else:
            self._is_idle_confirmed = False  # the confirmed printer is no longer connected
        self.has_changed = True

    def switch_off_heaters(self) -> None:
        """Switch heaters and motors off by a reset before the agent ends, if the agent may have used them."""
        if self._port is None or not self._is_responsible:
            return
        (send_abort_until_accepted if self.reset_failed else send_abort)(self._port, self._firmware)
        with suppress(PortError):
            self._port.reset()

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
            self._port = None

    # --- events ---

    def _process_events(self, events: Events, now_s: float) -> None:
        self.has_changed = True
        for event in events:
            self._on_event(event, now_s)
        if self.session is not None:
            self._advance_session(self.session, events, now_s)
        self._save()
        data = self.link.take()
        if self._port is not None and (data or self._port.has_unsent_bytes):
            try:
                self._port.write(data)
            except PortError as error:
                self._on_port_lost(error)

    def _advance_session(self, session: Session, events: Events, now_s: float) -> None:
        session.advance(events, now_s)
        while session.context.wants_reset and self._port is not None and not session.context.has_ended:
            self._save()
            self._reset_board()
            session.advance((), now_s)

    def _on_event(self, event: Event, now_s: float) -> None:
        if isinstance(event, Report):
            self.report = event
            if self.session is None:
                self._on_idle_report(event, now_s)
        elif isinstance(event, BoardConnected):
            log.info("the board answers%s", " after a reset" if event.has_restarted else "")
            self._on_connected(event)
        elif isinstance(event, UnknownLine):
            is_known, cause = False, None
            if self.session is None:
                is_known, cause = self.idle_watch.judge_answer(event.text)
            if cause is not None:
                self._mark_bed_unknown(cause)
            if not is_known:
                log.info("board: %s", event.text.decode("ascii", "replace"))
        else:
            log.warning("board: %s (%s)", event.text, event.fault)
            if event.fault is Fault.REBOOT:
                self.reset_count += 1
            if self.session is None:
                self._on_idle_fault(event, now_s)

    def _on_connected(self, event: BoardConnected) -> None:
        """Record whether the last pulse of DTR reset the board."""
        self.idle_watch.reset()
        if event.has_restarted:
            self.idle_watch.filament_watch.note_reset()
        if event.has_restarted and (self._pulses_left or self.session is not None):
            self.state.verified_reset_port, self.state.failed_reset_port = self._url, None
        elif self._pulses_left > 1:
            self._pulses_left -= 1
            self._reset_board()  # the board's `start` may have been lost
            return
        elif self._pulses_left:
            log.warning("%s", NO_RESET_REASON)
            self.state.failed_reset_port = self._url
        self._pulses_left = 0

    def _on_idle_report(self, report: Report, now_s: float) -> None:
        self.state.hot = self.state.hot and not report.targets_off
        cause, fault = self.idle_watch.judge_report(report)
        if cause is not None:
            self._mark_bed_unknown(cause)
        self.stuck_heater_text = self.stuck_heater_text if fault is None else fault.text
        self.alarm_is_over = self.alarm_is_over or self.idle_watch.is_cold
        if self.link.is_drained:
            # Switch off heaters left on when the port was lost: queries alone would reset the dead-man timer.
            firmware = self._firmware
            commands = firmware.heaters_off_commands if self.state.hot else firmware.idle_queries
            self.link.send(now_s, *commands)

    def _on_idle_fault(self, fault: LinkFault, now_s: float) -> None:
        if fault.fault is Fault.REBOOT:
            self._mark_bed_unknown("its board was reset, but not by the farm")
            self.link.on_restarted(now_s)
        elif fault.fault in (Fault.NO_ANSWER, Fault.NOISY_LINE):
            self._on_port_lost(PortError(f"{self._url}: {fault.text}; is the printer switched on?"))
        elif fault.fault is Fault.MAXTEMP:
            self.stuck_heater_text = f"the board reports {fault.text.lstrip(' :')}, and {MAXTEMP_CAUSE}"
        else:
            self.state.attention_reason = fault.text

    def _on_opened(self) -> None:
        assert self._port is not None
        self.alarm_is_over = self.alarm_is_over or (self.absent_reason is not None and self.session is None)
        self.absent_reason = None
        self.needs_idle_confirmation = False
        self.report = self.stuck_heater_text = None
        self.idle_watch.reset()
        if self.session is None:
            self.link.poll_interval_s = self.pace.idle_interval_s
        else:
            self.session.on_port_reset()
        abort_commands = self._firmware.unnumbered_abort if self._is_responsible else b""
        self.link.on_opened(self._clock.now(), abort_commands)
        self._on_port_change(self._port.fileno())

    def _reset_board(self) -> None:
        assert self._port is not None
        self._on_port_change(None)
        self.idle_watch.filament_watch.note_reset()
        if self._is_responsible:
            send_abort(self._port, self._firmware)  # a failed reset is noticed only later
        try:
            self._port.reset()
        except PortError as error:
            self._on_port_lost(error)
            return
        self._on_opened()

    def _mark_bed_unknown(self, reason: str) -> None:
        """Record that the states of bed and filament are unknown, and keep the first reason."""
        self.idle_watch.filament_watch.distrust_journal()
        if self.state.bed_unknown_reason is None:
            log.warning("bed and filament are unknown: %s", reason)
            self.state.bed_unknown_reason = reason

    def _on_port_lost(self, error: PortError) -> None:
        log.warning("%s", error)
        if self.session is None and self.absent_reason is None:
            self._mark_bed_unknown("its port was disconnected: the printer may have been used since")
        self._on_port_change(None)
        self.close()
        self.absent_reason = str(error)
        self.report = None
        self._is_idle_confirmed, self._pulses_left = False, 0
        self.link.on_closed()
        self._retry_wall_s = read_wall_s() + RETRY_INTERVAL_S
        session = self.session
        if session is not None and not session.context.wants_reset:
            session.fail(Fault.PORT_LOST, str(error), self._clock.now())
        self._save()
