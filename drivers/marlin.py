"""The serial protocol of the Ultimaker 2+ firmware, without I/O: bytes and the time in, bytes and events out.

Theory of operation (um2-serial sections 1, 3 and 7; all of it holds over a wire that loses and garbles
bytes):

1. Lines are numbered and checksummed, and ONE is in flight. The firmware carries out a number once: what is
   sent twice is refused with the number that it wants, so to send the last line again is always safe.
2. That holds for M105 too: a bare one with one flipped bit may be an M1, which never comes back.
3. A plain ``ok`` is the answer to a line, ``ok T:`` that to M105; they are never taken for each other. A
   lost or doubled ok makes the link at most a few lines early or late; the firmware's next refusal names
   the right number, and the last `HISTORY_LINES` lines are kept to go back to.
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
from collections.abc import Callable
from enum import StrEnum

from drivers import replies
from drivers.errors import Fault
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

HISTORY_LINES = 32
NOISE_RESENDS, NOISE_LINES = 10, 200  # 10 repeats in 200 lines: 5 %
TRIES = 4
START_S = 10.0  # from the opening of the port to ``start``; the bootloader takes one
QUIET_S = 1.0  # after ``start``: time for the rest of the banner
LINE_S = 10.0  # doubled each time that a line was only late: one ok a move, and a slow one takes longer
LONGEST_LINE_S = 80.0
POLL_S = 30.0  # it waits its turn behind up to 8 slow moves
HINT_S = 1.0  # after something that could not be read and may have been an ok
_BLOCK_LINES = 256
_LONGEST_ANSWER = 512

_PATIENCE_S = {  # those that wait for all moves before them
    b"G28": 300.0, b"G4": 600.0, b"M400": 600.0, b"M401": 60.0, b"M84": 600.0, b"M18": 600.0,
}  # fmt: skip

Source = Callable[[int, int], list[bytes]]
"""Lines `start` to `stop` of a program."""


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
        # frames[i] is line number base + i; up to the cursor they were sent, those after it are encoded
        # ahead.
        self._frames: list[bytes] = []
        self._base = 1
        self._cursor = -1
        self._patience: dict[int, float] = {}  # of lines that may take long
        self._polls: set[int] = set()  # lines that are M105
        self._careful = 0  # up to this number lines may be special, or were sent before
        self._queue: deque[bytes] = deque()
        self._source: Source | None = None
        self._source_at = self._source_stop = 0  # next line of the program to encode
        self._source_number = 1  # the line number of the program's first line of this run,
        self._source_start = 0  # and its place there

    # --- what the caller wants ---

    def opened(self, now_s: float) -> None:
        """The port was opened or reset: all that was known of the board is void."""
        self._reset()
        self.phase = Phase.OPENING
        self._due_s = now_s + max(START_S, self._floor_s)

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
        if self._source is not None and self._source_at < self._source_stop:
            raise ValueError("a program is under way: halt it first")
        self._queue.extend(commands)
        self._go(now_s)

    def stream(self, now_s: float, source: Source, start: int, stop: int) -> None:
        """Send lines `start` to `stop` of a program, after all that was queued."""
        self._source, self._source_start, self._source_at, self._source_stop = source, start, start, stop
        self._source_number = self._base + len(self._frames) + len(self._queue)
        self._go(now_s)

    def halt(self) -> None:
        """Forget what was not sent yet; the line in flight stays."""
        sent = self._cursor + 1
        done = self._source_start + self._base + sent - self._source_number
        self._source_stop = min(max(done, self._source_start), self._source_stop)
        self._source = None
        self._queue.clear()
        del self._frames[sent:]
        self._patience = {n: s for n, s in self._patience.items() if n < self._base + sent}

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
        return not (self._waiting or self._ahead)

    @property
    def streamed(self) -> int:
        """Lines of the program that were acknowledged, counted from its first line."""
        number = self._base + self._cursor  # in flight, or the last acknowledged
        number -= self._waiting and number not in self._polls  # an M105 is no line of a program
        done = self._source_start + number - self._source_number + 1
        return min(max(done, self._source_start), self._source_stop)

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
        if data == b"ok\n" and self._waiting and not self._partial and now_s < self._poll_s:
            ahead = self._cursor + 1
            if ahead < len(self._frames) and self._wanted < 0 and self._base + self._cursor > self._careful:
                self._cursor = ahead
                self._tries = 0
                self._out = self._frames[ahead]
                self._due_s = now_s + max(self._line_s, self._floor_s)
                return None
        *lines, self._partial = (self._partial + data).split(b"\n")
        if len(self._partial) > _LONGEST_ANSWER:
            self._partial = b""
        events: list[Event] = []
        for line in lines:
            self._hear(line, now_s, events)
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
        elif line.startswith(b"ok") and self._tries:
            self._greet(now_s, events)

    def _greet(self, now_s: float, events: list[Event]) -> None:
        self.phase = Phase.LIVE
        self._tries = 0
        self._poll_s = now_s + self.poll_every_s
        self._base, self._cursor, self._frames = 0, -1, []
        self._queue.appendleft(b"M110")  # goes out as N0, so that the next is 1
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
        return self._waiting and self._base + self._cursor in self._polls

    def _hear_ok(self, now_s: float, events: list[Event]) -> None:
        if self._wanted >= 0:
            at, self._wanted = self._wanted - self._base, -1
            if at == self._cursor + 1:  # the line had arrived: this is its ok
                self._landed(now_s)
            elif at == self._cursor and 0 < self._base + at - self._doubled <= 2 and self._doubled >= 0:
                self._line_s = min(2 * self._line_s, LONGEST_LINE_S)
                self._due_s = now_s + self._patience_s()
            else:
                self._repeat(at, now_s, events)
        elif self._waiting:
            self._landed(now_s)

    def _landed(self, now_s: float) -> None:
        self._waiting = False
        self._tries = 0
        self._go(now_s)

    def _hear_resend(self, number: int, now_s: float, events: list[Event]) -> None:
        at = number - self._base
        if at > self._cursor + 1 or self._cursor < 0:
            return  # garbled: the time-out brings the right one
        if number == 0 and self._base + self._cursor > 0:
            return  # garbled as well, and N0 M110 would have the board count from 1 again
        if at < 0 or self._cursor - at >= HISTORY_LINES:
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
                self._doubled = self._base + self._cursor
                self._repeat(self._cursor, now_s, events)
            else:  # it did not restart, and nobody knows its line number
                self._out += b"M105\n"
                self._due_s = now_s + max(START_S / 2, self._floor_s)
        else:
            self._go(now_s)
        return events

    # --- sending ---

    @property
    def _ahead(self) -> bool:
        return (
            self._cursor + 1 < len(self._frames)
            or bool(self._queue)
            or (self._source is not None and self._source_at < self._source_stop)
        )

    def _go(self, now_s: float) -> None:
        """Send the next thing, where nothing is in flight."""
        if self._waiting or self.phase is not Phase.LIVE:
            return
        if now_s >= self._poll_s:
            self._insert_poll()
            self._poll_s = now_s + self.poll_every_s
        if self._cursor + 1 >= len(self._frames):
            self._encode_ahead()
        if self._cursor + 1 < len(self._frames):
            self._cursor += 1
            self._launch(now_s)

    def _launch(self, now_s: float) -> None:
        self._waiting = True
        self._out += self._frames[self._cursor]
        self._due_s = now_s + self._patience_s()

    def _patience_s(self) -> float:
        number = self._base + self._cursor
        patience_s = POLL_S if number in self._polls else self._patience.get(number, self._line_s)
        return max(patience_s, self._line_s, self._floor_s)

    def _insert_poll(self) -> None:
        """Put an M105 before all that is encoded ahead, which gets new numbers."""
        sent = self._cursor + 1
        number = self._base + sent
        ahead = self._frames[sent:]
        del self._frames[sent:]
        self._frames.append(frame(number, b"M105"))
        self._polls = {n for n in self._polls if n >= self._base}
        self._polls = {n + (n >= number) for n in self._polls} | {number}
        self._patience = {n + (n >= number): s for n, s in self._patience.items()}
        if self._source_number + self._source_stop - self._source_start > number:
            self._source_number += 1  # the program, or the rest of it, comes behind
        for at, old in enumerate(ahead, number + 1):
            self._frames.append(frame(at, old[old.index(b" ") + 1 : old.rindex(b"*")]))
        self._careful = max(self._careful + 1, self._base + sent)

    def _repeat(self, at: int, now_s: float, events: list[Event]) -> None:
        self.repeated += 1
        number = self._base + at
        self._repeats.append(self._base + self._cursor)
        if len(self._repeats) == NOISE_RESENDS and number - self._repeats[0] < NOISE_LINES:
            self._give_up(Fault.NOISY_LINE, f"{NOISE_RESENDS} lines of {NOISE_LINES} sent again", events)
            return
        self._careful = max(self._careful, self._base + self._cursor)
        self._cursor = at
        self._launch(now_s)

    def _encode_ahead(self) -> None:
        """Encode a block of lines; called where all that was encoded is sent."""
        spare = len(self._frames) - HISTORY_LINES
        if spare > 0:
            del self._frames[:spare]
            self._base += spare
            self._cursor -= spare
            self._patience = {n: s for n, s in self._patience.items() if n >= self._base}
        number = self._base + len(self._frames)
        commands: list[bytes] = []
        if self._queue:
            commands = [*self._queue]
            self._queue.clear()
        elif self._source is not None:
            stop = min(self._source_at + _BLOCK_LINES, self._source_stop)
            commands = self._source(self._source_at, stop)
            self._source_at = stop
        for command in commands:
            if not command.startswith((b"G1 ", b"G0 ")):
                patience_s = _PATIENCE_S.get(command.split(b" ", 1)[0])
                if patience_s is not None:
                    self._patience[number] = patience_s
                    self._careful = number
            self._frames.append(frame(number, command))
            number += 1

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
