"""Marlin's serial protocol without I/O; the package's docstring has the theory of operation.

The class is longer than others because each of its methods changes the state of the one exchange of lines.
"""

from __future__ import annotations

import math

from drivers.errors import Fault, UnreadableFile
from drivers.firmware import Firmware
from drivers.link import replies
from drivers.link.opening import Opening, OpeningLine, Phase
from drivers.link.outbox import Outbox, Source
from drivers.link.recovery import MAX_QUERIES, NOISE_LINES, NOISE_REPAIRS, Action, Place, Recovery
from drivers.link.replies import BoardConnected, Event, Events, LinkFault, UnknownLine

SILENT_REASON = "the board does not answer"
SILENCE_S = 0.3  # silence before the first query; doubled with each query
KEEP_ALIVE_SILENCE_S = 1.4  # replaces SILENCE_S if the firmware sends a busy message every second
QUERY_DELAY_S = 0.05  # time until a query after an unreadable line, which may have been an ok
_MAX_ANSWER_BYTES = 512


class Link:
    """Protocol state of the connection to one board.

    Call `on_opened` after opening the port, `receive` with the bytes read, and `tick` at `deadline_s`. After
    each of these, and after `send` and `stream`, write the bytes that `take` returns. `take_line_after_ok`
    may be called before `receive`: it is quicker, and usually suffices while a program is streamed.

    Parameters
    ----------
    firmware
        The board's firmware.
    min_timeout_s
        Lower bound of all timeouts, in seconds of the caller's clock: if that clock runs faster than wall
        time, the host's own scheduling must not look like a silent board.
    """

    def __init__(self, firmware: Firmware, min_timeout_s: float = 0.0) -> None:
        self._firmware = firmware
        self._min_timeout_s = min_timeout_s
        keeps_alive = firmware.busy_prefix is not None
        shortest_s, divisor = (KEEP_ALIVE_SILENCE_S, 4) if keeps_alive else (SILENCE_S, 8)
        self._silence_s = max(shortest_s, min_timeout_s / divisor)
        self._query_delay_s = max(QUERY_DELAY_S, min_timeout_s / 40)
        self.poll_interval_s = math.inf
        self.ignore_faults = False  # True to ignore reported faults: a stopped board still answers M105
        self._reset()

    def _reset(self) -> None:
        self.phase = Phase.CLOSED
        self._output = b""
        self._opening = Opening(self._firmware, self._min_timeout_s)
        self._partial_line = b""
        self._due_s = math.inf  # time at which the line in flight, or the phase, times out
        self._poll_at_s = math.inf
        self._awaits_ok = False  # True while the line at the cursor has not been acknowledged
        self._is_undisturbed = True  # no query and no refusal since the line in flight was sent
        self._is_refused = False  # oks are ignored until the board reports its last line
        self._answer: int | None = None  # a reported last line, until the rest of its answer has arrived
        self._answer_s = math.inf  # time at which that answer is complete
        self._recovery = Recovery()
        self.resend_count = 0
        self._outbox = Outbox(self._firmware)

    # --- called by the owner ---

    def on_opened(self, now_s: float, unconfirmed_commands: bytes = b"") -> None:
        """Reset the state of the link after the port was opened or reset.

        Parameters
        ----------
        now_s
            Time of the opening or the reset.
        unconfirmed_commands
            Commands that were just sent and that the board may have missed. The link queries the board at
            once; if it refuses a line or is silent, they are sent again.
        """
        self._reset()
        self.phase = Phase.OPENING
        self._opening = Opening(self._firmware, self._min_timeout_s, unconfirmed_commands)
        self._due_s = now_s + self._opening.first_query_delay_s

    def on_restarted(self, now_s: float) -> None:
        """Accept an unrequested restart of the board, and continue by reading its banner."""
        self._reset()
        self.phase = Phase.BANNER
        self._opening.has_restarted = True
        self._due_s = now_s + self._opening.banner_timeout_s

    def on_closed(self) -> None:
        """Stop, as the port was closed."""
        self._reset()

    def send(self, now_s: float, *commands: bytes) -> None:
        """Append commands to the queue. Raises ValueError while a program is streamed."""
        if self._outbox.is_streaming:
            raise ValueError("a program is being streamed: drop its unsent lines first")
        self._outbox.queue(commands)
        self._send_next(now_s)

    def stream(self, now_s: float, source: Source, start: int, stop: int) -> None:
        """Send lines `start` to `stop` of a program after the queued commands."""
        self._outbox.stream(source, start, stop)
        self._send_next(now_s)

    def drop_unsent(self) -> None:
        """Drop all unsent lines; the line in flight stays."""
        self._outbox.drop_unsent()

    def poll(self, now_s: float) -> None:
        """Request a temperature report as soon as no line is in flight."""
        self._poll_at_s = now_s
        self._send_next(now_s)

    def poll_soon(self, at_s: float) -> None:
        """Request a temperature report at `at_s` at the latest."""
        self._poll_at_s = min(self._poll_at_s, at_s)

    def take(self) -> bytes:
        """Return the bytes to write now, and clear them."""
        data, self._output = self._output, b""
        return data

    @property
    def is_drained(self) -> bool:
        """True if every line was acknowledged; an M105 may be in flight."""
        return not (self._awaits_ok or self._outbox.has_unsent)

    @property
    def streamed_line_count(self) -> int:
        """Number of acknowledged lines of the program, counted from its first line."""
        return self._outbox.count_streamed_lines(self._awaits_ok)

    @property
    def source_error(self) -> UnreadableFile | None:
        """Error that ended the stream: the program could not be read."""
        return self._outbox.source_error

    @property
    def deadline_s(self) -> float:
        """Time of the next call of `tick`."""
        if self._answer is not None:
            return self._answer_s
        if self.phase is Phase.LIVE and not self._awaits_ok:
            return self._poll_at_s
        return self._due_s  # of the line in flight, or of the phase; infinite if the link is closed or dead

    # --- messages of the board ---

    def take_line_after_ok(self, data: bytes, now_s: float) -> bytes | None:
        """Return the next line to write, if `data` is just the ok to a line of a program.

        Returns None, without an effect, if there is more to do, or if the next line is not encoded yet: then
        call `receive`.
        """
        is_usual = self._awaits_ok and self._is_undisturbed and not self._partial_line
        if data != b"ok\n" or not is_usual or now_s >= self._poll_at_s:
            return None
        line = self._outbox.take_encoded_line()
        if line is not None:
            self._recovery.sent_s = now_s
            self._due_s = now_s + self._silence_s
        return line

    def receive(self, data: bytes, now_s: float) -> Events:
        """Process bytes from the port. Never raises, even for invalid bytes."""
        *lines, self._partial_line = (self._partial_line + data).split(b"\n")
        if len(self._partial_line) > _MAX_ANSWER_BYTES:
            self._partial_line = b""
        events: list[Event] = []
        for line in lines:
            self._handle_line(line, now_s, events)
        return events

    def _handle_line(self, line: bytes, now_s: float, events: list[Event]) -> None:
        if self.phase in (Phase.OPENING, Phase.BANNER):
            self._handle_boot_line(line, now_s, events)
        elif self.phase is not Phase.LIVE:
            pass  # closed, or dead: ignore
        elif line.endswith(b"start"):  # a reset may put noise in front of it
            self._give_up(Fault.REBOOT, "the board restarted by itself", events)
        else:
            for answer in replies.split_answers(line, self._firmware):
                if self.phase is Phase.LIVE:
                    self._handle_answer(answer, now_s, events)

    def _handle_answer(self, answer: bytes, now_s: float, events: list[Event]) -> None:
        if (number := replies.parse_ok(answer, self._firmware)) is not None:
            if not self._is_poll_in_flight and self._answer is None and number in (-1, self._outbox.number):
                self._handle_ok(now_s)
        elif answer.startswith(b"ok"):
            self._handle_report(answer, now_s, events)
        elif (number := replies.parse_resend(answer)) is not None:
            if self._answer is None:
                self._handle_refusal(number, now_s)
        elif (number := replies.parse_last_line(answer, self._firmware)) is not None:
            if self._firmware.last_line_query_causes_resend:
                self._answer, self._answer_s = number, now_s + self._query_delay_s
                self._is_undisturbed = False
            else:
                self._handle_last_line(number, now_s, events)
        elif replies.is_refusal(answer):
            self._handle_refusal(-1, now_s)  # a Resend follows, unless it was lost
        elif (fault := replies.parse_fault(answer, self._firmware)) is not None:
            self._give_up(fault.fault, fault.text, events)
        elif (alive := self._firmware.busy_prefix) is not None and answer.startswith(alive):
            self._handle_busy(now_s, events)
        elif answer:
            events.append(UnknownLine(answer))
            if not answer.startswith((b"echo:", b"Error:", b"T:")):
                self._schedule_query(now_s)

    def _handle_boot_line(self, line: bytes, now_s: float, events: list[Event]) -> None:
        kind = self._opening.classify_line(line)
        if kind is OpeningLine.BANNER:
            self.phase = Phase.BANNER
            self._due_s = now_s + self._opening.banner_timeout_s
        elif kind is OpeningLine.REFUSAL:
            self._due_s = now_s
        elif kind is OpeningLine.READY:
            self._go_live(now_s, events)

    def _go_live(self, now_s: float, events: list[Event]) -> None:
        self.phase = Phase.LIVE
        self._is_refused = self._opening.is_refused
        self._poll_at_s = now_s + self.poll_interval_s
        self._outbox.begin()
        events.append(BoardConnected(self._opening.has_restarted, self._opening.banner))
        self._send_next(now_s)

    def _handle_report(self, line: bytes, now_s: float, events: list[Event]) -> None:
        if (report := replies.parse_report(line)) is not None:
            events.append(report)  # otherwise it is garbled; the next one follows soon
        if self._is_poll_in_flight:
            self._handle_ok(now_s)

    @property
    def _is_poll_in_flight(self) -> bool:
        """True while an M105 is in flight."""
        return self._awaits_ok and self._outbox.is_poll

    def _handle_ok(self, now_s: float) -> None:
        if self._awaits_ok and not self._is_refused:
            self._accept_line(now_s)

    def _accept_line(self, now_s: float) -> None:
        """Note that the line in flight was accepted, and stop waiting for it."""
        self._awaits_ok = self._is_refused = False
        self._is_undisturbed = True
        self._send_next(now_s)

    def _handle_refusal(self, number: int, now_s: float) -> None:
        """Handle a refused line; anything sent after it may be lost."""
        if self._outbox.number < 0:
            return
        self._awaits_ok = self._is_refused = True
        self._is_undisturbed = False
        if self._recovery.note_refusal(number):
            self._schedule_query(now_s)
        else:
            self._query(now_s)

    def _handle_busy(self, now_s: float, events: list[Event]) -> None:
        """Handle a busy message: the board executes a long command, so a query would be useless."""
        if not self._awaits_ok:
            return
        if now_s - self._recovery.sent_s > max(self._outbox.timeout_s, 5 * self._min_timeout_s):
            self._give_up(Fault.NO_ANSWER, "the board is busy with one command for too long", events)
        else:
            self._recovery.busy_s = now_s
            self._due_s = max(self._due_s, now_s + self._silence_s)

    def _handle_last_line(self, last_line: int, now_s: float, events: list[Event]) -> None:
        """Handle an answer to a query, or the refusal of a line that lost its number."""
        action = self._recovery.match_answer(last_line, self._place, self._awaits_ok)
        if self._firmware.last_line_query_causes_resend:
            self._recovery.forget_queries()
        if action is None:
            self._apply_answer(last_line, now_s, events)
        elif action is Action.TREAT_AS_REFUSAL:
            self._handle_refusal(-1, now_s)
        elif action is Action.QUERY_SOON:
            self._schedule_query(now_s)

    def _apply_answer(self, last_line: int, now_s: float, events: list[Event]) -> None:
        """Act on an answer, sent after all lines had arrived, with the number of the last accepted line."""
        outbox = self._outbox
        can_resend = outbox.holds(last_line + 1)
        needed_answers = self._recovery.count_needed_answers(self._firmware, outbox.is_move, self._silence_s)
        action, line = self._recovery.decide(last_line, self._place, needed_answers, can_resend)
        if action is Action.QUERY_AGAIN:
            self._query(now_s)
            return
        if action is Action.GIVE_UP_NOISY:
            self._give_up(Fault.NOISY_LINE, "the board reports a different last line each time", events)
            return
        self._is_refused = False
        match action:
            case Action.WAIT if self._firmware.busy_prefix is not None:
                self._due_s = self._recovery.last_progress_s + self._silence_s
            case Action.WAIT:
                self._schedule_query(now_s)
            case Action.ACCEPT:
                if self._count_repair(events):
                    self._accept_line(now_s)
            case Action.ACCEPT_UP_TO:
                outbox.rewind_to(line)
                self._accept_line(now_s)
            case Action.RESEND:
                self.resend_count += 1
                if self._count_repair(events):
                    self._transmit(outbox.rewind_to(line), now_s)
            case _:
                self._give_up(Fault.REBOOT, "the board has lost its line count: it was reset", events)

    # --- time ---

    def tick(self, now_s: float) -> Events:
        """Perform the actions that are due at `now_s`."""
        if now_s < self.deadline_s:
            return ()
        events: list[Event] = []
        if self._answer is not None:
            last_line, self._answer = self._answer, None
            self._handle_last_line(last_line, now_s, events)
        elif self.phase is Phase.BANNER:
            self._go_live(now_s, events)
        elif self._awaits_ok:
            self._query_again(now_s, events)
        elif self.phase is Phase.OPENING:
            if (query := self._opening.take_next_query()) is None:
                self._give_up(Fault.NO_ANSWER, SILENT_REASON, events)
            else:
                self._output += query
                self._due_s = now_s + self._opening.answer_timeout_s
        else:
            self._send_next(now_s)
        return events

    def _query_again(self, now_s: float, events: list[Event]) -> None:
        """Query again, or give up, if no readable answer arrived in time."""
        if self._recovery.query_count >= MAX_QUERIES:
            self._give_up(Fault.NO_ANSWER, SILENT_REASON, events)
        elif self._recovery.resend_number >= 0 and self._recovery.query_count >= 2:
            # The board answers no queries, so its Resend has to be trusted.
            self._apply_answer(self._recovery.resend_number - 1, now_s, events)
        else:
            self._query(now_s)

    def _query(self, now_s: float) -> None:
        """Query the number of the last line that the board accepted."""
        self._is_undisturbed = False
        self._recovery.note_query(self._place, now_s)
        self._output += self._firmware.last_line_query
        wait_s = self._silence_s * 2**self._recovery.query_count
        if self._recovery.query_count == MAX_QUERIES:
            wait_s = max(self._outbox.timeout_s, 5 * self._min_timeout_s) - (wait_s - self._silence_s)
        self._due_s = now_s + wait_s

    def _schedule_query(self, now_s: float) -> None:
        """Schedule a query soon, if a line is in flight and the board's receive buffer can hold a query."""
        if self._awaits_ok and self._recovery.query_count < MAX_QUERIES:
            self._due_s = min(self._due_s, now_s + self._query_delay_s)

    @property
    def _place(self) -> Place:
        """Place of the last sent line; an answer to a query from another place is out of date."""
        confirmation_count = self._recovery.confirmation_count
        return Place(self._outbox.number, self.resend_count, self._outbox.highest_number, confirmation_count)

    # --- sending ---

    def _send_next(self, now_s: float) -> None:
        """Send the next line if none is in flight."""
        if self._awaits_ok or self.phase is not Phase.LIVE:
            return
        if now_s >= self._poll_at_s and self._outbox.is_next_unsent:
            self._outbox.insert_poll()
            self._poll_at_s = now_s + self.poll_interval_s
        line = self._outbox.take_next()
        if line is not None:
            self._transmit(line, now_s)

    def _transmit(self, line: bytes, now_s: float) -> None:
        self._awaits_ok = self._is_undisturbed = True
        self._recovery.start_line(now_s)
        self._output += line
        self._due_s = now_s + self._silence_s

    def _count_repair(self, events: list[Event]) -> bool:
        """Count a line that was lost, or whose ok was; return False if the link gives up after too many."""
        if not self._recovery.count_repair(self._outbox.number):
            text = f"{NOISE_REPAIRS} of {NOISE_LINES} lines or their answers were lost"
            self._give_up(Fault.NOISY_LINE, text, events)
        return self.phase is Phase.LIVE

    def _give_up(self, fault: Fault, text: str, events: list[Event]) -> None:
        if self.phase is Phase.DEAD:
            return
        events.append(LinkFault(fault, text))
        if self.ignore_faults and fault not in (Fault.NO_ANSWER, Fault.REBOOT, Fault.NOISY_LINE):
            return
        self.drop_unsent()
        self.phase = Phase.DEAD
        self._awaits_ok = self._is_refused = False
        self._recovery.resend_number = -1
        self._answer = None
        self._due_s = math.inf
