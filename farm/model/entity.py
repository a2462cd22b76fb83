"""Frozen records of the books, and the former names of their fields."""

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
"""Names that the books of farm 0.1 use for fields which were renamed later."""


def _accept_names(field: str) -> str | AliasChoices:
    former_name = FORMER_NAMES.get(field)
    return field if former_name is None else AliasChoices(field, former_name)


class Entity(BaseModel):
    """Frozen record of the books."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", alias_generator=AliasGenerator(validation_alias=_accept_names)
    )


def share_field_set(model: M) -> M:
    """Replace the set of fields of a model, and of models in its fields, with one set for each class.

    Pydantic keeps a set for each instance, which takes as much memory as the fields of a plate.
    """
    for value in vars(model).values():
        if isinstance(value, BaseModel):
            share_field_set(value)
    object.__setattr__(model, "__pydantic_fields_set__", _find_field_set(type(model)))
    return model


@cache
def _find_field_set(kind: type[BaseModel]) -> set[str]:
    return set(kind.model_fields)
