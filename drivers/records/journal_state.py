"""State of an agent, which its journal stores. Pure.

Records keep the field names of the first version; renamed fields have an alias.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from drivers.messages import Filament, PrintSnapshot

MAX_RECENT_PRINTS = 1000  # number of ended prints in memory; more than a printer ends in a week


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A heater that may be stuck on, and the time of the finding, in seconds of the farm's clock."""

    text: str
    found_s: float


class Alarm(BaseModel):
    """Alarm about a heater that may be stuck on, until a person has checked the printer.

    Attributes
    ----------
    text
        The finding.
    at_s
        Time of the finding, in seconds of the farm's clock.
    power_off_requested
        True if the mains are to be cut.
    outcome
        Outcome of the command that cuts the mains; None if it is unknown, and then the next agent runs the
        command again.
    is_over
        True if the printer has been cold or disconnected since then: a heater that is stuck now is a new
        finding.
    """

    model_config = ConfigDict(frozen=True, validate_by_name=True, validate_by_alias=True)

    text: str
    at_s: float
    power_off_requested: bool = Field(default=False, alias="asked")
    outcome: str | None = Field(default=None, alias="said")
    is_over: bool = Field(default=False, alias="over")

    @property
    def is_pending(self) -> bool:
        """True while the mains are to be cut and the outcome is unknown."""
        return self.power_off_requested and self.outcome is None

    @property
    def is_suspicion(self) -> bool:
        """True while the heater may still be seen to cool, and the mains need not be cut yet."""
        return not self.power_off_requested

    @property
    def message(self) -> str | None:
        """User-facing sentence; None once the alarm is over."""
        return None if self.is_over else "; ".join(filter(None, (self.text, self.outcome)))

    @property
    def suspicion(self) -> Suspicion | None:
        """Suspicion that the next session takes over."""
        return Suspicion(self.text, self.at_s) if self.is_suspicion else None

    def dump_record(self) -> dict[str, Any]:
        """Dump the alarm under the names in the journal."""
        return self.model_dump(mode="json", by_alias=True)


class BoardState(BaseModel):
    """State of a board that outlives its agent. `Board` owns it; the journal stores all of it.

    Attributes
    ----------
    attention_reason
        Reason for which a person has to check the printer, until that is done.
    bed_unknown_reason
        Event at the printer that the farm did not cause, until a person has cleared the bed.
    hot
        True if a heater that the farm switched on may still be on.
    rest_position
        Answer of the idle printer to the position query since its last print; None if unknown.
    device_id
        The device that was opened last (`identify_device`).
    verified_reset_port
        The port at which DTR was confirmed to reset the board.
    failed_reset_port
        The port at which DTR did not reset the board: a print there can be stopped only by command.
    """

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)

    attention_reason: str | None = Field(default=None, alias="look")
    bed_unknown_reason: str | None = Field(default=None, alias="doubt")
    hot: bool = False
    rest_position: str | None = Field(default=None, alias="rest")
    device_id: str | None = Field(default=None, alias="opened")
    verified_reset_port: str | None = Field(default=None, alias="reset_verified")
    failed_reset_port: str | None = Field(default=None, alias="reset_refuted")

    def dump_record(self) -> dict[str, Any]:
        """Dump the state under the names in the journal."""
        return self.model_dump(by_alias=True)

    def copy_with_changes(self, record: dict[str, Any]) -> BoardState:
        """Return a copy with the changes in a record of the journal. Raises ValueError."""
        present = self.dump_record()
        return self.model_validate(present | {name: record[name] for name in present.keys() & record.keys()})


@dataclass(slots=True)
class JournalState:
    """The state after all records of a journal.

    Attributes
    ----------
    print
        The last print; open unless its phase is final.
    filament
        Position of the filament's tip.
    alarm
        Alarm about a heater that could not be switched off, until a person has checked the printer.
    board
        State of the board.
    identity
        Identity of the printer (`SessionContext.identity`); None until a session has read it.
    ended_print_ids
        Ids of all ended prints, which are never started again.
    recent_prints
        The last of these prints, up to `MAX_RECENT_PRINTS`.
    """

    print: PrintSnapshot | None = None
    filament: Filament = Filament.UNKNOWN
    alarm: Alarm | None = None
    board: BoardState = field(default_factory=BoardState)
    identity: str | None = None
    ended_print_ids: set[str] = field(default_factory=set)
    recent_prints: deque[PrintSnapshot] = field(default_factory=lambda: deque(maxlen=MAX_RECENT_PRINTS))

    @property
    def may_be_hot(self) -> bool:
        """True if the last agent may have left a heater on."""
        has_alarm = self.alarm is not None and (self.alarm.is_pending or self.alarm.is_suspicion)
        return self.board.hot or has_alarm or (self.print is not None and not self.print.phase.ended)

    def apply(self, record: dict[str, Any]) -> None:
        """Apply one record. Raises ValueError, TypeError or AttributeError if it is invalid."""
        if "print" in record:
            fields = record["print"]
            self.print = PrintSnapshot.model_validate(fields) if fields is not None else None
            if (
                self.print is not None
                and self.print.phase.ended
                and self.print.print_id not in self.ended_print_ids
            ):
                self.ended_print_ids.add(self.print.print_id)
                self.recent_prints.append(self.print)
        if "filament" in record:
            self.filament = Filament(record["filament"])
        if "alarm" in record:
            fields = record["alarm"]
            self.alarm = Alarm.model_validate(fields) if fields is not None else None
        self.board = self.board.copy_with_changes(record)
        if "identity" in record:
            self.identity = record["identity"]

    def list_records(self) -> Iterator[dict[str, Any]]:
        """Yield the fewest records that restore this state; of the ended prints, only the recent ones."""
        for ended_print in self.recent_prints:
            yield {"at_s": ended_print.ended_s, "print": ended_print.model_dump(mode="json")}
        yield {
            "at_s": None if self.print is None else self.print.ended_s,
            "print": None if self.print is None else self.print.model_dump(mode="json"),
            "filament": self.filament.value,
            "alarm": None if self.alarm is None else self.alarm.dump_record(),
            **self.board.dump_record(),
            "identity": self.identity,
        }
