"""Decisions of a link that does not know which line the board accepted last. Pure.

A link asks (`Recovery.ask`) and hands on what is answered; a `Verdict` says what it has to do.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from typing import NamedTuple

from drivers.firmware import Firmware

CONFIRMATIONS = 3  # the board carries out a line between two answers, and holds two at most
NOISE_REPAIRS, NOISE_LINES = 10, 200  # 5 %
TRIES = 4
ASKS = 4  # more may not fit into the board's ring behind a line


class Place(NamedTuple):
    """Place of a link among its lines.

    Attributes
    ----------
    number
        Of the line in flight.
    repeated
        Lines that were sent again so far.
    top
        The highest number that was sent so far.
    confirmations
        Answers before that the line in flight was accepted.
    """

    number: int
    repeated: int
    top: int
    confirmations: int


class Action(Enum):
    """Action of a link on an answer."""

    TAKE_FOR_REFUSAL = "nothing was asked: a line has lost its number"
    IGNORE = "the question is out of date, and so is its line"
    ASK_SOON = "the question is out of date, its line is not"
    ASK_AGAIN = "it is not believed yet"
    GIVE_UP_NOISY = "it is another one each time"
    GIVE_UP_REBOOT = "the board has lost its count"
    WAIT = "the line was accepted, and waits its turn, or its ok was lost"
    ACCEPT = "the line was accepted, and its ok was lost"
    ACCEPT_UP_TO = "what was to be sent again was accepted up to this line"
    REPEAT = "everything from this line on is sent again"


class Verdict(NamedTuple):
    """An action, and the line that it is about."""

    action: Action
    line: int = -1


class Recovery:
    """Questions and answers since the line in flight was sent.

    Attributes
    ----------
    asks
        Questions since the board was last understood.
    confirmations
        Answers that the line in flight, which is no move, was accepted.
    wanted
        The number of the last Resend since; negative where there was none.
    sent_s, at_work_s
        When the line in flight was sent, and when the board last said that it was at work.
    """

    def __init__(self) -> None:
        self.asks = self.confirmations = 0
        self.wanted = -1
        self.sent_s = self.at_work_s = self._asked_s = -math.inf
        self._questions: deque[Place] = deque(maxlen=2 * ASKS)  # not answered yet
        self._unbelieved = -1  # a last line that was said once,
        self._contradictions = 0  # and how often that was another one
        self._repairs: deque[int] = deque(maxlen=NOISE_REPAIRS)

    def launch(self, now_s: float) -> None:
        """A line was sent, and nothing is known of it yet."""
        self.asks = self.confirmations = 0
        self.sent_s = now_s

    @property
    def alive_s(self) -> float:
        """When the line in flight was sent, or the board last said that it was at work on it."""
        return max(self.sent_s, self.at_work_s)

    def count_needed(self, firmware: Firmware, moves: bool, patience_s: float) -> float:
        """Count the answers after which the ok of a line that was accepted is taken for lost.

        A board that says so where it is at work is at rest where it was silent before it was asked.

        Parameters
        ----------
        moves
            The line in flight is a move.
        patience_s
            Time within which the board says that it is at work.
        """
        if firmware.keep_alive is not None:
            return 1 if self._asked_s >= self.alive_s + patience_s else math.inf
        return 1 if firmware.acknowledges_read_moves and moves else CONFIRMATIONS

    def ask(self, place: Place, now_s: float) -> None:
        """A question was sent."""
        self._asked_s = now_s
        self.asks += 1
        self._questions.append(place)

    def refuse(self, wanted: int) -> bool:
        """Take a refusal (negative: it names no line); whether a question need not be sent at once."""
        asked = wanted < 0 or bool(self._questions)
        if wanted >= 0:
            self.wanted = wanted
            self._questions.clear()  # the ring was emptied, with all that were in it
            self.asks = min(self.asks, 1)
        return asked

    def match_answer(self, last: int, place: Place, waiting: bool) -> Action | None:
        """Find the question that is answered; None where it was asked at this very place: `settle` it."""
        questions = self._questions
        while questions and 0 < questions[0].top < last:
            questions.popleft()  # its answer was lost
        if not questions:
            return Action.TAKE_FOR_REFUSAL
        question = questions.popleft()
        if question == place and waiting:
            return None
        return Action.ASK_SOON if question.number == place.number else Action.IGNORE

    def forget_questions(self) -> None:
        """What was asked is not answered any more: it was lost."""
        self._questions.clear()

    def settle(self, last: int, place: Place, confirmations: float, held: bool) -> Verdict:
        """Decide; the board had accepted line `last` when all of ours had reached it.

        Parameters
        ----------
        last, place
            The answer, and where the link stands.
        confirmations
            Answers after which the ok of a line that was accepted is taken for lost.
        held
            Line `last` + 1 can be sent again.
        """
        number, top = place.number, place.top
        self.asks = 0
        if number > 0 and last not in (number - 1, number, self._unbelieved):
            self._unbelieved = last
            self._contradictions += 1
            return Verdict(Action.GIVE_UP_NOISY if self._contradictions > TRIES else Action.ASK_AGAIN)
        self._unbelieved = self.wanted = -1
        self._contradictions = 0
        if last == number:
            self.confirmations += 1
            return Verdict(Action.ACCEPT if self.confirmations >= confirmations else Action.WAIT)
        if number == 0:
            return Verdict(Action.REPEAT, 0)  # it had not heard that it has to count from 0
        if number < last <= top:
            return Verdict(Action.ACCEPT_UP_TO, last)
        if last > top or last < 0 or not held:
            return Verdict(Action.GIVE_UP_REBOOT)
        return Verdict(Action.REPEAT, last + 1)

    def count_repair(self, number: int) -> bool:
        """Count a line that did not get through, or whose ok did not; False where these are too many."""
        self._repairs.append(number)
        return len(self._repairs) < NOISE_REPAIRS or number - self._repairs[0] >= NOISE_LINES
