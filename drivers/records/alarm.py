"""The record of a heater that cannot be switched off. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A heater that may be stuck on, and since when, in seconds of the farm's clock."""

    text: str
    since_s: float


class Alarm(BaseModel):
    """A finding, from its moment until a person has seen to the printer; kept in the journal.

    Attributes
    ----------
    text
        The finding.
    at_s
        When it was found, on the farm's clock.
    asked
        The mains are to be cut for it.
    said
        What came of that; None: not known yet, and the command is run (again) by whoever reads this.
    over
        The printer was cold or away since then: a heater that is stuck on now is another finding.
    """

    model_config = ConfigDict(frozen=True)

    text: str
    at_s: float
    asked: bool = False
    said: str | None = None
    over: bool = False

    @property
    def pending(self) -> bool:
        """Whether the mains are to be cut, and nobody knows yet what came of it."""
        return self.asked and self.said is None

    @property
    def open(self) -> bool:
        """Whether the heater may still be seen to cool, and nothing is to be cut then."""
        return not self.asked

    @property
    def message(self) -> str | None:
        """For people; None once it is over."""
        return None if self.over else "; ".join(filter(None, (self.text, self.said)))

    @property
    def suspicion(self) -> Suspicion | None:
        """The suspicion that a session after it has to know."""
        return Suspicion(self.text, self.at_s) if self.open else None
