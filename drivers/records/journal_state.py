"""The state of an agent that its journal keeps. Pure.

Records keep the names under which the first version wrote them; fields with another name have an alias.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from drivers.messages import Filament, PrintSnapshot

RECENT_PRINTS = 1000  # ended prints that are kept in memory: more than a week's


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A heater that may be stuck on, and since when, in seconds of the farm's clock."""

    text: str
    since_s: float


class Alarm(BaseModel):
    """A heater that may be stuck on, from the finding until a person has checked the printer.

    Attributes
    ----------
    text
        The finding.
    at_s
        Time of the finding, in seconds of the farm's clock.
    power_off_requested
        The mains are to be cut.
    outcome
        Outcome of cutting the mains; None: not known, and the next agent runs the command again.
    over
        The printer was cold or away since then: a heater that is stuck on now is another finding.
    """

    model_config = ConfigDict(frozen=True, validate_by_name=True, validate_by_alias=True)

    text: str
    at_s: float
    power_off_requested: bool = Field(default=False, alias="asked")
    outcome: str | None = Field(default=None, alias="said")
    over: bool = False

    @property
    def pending(self) -> bool:
        """True while the mains are to be cut and the outcome is not known."""
        return self.power_off_requested and self.outcome is None

    @property
    def suspected(self) -> bool:
        """True while the heater may still be seen to cool, and nothing is cut."""
        return not self.power_off_requested

    @property
    def message(self) -> str | None:
        """Sentence for people; None once the alarm is over."""
        return None if self.over else "; ".join(filter(None, (self.text, self.outcome)))

    @property
    def suspicion(self) -> Suspicion | None:
        """Suspicion that the next session continues with."""
        return Suspicion(self.text, self.at_s) if self.suspected else None

    def record(self) -> dict[str, Any]:
        """Dump the alarm under the names in the journal."""
        return self.model_dump(mode="json", by_alias=True)


class BoardState(BaseModel):
    """The state of a board that outlives its agent. The board owns it; it is journalled whole.

    Attributes
    ----------
    attention_reason
        Reason for a person to check the printer, until they have.
    bed_unknown_reason
        Event at the printer that the farm did not cause, until a person has cleared the bed.
    hot
        A heater may still be on because of the farm.
    opened
        The device that was opened last (`identify_device`).
    reset_verified
        The port over which DTR was seen to reset the board.
    reset_failed
        The port over which it was seen not to: a print there is stopped by command only.
    """

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)

    attention_reason: str | None = Field(default=None, alias="look")
    bed_unknown_reason: str | None = Field(default=None, alias="doubt")
    hot: bool = False
    opened: str | None = None
    reset_verified: str | None = None
    reset_failed: str | None = Field(default=None, alias="reset_refuted")

    def record(self) -> dict[str, Any]:
        """Dump the state under the names in the journal."""
        return self.model_dump(by_alias=True)

    def updated(self, record: dict[str, Any]) -> BoardState:
        """Copy the state with the changes in a record of the journal. Raises ValueError."""
        known = self.record()
        return self.model_validate(known | {name: record[name] for name in known.keys() & record.keys()})


@dataclass(slots=True)
class JournalState:
    """The state after all records of a journal.

    Attributes
    ----------
    print
        The last print; open unless its phase is an end.
    filament
        Place of the filament's end.
    alarm
        A heater that could not be switched off, until a person has checked the printer.
    board
        State of the board.
    identity
        Identity of the printer (`SessionContext.identity`); None until it was first seen.
    ended
        Ids of ended prints: none of them is started again.
    recent
        The last of them.
    """

    print: PrintSnapshot | None = None
    filament: Filament = Filament.UNKNOWN
    alarm: Alarm | None = None
    board: BoardState = field(default_factory=BoardState)
    identity: str | None = None
    ended: set[str] = field(default_factory=set)
    recent: deque[PrintSnapshot] = field(default_factory=lambda: deque(maxlen=RECENT_PRINTS))

    @property
    def may_be_hot(self) -> bool:
        """True where the last agent may have left a heater on."""
        alarmed = self.alarm is not None and (self.alarm.pending or self.alarm.suspected)
        return self.board.hot or alarmed or (self.print is not None and not self.print.phase.ended)

    def apply(self, record: dict[str, Any]) -> None:
        """Apply one record. Raises ValueError, TypeError or AttributeError where it is none."""
        if "print" in record:
            known = record["print"]
            self.print = PrintSnapshot.model_validate(known) if known is not None else None
            if self.print is not None and self.print.phase.ended and self.print.print_id not in self.ended:
                self.ended.add(self.print.print_id)
                self.recent.append(self.print)
        if "filament" in record:
            self.filament = Filament(record["filament"])
        if "alarm" in record:
            known = record["alarm"]
            self.alarm = Alarm.model_validate(known) if known is not None else None
        self.board = self.board.updated(record)
        if "identity" in record:
            self.identity = record["identity"]
