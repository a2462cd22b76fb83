"""Base class of the records in the books (the farm's state in the database), and former names of fields."""

from __future__ import annotations

from functools import cache
from typing import TypeVar

from pydantic import AliasChoices, AliasGenerator, BaseModel, ConfigDict

M = TypeVar("M", bound=BaseModel)
FORMER_NAMES = {
    "attention_reason": "look",
    "attention_since_s": "look_s",
    "cancel_reason": "cancel_asked",
    "disconnected_at_s": "lost_s",
    "expected_s": "estimated_s",
    "fail_reason": "fail_asked",
    "family": "kin",
    "pause_requested": "pause_asked",
    "sliced_s": "print_time_s",
    "uncertain": "doubted",
    "unreported_since_s": "untold_since_s",
}
"""Names that fields had in the books of farm 0.1, by their current names."""


def _accept_names(field: str) -> str | AliasChoices:
    former_name = FORMER_NAMES.get(field)
    return field if former_name is None else AliasChoices(field, former_name)


class Entity(BaseModel):
    """Base class of the frozen records in the books."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", alias_generator=AliasGenerator(validation_alias=_accept_names)
    )


def share_field_set(model: M) -> M:
    """Let a model and all models in its fields share one set of field names for each class.

    Pydantic keeps such a set for each instance; that set takes as much memory as the fields of a plate.
    """
    for value in vars(model).values():
        if isinstance(value, BaseModel):
            share_field_set(value)
    object.__setattr__(model, "__pydantic_fields_set__", _find_field_set(type(model)))
    return model


@cache
def _find_field_set(model_class: type[BaseModel]) -> set[str]:
    return set(model_class.model_fields)
