"""State of a board in an agent's journal. Pure."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class BoardState(BaseModel):
    """The state of a board that outlives its agent. The board owns it; it is journalled whole.

    Attributes
    ----------
    attention_reason
        Why a person has to see to the printer, until they did.
    bed_unknown_reason
        What happened at the printer that this farm did not cause, until a person has cleared its bed.
    hot
        Heat of ours may still be on.
    opened
        The device, as it was plugged in, that was opened last (`port.plugged_in`).
    reset_verified
        The port over which DTR was seen to reset the board.
    reset_refuted
        The port over which it was seen not to: what prints there is stopped by command only.
    """

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)

    attention_reason: str | None = Field(default=None, alias="look")
    bed_unknown_reason: str | None = Field(default=None, alias="doubt")
    hot: bool = False
    opened: str | None = None
    reset_verified: str | None = None
    reset_refuted: str | None = None

    def record(self) -> dict[str, Any]:
        """Dump it under the names that journals have had from the first."""
        return self.model_dump(by_alias=True)

    def updated(self, record: dict[str, Any]) -> BoardState:
        """Copy it with what a record of the journal says of it. Raises ValueError."""
        known = self.record()
        return self.model_validate(known | {name: record[name] for name in known.keys() & record.keys()})
