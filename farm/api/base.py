"""Base class of requests and responses, and types and constants that they share."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, AliasChoices, BaseModel, ConfigDict, Field

from farm.text import flatten_text

SCHEMA = 1
NETWORK_PREFIX = "/api/v1"
"""Prefix of the paths on the network; paths on the Unix socket have none."""
Line = Annotated[str, AfterValidator(flatten_text)]
"""One line of free text, which a user wrote and which is shown to others."""

EXPECTED_S = Field(
    validation_alias=AliasChoices("estimated_s", "expected_s"), serialization_alias="estimated_s"
)
"""Field `expected_s` of a job or plate. In JSON, its name is `estimated_s`."""


class View(BaseModel):
    """Base class of requests and responses; an unknown field is an error."""

    model_config = ConfigDict(extra="forbid")
