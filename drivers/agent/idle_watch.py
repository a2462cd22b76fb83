"""Detection of manual actions, SD prints and faults at an idle board. Pure.

Answers have no checksum, so a finding that a garbled digit could cause must occur twice.
"""

from __future__ import annotations

import re

from drivers.errors import Fault
from drivers.link import LinkFault, Report

SD_PRINT_REASON = "it is printing from its SD card"
MOVED_REASON = "somebody moved its axes or its filament at the printer"
HEATED_REASON = "somebody switched a heater on at the printer"
MAX_COLD_C = 45.0
# A heater is stuck on if its target is 0 and it rises by more than STUCK_RISE_C, to above MIN_STUCK_C.
STUCK_RISE_C, MIN_STUCK_C = 15.0, 60.0

_POSITION = re.compile(rb"X:-?[\d.]+ ?Y:-?[\d.]+ ?Z:-?[\d.]+ ?E:-?[\d.]+ Count")
_SD_ANSWERS = (b"SD printing byte", b"Not SD printing", b"Card error:")


class FilamentWatch:
    """Watch over the filament's position since the last record of the journal.

    After a print the agent records the printer's position. A restarted agent compares it with the printer's
    answer: they differ if the board was reset in between.

    Parameters
    ----------
    is_certain
        True if nothing can have moved the filament since it was recorded.
    rest_position
        Answer to the position query after the last print; None if it is not valid.
    """

    def __init__(self, is_certain: bool = False, rest_position: str | None = None) -> None:
        self.is_certain, self.rest_position = is_certain, rest_position
        self._has_printed = False  # since the last reset; the position proves nothing before a print

    def trust_journal(self) -> None:
        """Trust the journal from now on: a print is beginning, or a person has stated the position."""
        self.is_certain, self.rest_position = True, None

    def note_print(self) -> None:
        """Accept the position at which the printer rests after this print."""
        self._has_printed = True

    def note_reset(self) -> None:
        """Ignore positions until the next print: after a reset, every printer reports the same position."""
        self._has_printed, self.rest_position = False, None

    def distrust_journal(self) -> None:
        """Stop trusting the journal, as a person has used the printer."""
        self.is_certain, self.rest_position = False, None

    def judge_position(self, answer: bytes) -> None:
        """Judge the position at which an idle printer was seen twice."""
        position = answer.decode("ascii", "replace")
        if not self.is_certain:
            self.is_certain = self._has_printed = position == self.rest_position
        self.rest_position = position if self.is_certain and self._has_printed else None


class IdleWatch:
    """Checks of the answers of an idle board, from one reset or print to the next.

    Attributes
    ----------
    filament_watch
        Watch over the position of the filament.
    is_printing_from_card
        True while the printer is printing from its SD card.
    """

    def __init__(self) -> None:
        self.is_printing_from_card = False
        self.filament_watch = FilamentWatch()
        self.reset()

    def reset(self) -> None:
        """Forget all answers: the board was reset, or has printed for the farm."""
        self.is_printing_from_card = False
        self._position: bytes | None = None
        self._first_position: bytes | None = None  # first answer since the reset
        self._unconfirmed_position: bytes | None = None  # last answer that differs from the known position
        self._was_heated = False
        self._coolest_c = [float("inf"), float("inf")]
        self._hot_report_count = 0  # number of consecutive reports with a heater stuck on
        self._cold_report_count = 0  # number of consecutive reports with both off and cold

    @property
    def is_cold(self) -> bool:
        """True if three consecutive reports showed both heaters off and cold."""
        return self._cold_report_count >= 3

    def judge_answer(self, text: bytes) -> tuple[bool, str | None]:
        """Judge an answer to `Firmware.idle_queries`.

        Returns
        -------
        (bool, str | None)
            True if the text answers one of these queries; the event that it shows, if the farm did not cause
            that event.
        """
        if text.startswith(_SD_ANSWERS):
            self.is_printing_from_card = text.startswith(_SD_ANSWERS[0]) or (
                self.is_printing_from_card and text.startswith(_SD_ANSWERS[2])
            )
            return True, SD_PRINT_REASON if self.is_printing_from_card else None
        if _POSITION.match(text) is None:
            return False, None
        if text == self._position:
            self._unconfirmed_position = None
        elif text != self._unconfirmed_position:
            self._first_position = self._first_position or text
            self._unconfirmed_position = text  # a digit may be garbled, even in the first answer
        else:
            has_moved = self._position is not None or not _may_be_garbled(self._first_position or text, text)
            self._position, self._unconfirmed_position = text, None
            self.filament_watch.judge_position(text)
            return True, MOVED_REASON if has_moved else None
        return True, None

    def judge_report(self, report: Report) -> tuple[str | None, LinkFault | None]:
        """Judge a temperature report.

        Returns
        -------
        (str | None, LinkFault | None)
            An event that the farm did not cause; the fault of a heater that is stuck on.
        """
        is_heated = report.nozzle_target_c > 0 or report.bed_target_c > 0
        is_cold = not is_heated and max(report.nozzle_c, report.bed_c) < MAX_COLD_C
        self._cold_report_count = self._cold_report_count + 1 if is_cold else 0
        is_heated_twice, self._was_heated = is_heated and self._was_heated, is_heated
        if is_heated:
            self._coolest_c = [float("inf"), float("inf")]
            self._hot_report_count = 0
            return (HEATED_REASON if is_heated_twice else None), None
        now_c = (report.nozzle_c, report.bed_c)
        self._coolest_c = [min(old_c, new_c) for old_c, new_c in zip(self._coolest_c, now_c, strict=True)]
        is_rising = [
            new_c > max(MIN_STUCK_C, old_c + STUCK_RISE_C)
            for old_c, new_c in zip(self._coolest_c, now_c, strict=True)
        ]
        self._hot_report_count = self._hot_report_count + 1 if any(is_rising) else 0
        if self._hot_report_count < 3:
            return None, None
        heater, at_c = ("nozzle", now_c[0]) if is_rising[0] else ("bed", now_c[1])
        return None, LinkFault(
            Fault.HEATER_STUCK_ON, f"the {heater} is off, but is getting hotter: {at_c:g} C"
        )


def _may_be_garbled(answer: bytes, text: bytes) -> bool:
    """Return True if an answer differs from `text` in at most one byte, as a move of an axis changes more."""
    return len(answer) == len(text) and sum(a != b for a, b in zip(answer, text, strict=True)) < 2
