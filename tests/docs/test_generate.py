"""Tests of docs/generate.py, which writes pages from the code."""

import importlib.util
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


def load_script(name: str):
    """Load a script of docs as a module."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


generate = load_script("generate")


def test_name_without_a_description_is_refused_with_the_section():
    with pytest.raises(generate.MissingWords, match=r"'outage' under 'hold_codes'"):
        generate.pair_with_words(["paused", "outage"], "hold_codes", {"paused": "It waits."})


def test_description_without_a_name_is_refused():
    with pytest.raises(generate.MissingWords, match="no longer has 'gone'"):
        generate.pair_with_words(["paused"], "hold_codes", {"paused": "It waits.", "gone": "It is not."})


def test_field_of_json_without_a_description_is_refused():
    schema = {"properties": {"grams": {"type": "number"}, "new": {"type": "number"}}}
    expected = {"any": {"grams": "Filament."}, "Reel": {"new": "It is new."}}
    assert "It is new." in generate._make_fields_table("Reel", schema, expected)
    with pytest.raises(generate.MissingWords, match="'new' under 'json_fields', Reel"):
        generate._make_fields_table("Reel", schema, {"any": {"grams": "Filament."}})


def test_cell_text_is_escaped():
    assert generate.make_table(("a", "b"), [("1|2", "3")]).splitlines()[-1] == "| 1\\|2 | 3 |"


@pytest.mark.parametrize(
    ("schema", "description"),
    [
        ({"type": "integer", "minimum": 1, "maximum": 256}, "whole number from 1 to 256"),
        ({"type": "number", "exclusiveMinimum": 0}, "number above 0"),
        ({"anyOf": [{"type": "string"}, {"type": "null"}]}, "text or null"),
        ({"type": "array", "items": {"$ref": "#/$defs/Todo"}}, "list of [Todo](#todo)"),
        ({"type": "array", "prefixItems": [{}, {}, {}]}, "3 numbers"),
    ],
)
def test_schema_is_described_in_words(schema: dict, description: str):
    assert generate.describe_value(schema) == description


def test_terminal_picture_shows_the_output_without_external_resources():
    svg = load_script("terminal_picture").draw_output("farm status", "\x1b[1mDO NOW\x1b[0m nothing <b>", 40)
    assert "DO" in svg and "&lt;b&gt;" in svg
    assert "http" not in svg.replace("http://www.w3.org/2000/svg", "")
