"""Base of all events."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Event(BaseModel):
    """Change that happened at `at_s` on the farm's clock."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    at_s: float
