"""Recovery of a link that does not know the last line that the board accepted. Pure.

The link sends queries (`Recovery.note_query`) and passes the answers here; a `Decision` is its next action.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from typing import NamedTuple

from drivers.firmware import Firmware

NEEDED_CONFIRMATIONS = 3  # the board executes a line between two answers, and buffers at most two lines
# The link is too noisy at this number of repairs in this number of lines.
NOISE_REPAIRS, NOISE_LINES = 10, 200
MAX_ATTEMPTS = 4  # maximum number of queries to a silent board, and of contradictory answers in a row
MAX_QUERIES = 4  # more queries may not fit into the board's receive buffer behind a line


class Place(NamedTuple):
    """Position of a link in its stream of lines.

    Attributes
    ----------
    number
        Number of the line in flight.
    resend_count
        Number of lines resent so far.
    highest_number
        Highest number sent so far.
    confirmation_count
        Number of earlier answers that confirm the line in flight.
    """

    number: int
    resend_count: int
    highest_number: int
    confirmation_count: int


class Action(Enum):
    """Action of a link after an answer."""

    TREAT_AS_REFUSAL = "no query was sent: a line lost its number"
    IGNORE = "the query and its line are out of date"
    QUERY_SOON = "the query is out of date, but its line is not"
    QUERY_AGAIN = "the answer needs to be confirmed"
    GIVE_UP_NOISY = "each answer differs from the last"
    GIVE_UP_REBOOT = "the board has lost its count"
    WAIT = "the line was accepted: either it is queued, or its ok was lost"
    ACCEPT = "the line was accepted, but its ok was lost"
    ACCEPT_UP_TO = "the lines to be resent were accepted up to this one"
    RESEND = "all lines from this one on are resent"


class Decision(NamedTuple):
    """Action, and the line that it concerns."""

    action: Action
    line: int = -1


class Recovery:
    """Queries and answers since the line in flight was sent.

    Attributes
    ----------
    query_count
        Number of queries since the last readable answer.
    confirmation_count
        Number of answers that confirm the line in flight; counted for lines other than moves.
    resend_number
        Number in the last Resend since then; negative if there was none.
    sent_s, busy_s
        Time at which the line in flight was sent, and time of the last busy message.
    """

    def __init__(self) -> None:
        self.query_count = self.confirmation_count = 0
        self.resend_number = -1
        self.sent_s = self.busy_s = self._queried_s = -math.inf
        self._unanswered_queries: deque[Place] = deque(maxlen=2 * MAX_QUERIES)  # oldest first
        self._unconfirmed_line = -1  # last line that was reported once, and is not yet confirmed
        self._contradiction_count = 0  # number of times that the reported line changed
        self._repairs: deque[int] = deque(maxlen=NOISE_REPAIRS)

    def start_line(self, now_s: float) -> None:
        """Reset the state for a line that was just sent."""
        self.query_count = self.confirmation_count = 0
        self.sent_s = now_s

    @property
    def last_progress_s(self) -> float:
        """Time at which the line in flight was sent or the last busy message arrived, whichever is later."""
        return max(self.sent_s, self.busy_s)

    def count_needed_answers(self, firmware: Firmware, is_move: bool, busy_interval_s: float) -> float:
        """Compute the number of answers after which the ok of an accepted line counts as lost.

        A board with busy messages is idle if it sent none for `busy_interval_s` before the query.

        Parameters
        ----------
        firmware
            The board's firmware.
        is_move
            True if the line in flight is a move.
        busy_interval_s
            Seconds within which a working board sends a busy message.
        """
        if firmware.busy_prefix is not None:
            return 1 if self._queried_s >= self.last_progress_s + busy_interval_s else math.inf
        return 1 if firmware.acknowledges_read_moves and is_move else NEEDED_CONFIRMATIONS

    def note_query(self, place: Place, now_s: float) -> None:
        """Note that a query was sent."""
        self._queried_s = now_s
        self.query_count += 1
        self._unanswered_queries.append(place)

    def note_refusal(self, number: int) -> bool:
        """Note a refusal of a line; return False if a query has to be sent at once.

        Parameters
        ----------
        number
            Number of the line to be resent; negative if the refusal names none.
        """
        is_query_unneeded = number < 0 or bool(self._unanswered_queries)
        if number >= 0:
            self.resend_number = number
            self._unanswered_queries.clear()  # a refusal empties the board's receive buffer
            self.query_count = min(self.query_count, 1)
        return is_query_unneeded

    def match_answer(self, last_line: int, place: Place, awaits_ok: bool) -> Action | None:
        """Match an answer to its query; return None if `decide` has to be called.

        `decide` has to be called if the query was sent at the current place.

        Parameters
        ----------
        last_line, place
            The answer, and the current place of the link.
        awaits_ok
            True if the line in flight has not been acknowledged.
        """
        unanswered_queries = self._unanswered_queries
        while unanswered_queries and 0 < unanswered_queries[0].highest_number < last_line:
            unanswered_queries.popleft()  # its answer was lost
        if not unanswered_queries:
            return Action.TREAT_AS_REFUSAL
        query = unanswered_queries.popleft()
        if query == place and awaits_ok:
            return None
        return Action.QUERY_SOON if query.number == place.number else Action.IGNORE

    def forget_queries(self) -> None:
        """Drop the unanswered queries, which were lost."""
        self._unanswered_queries.clear()

    def decide(self, last_line: int, place: Place, needed_answers: float, can_resend: bool) -> Decision:
        """Decide on an answer, sent after all lines had arrived, with the number of the last accepted line.

        Parameters
        ----------
        last_line, place
            The answer, and the current place of the link.
        needed_answers
            Number of answers after which the ok of an accepted line counts as lost.
        can_resend
            True if line `last_line` + 1 can be sent again.
        """
        number, highest_number = place.number, place.highest_number
        self.query_count = 0
        if number > 0 and last_line not in (number - 1, number, self._unconfirmed_line):
            self._unconfirmed_line = last_line
            self._contradiction_count += 1
            return Decision(
                Action.GIVE_UP_NOISY if self._contradiction_count > MAX_ATTEMPTS else Action.QUERY_AGAIN
            )
        self._unconfirmed_line = self.resend_number = -1
        self._contradiction_count = 0
        if last_line == number:
            self.confirmation_count += 1
            return Decision(Action.ACCEPT if self.confirmation_count >= needed_answers else Action.WAIT)
        if number == 0:
            return Decision(Action.RESEND, 0)  # the M110 that restarts the count was lost
        if number < last_line <= highest_number:
            return Decision(Action.ACCEPT_UP_TO, last_line)
        if last_line > highest_number or last_line < 0 or not can_resend:
            return Decision(Action.GIVE_UP_REBOOT)
        return Decision(Action.RESEND, last_line + 1)

    def count_repair(self, number: int) -> bool:
        """Count a line that was lost, or whose ok was; return False if there are too many."""
        self._repairs.append(number)
        return len(self._repairs) < NOISE_REPAIRS or number - self._repairs[0] >= NOISE_LINES
