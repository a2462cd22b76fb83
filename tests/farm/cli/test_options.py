"""Options that several commands share."""

from __future__ import annotations

import pytest
import typer

from farm.cli.options import parse_pins


@pytest.mark.parametrize(("text", "pin_mm"), [("none", None), ("filament", 2.85), ("3", 3.0), ("1.75", 1.75)])
def test_pins_are_a_word_or_a_diameter(text: str, pin_mm: float | None) -> None:
    assert parse_pins(text) == pin_mm


@pytest.mark.parametrize("text", ["", "wire", "0.5", "11", "-3", "nan", "inf"])
def test_other_pins_are_refused(text: str) -> None:
    with pytest.raises(typer.BadParameter, match="filament, none, or a diameter from 1 to 10 mm"):
        parse_pins(text)
