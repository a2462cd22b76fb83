"""Defaults of stored fields: rows omit them, so a changed default would change the meaning of old rows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from farm.state.storage.migrations import TABLES

RECORD_FILE = Path(__file__).with_name("stored_defaults.json")


def list_defaults() -> dict[str, Any]:
    """List the defaults of all fields that rows hold, by record and field."""
    schemas: dict[str, Any] = {}
    for kind in TABLES:
        schema = kind.model_json_schema(mode="serialization")
        schemas |= schema.get("$defs", {}) | {kind.__name__: schema}
    return {
        f"{record}.{name}": field["default"]
        for record, schema in sorted(schemas.items())
        for name, field in schema.get("properties", {}).items()
        if "default" in field
    }


def test_defaults_of_stored_fields_are_unchanged():
    """Compare with the file: add new fields to it; a changed default needs a migration of old rows."""
    recorded_defaults, defaults = json.loads(RECORD_FILE.read_text()), list_defaults()
    changed_fields = {name for name, value in recorded_defaults.items() if defaults.get(name, value) != value}
    assert not changed_fields
    assert defaults.keys() <= recorded_defaults.keys(), (
        "add these with their defaults to stored_defaults.json"
    )
