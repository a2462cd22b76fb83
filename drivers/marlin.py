"""The serial protocol of the Ultimaker 2+ firmware, without I/O: bytes and the time in, bytes and events out.

Theory of operation (um2-serial sections 1, 3 and 7; all of it holds over a wire that loses and garbles
bytes):

1. Lines are numbered and checksummed, and ONE is in flight. The firmware carries out a number once: what is
   sent twice is refused with the number that it wants, so to send the last line again is always safe.
2. That holds for M105 too: a bare one with one flipped bit may be an M1, which never comes back.
3. A plain ``ok`` is the answer to a line, ``ok T:`` that to M105; they are never taken for each other. A
   lost or doubled ok makes the link at most a few lines early or late; the firmware's next refusal names
   the right number, and the last lines are kept to go back to (`outbox`).
4. ``Resend`` comes with an ``ok`` of its own, and is obeyed after that. ``No Line Number`` comes with
   neither, and is obeyed at once.
5. On silence the line is sent again. Where it was only late, as behind a long move, its double is refused
   while the next line is in flight; the link then waits for that one's ok, or doubles would go on for ever.
6. A board that asks twice for a number further back than the history has lost its count: it was reset.
7. Where more than 5 % of the lines have to be sent again the link gives up: with an 8-bit checksum some of
   the garbled lines would be carried out.
"""

from __future__ import annotations

import math
from collections import deque
from enum import StrEnum

from drivers import replies
from drivers.errors import Fault
from drivers.outbox import Outbox, Source
from drivers.replies import Event, Events, Report, Said, Trouble, Up, checksum, frame

__all__ = [
    "Event",
    "Events",
    "Link",
    "Phase",
    "Report",
    "Said",
    "Source",
    "Trouble",
    "Up",
    "checksum",
    "frame",
]

NOISE_RESENDS, NOISE_LINES = 10, 200  # 10 repeats in 200 lines: 5 %
TRIES = 4
START_S = 10.0  # from the opening of the port to ``start``; the bootloader takes one
HAIL_S = 0.3  # to the first question, where a board may not start at all
QUIET_S = 1.0  # after ``start``: time for the rest of the banner
LINE_S = 10.0  # doubled each time that a line was only late: one ok a move, and a slow one takes longer
LONGEST_LINE_S = 80.0
HINT_S = 1.0  # after something that could not be read and may have been an ok
_LONGEST_ANSWER = 512


class Phase(StrEnum):
    """Where the link stands."""

    CLOSED = "closed"
    OPENING = "opening"  # waits for ``start``
    BANNER = "banner"  # waits for the end of it
    LIVE = "live"
    DEAD = "dead"  # trouble: nothing is sent, and nothing heard


