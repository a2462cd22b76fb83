"""Base of requests and responses."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict

from farm.text import flatten_text

SCHEMA = 1
NETWORK_PREFIX = "/api/v1"
"""Prefix of the paths on the network; paths on the Unix socket have none."""
Line = Annotated[str, AfterValidator(flatten_text)]
"""Free text written by a user and shown to others."""


class View(BaseModel):
    """Request or response without unknown fields."""

    model_config = ConfigDict(extra="forbid")