class Link:
    """The conversation with one board.

    Call `opened` when the port was opened, `receive` with what it says, `tick` when `deadline_s` has come,
    and write what `take` gives after each of them and after `send` and `stream`.

    Parameters
    ----------
    floor_s
        No time-out is shorter, in seconds of the caller's clock: where that clock runs faster than the
        wall's, the host's own scheduling must not look like a silent board.
    """

    def __init__(self, floor_s: float = 0.0) -> None:
        self._floor_s = floor_s
        self.poll_every_s = math.inf
        self.only_ask = False  # go on over troubles of the firmware: a stopped board still answers M105
        self._reset()

    def _reset(self) -> None:
        self.phase = Phase.CLOSED
        self._out = b""
        self._hail = b""  # while it opens: words that the board must have heard, started anew or not
        self._refused = False  # they may be lost
        self._partial = b""
        self._banner = b""
        self._restarted = False
        self._due_s = math.inf  # of what is in flight, or of the phase
        self._poll_s = math.inf
        self._waiting = False  # for the ok of the line at the cursor
        self._doubled = -1  # the last line that was sent again on silence
        self._wanted = -1  # a Resend, until its ok comes
        self._far = -1  # a Resend that is not believed yet
        self._tries = 0
        self._line_s = LINE_S
        self._repeats: deque[int] = deque(maxlen=NOISE_RESENDS)
        self.repeated = 0
        self._outbox = Outbox()

    # --- what the caller wants ---

    def opened(self, now_s: float, hail: bytes = b"") -> None:
        """Forget all that was known of the board: the port was opened or reset.

        Parameters
        ----------
        hail
            Commands that were just sent to a board that may not start anew. It is asked at once whether it
            does, and told them again where it refuses a line or is silent.
        """
        self._reset()
        self.phase = Phase.OPENING
        self._hail = hail
        self._due_s = now_s + (self._hail_s if hail else max(START_S, self._floor_s))

    @property
    def _hail_s(self) -> float:
        return max(HAIL_S, self._floor_s / 8)

    def restarted(self, now_s: float) -> None:
        """The board started by itself, and that is all right: go on with its banner."""
        self._reset()
        self.phase = Phase.BANNER
        self._restarted = True
        self._due_s = now_s + max(QUIET_S, self._floor_s / 4)

    def closed(self) -> None:
        """The port is gone."""
        self._reset()

    def send(self, now_s: float, *commands: bytes) -> None:
        """Queue commands behind those that wait; not while a program is streamed (`halt` it first)."""
        if self._outbox.streaming:
            raise ValueError("a program is under way: halt it first")
        self._outbox.queue(commands)
        self._go(now_s)

    def stream(self, now_s: float, source: Source, start: int, stop: int) -> None:
        """Send lines `start` to `stop` of a program, after all that was queued."""
        self._outbox.stream(source, start, stop)
        self._go(now_s)

    def halt(self) -> None:
        """Forget what was not sent yet; the line in flight stays."""
        self._outbox.halt()

    def poll(self, now_s: float) -> None:
        """Ask for a report as soon as the wire is free."""
        self._poll_s = now_s
        self._go(now_s)

    def poll_soon(self, at_s: float) -> None:
        """Ask for a report at `at_s` at the latest."""
        self._poll_s = min(self._poll_s, at_s)

    def take(self) -> bytes:
        """What is to be written now."""
        out, self._out = self._out, b""
        return out

    @property
    def drained(self) -> bool:
        """Every line was acknowledged; a poll may be under way."""
        return not (self._waiting or self._outbox.ahead)

    @property
    def streamed(self) -> int:
        """Lines of the program that were acknowledged, counted from its first line."""
        return self._outbox.streamed(self._waiting)

    @property
    def deadline_s(self) -> float:
        """When `tick` wants to be called."""
        if self.phase is Phase.LIVE and not self._waiting:
            return self._poll_s
        return self._due_s  # of what is in flight, or of the phase; never where the link is closed or dead

    # --- what the board says ---

    def receive(self, data: bytes, now_s: float) -> Events | None:
        """Take bytes from the port. Never raises, whatever they are.

        None says that the next line of the program is on its way and there is nothing else to look at.
        """
        # The one path that has to be cheap: the ok to a line of a program, and the next line is encoded
        # already.
        if (
            data == b"ok\n"
            and self._waiting
            and not self._partial
            and now_s < self._poll_s
            and self._wanted < 0
        ):
            line = self._outbox.quick()
            if line is not None:
                self._tries = 0
                self._out = line
                self._due_s = now_s + max(self._line_s, self._floor_s)
                return None
        *heard, self._partial = (self._partial + data).split(b"\n")
        if len(self._partial) > _LONGEST_ANSWER:
            self._partial = b""
        events: list[Event] = []
        for words in heard:
            self._hear(words, now_s, events)
        return events

    def _hear(self, line: bytes, now_s: float, events: list[Event]) -> None:
        if self.phase in (Phase.OPENING, Phase.BANNER):
            self._hear_boot(line, now_s, events)
        elif self.phase is not Phase.LIVE:
            pass  # closed, or dead: what comes now is of no use
        elif line.endswith(b"start"):  # a reset puts noise before it
            self._give_up(Fault.REBOOT, "the board started again by itself", events)
        elif line.startswith(b"ok"):
            if line != b"ok" and (self._asked or b"T:" in line):
                self._hear_report(line, now_s, events)
            elif self._wanted >= 0 or not self._asked:
                self._hear_ok(now_s, events)
        elif (number := replies.wanted(line)) is not None:
            self._hear_resend(number, now_s, events)
        elif (number := replies.unnumbered(line)) is not None:
            self._hear_resend(number + 1, now_s, events)
            if self._wanted >= 0:
                self._hear_ok(now_s, events)
        elif (trouble := replies.trouble(line)) is not None:
            self._give_up(trouble.fault, trouble.text, events)
        elif line.endswith(b"ok") and self._waiting:  # M119 leaves out a newline
            events.append(Said(line[:-2]))
            self._hear_ok(now_s, events)
        elif line:
            events.append(Said(line))
            if self._waiting and not line.startswith((b"echo:", b"Error:", b"T:")):
                self._due_s = min(self._due_s, now_s + max(HINT_S, self._floor_s / 4))

    def _hear_boot(self, line: bytes, now_s: float, events: list[Event]) -> None:
        if line.endswith(b"start"):
            self._restarted, self._banner = True, b""
            self.phase = Phase.BANNER
            self._due_s = now_s + max(QUIET_S, self._floor_s / 4)
        elif self._restarted:
            self._banner += line + b"\n"
            if b"M301" in line:  # the banner's last line
                self._greet(now_s, events)
        elif self._hail and b"Resend" in line:
            self._refused = True
            self._due_s = now_s
        elif line.startswith(b"ok T:" if self._hail else b"ok") and self._tries:
            self._greet(now_s, events)

    def _greet(self, now_s: float, events: list[Event]) -> None:
        self.phase = Phase.LIVE
        self._tries = 0
        self._poll_s = now_s + self.poll_every_s
        self._outbox.begin()
        events.append(Up(self._restarted, self._banner))
        self._go(now_s)

    def _hear_report(self, line: bytes, now_s: float, events: list[Event]) -> None:
        if (report := replies.report(line)) is not None:
            events.append(report)  # else it is garbled: the next one comes soon
        if self._asked and self._wanted < 0:
            self._landed(now_s)

    @property
    def _asked(self) -> bool:
        """Whether an M105 is in flight."""
        return self._waiting and self._outbox.polls

    def _hear_ok(self, now_s: float, events: list[Event]) -> None:
        if self._wanted >= 0:
            wanted, self._wanted = self._wanted, -1
            number = self._outbox.number
            if wanted == number + 1:  # the line had arrived: this is its ok
                self._landed(now_s)
            elif wanted == number and 0 < number - self._doubled <= 2 and self._doubled >= 0:
                self._line_s = min(2 * self._line_s, LONGEST_LINE_S)
                self._due_s = now_s + self._patience_s()
            else:
                self._repeat(wanted, now_s, events)
        elif self._waiting:
            self._landed(now_s)

    def _landed(self, now_s: float) -> None:
        self._waiting = False
        self._tries = 0
        self._go(now_s)

    def _hear_resend(self, number: int, now_s: float, events: list[Event]) -> None:
        sent = self._outbox.number
        if number > sent + 1 or sent < 0:
            return  # garbled: the time-out brings the right one
        if number == 0 and sent > 0:
            return  # garbled as well, and N0 M110 would have the board count from 1 again
        if not self._outbox.holds(number):
            if self._far == number:
                self._give_up(Fault.REBOOT, "the board has lost its line count: it was reset", events)
            self._far = number
            return
        self._wanted = number
        self._waiting = True
        self._due_s = now_s + max(HINT_S, self._floor_s / 2)

    # --- time ---

    def tick(self, now_s: float) -> Events:
        """Look whether something is due."""
        if now_s < self.deadline_s:
            return ()
        events: list[Event] = []
        if self.phase is Phase.BANNER:
            self._greet(now_s, events)
        elif self._wanted >= 0:
            self._hear_ok(now_s, events)  # its ok was lost
        elif self._waiting or self.phase is Phase.OPENING:
            self._tries += 1
            if self._tries > TRIES:
                self._give_up(Fault.NO_ANSWER, "the board does not answer", events)
            elif self._waiting:
                self._doubled = self._outbox.number
                self._repeat(self._doubled, now_s, events)
            else:  # it did not restart, and nobody knows its line number
                if self._refused or self._tries > 1:
                    self._out += self._hail
                self._refused = False
                self._out += b"M105\n"
                self._due_s = now_s + max(START_S if self._hail else START_S / 2, self._floor_s)
        else:
            self._go(now_s)
        return events

    # --- sending ---

    def _go(self, now_s: float) -> None:
        """Send the next thing, where nothing is in flight."""
        if self._waiting or self.phase is not Phase.LIVE:
            return
        if now_s >= self._poll_s:
            self._outbox.insert_poll()
            self._poll_s = now_s + self.poll_every_s
        line = self._outbox.step()
        if line is not None:
            self._launch(line, now_s)

    def _launch(self, line: bytes, now_s: float) -> None:
        self._waiting = True
        self._out += line
        self._due_s = now_s + self._patience_s()

    def _patience_s(self) -> float:
        return max(self._outbox.patience_s(self._line_s), self._line_s, self._floor_s)

    def _repeat(self, number: int, now_s: float, events: list[Event]) -> None:
        self.repeated += 1
        self._repeats.append(self._outbox.number)
        if len(self._repeats) == NOISE_RESENDS and number - self._repeats[0] < NOISE_LINES:
            self._give_up(Fault.NOISY_LINE, f"{NOISE_RESENDS} lines of {NOISE_LINES} sent again", events)
            return
        self._launch(self._outbox.back_to(number), now_s)

    def _give_up(self, fault: Fault, text: str, events: list[Event]) -> None:
        if self.phase is Phase.DEAD:
            return
        events.append(Trouble(fault, text))
        if self.only_ask and fault not in (Fault.NO_ANSWER, Fault.REBOOT, Fault.NOISY_LINE):
            return
        self.halt()
        self.phase = Phase.DEAD
        self._waiting = False
        self._wanted = -1
        self._due_s = math.inf
