"""Settings of Cura's definition files: type, default, formulas, limits and scope of each."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from slicing.errors import BadSetting, DefinitionError, suggest_names
from slicing.settings.formula import Formula


class SettingType(StrEnum):
    """Types of Cura's settings."""

    BOOL = "bool"
    INT = "int"
    FLOAT = "float"
    STR = "str"
    ENUM = "enum"
    EXTRUDER = "extruder"
    OPTIONAL_EXTRUDER = "optional_extruder"
    INTS = "[int]"
    POLYGON = "polygon"
    POLYGONS = "polygons"


_LIST_TYPES = (SettingType.INTS, SettingType.POLYGON, SettingType.POLYGONS)
_EXTRUDER_TYPES = (SettingType.EXTRUDER, SettingType.OPTIONAL_EXTRUDER)
_MAX_TEXT_LENGTH = 60
_EXTRUDER_NUMBERS = ("0", "-1")  # the only extruder, or none


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting of a definition. Limits, scope and `enabled` may be formulas."""

    key: str
    type: SettingType
    default: Any
    value: Formula | None = None
    resolve: Formula | None = None
    limit_to_extruder: Formula | None = None
    per_extruder: Any = True
    minimum: Any = None
    maximum: Any = None
    options: tuple[str, ...] = ()
    enabled: Any = True


def merge_definitions(chain: Sequence[Mapping[str, Any]]) -> dict[str, Setting]:
    """Merge the settings of a definition with those that it inherits.

    Parameters
    ----------
    chain
        The parsed ``.def.json`` files, the one at the root of the inheritance first.
    """
    entries: dict[str, dict[str, Any]] = {}

    def collect(settings: Mapping[str, Any]) -> None:
        for key, entry in settings.items():
            if entry.get("type") != "category":
                entries[key] = {k: v for k, v in entry.items() if k != "children"}
            collect(entry.get("children", {}))

    for file in chain:
        collect(file.get("settings", {}))
        for key, override in file.get("overrides", {}).items():
            if key in entries:
                entries[key] = {**entries[key], **override}
    return {key: _read_setting(key, entry) for key, entry in entries.items()}


def _read_setting(key: str, entry: Mapping[str, Any]) -> Setting:
    try:
        kind = SettingType(entry["type"])
    except ValueError:
        raise DefinitionError(
            f"Cura's setting {key} has the unknown type {entry['type']!r}; use the files of Cura 4.13 or 5"
        ) from None
    return Setting(
        key=key,
        type=kind,
        default=entry.get("default_value"),
        value=_read_formula(entry.get("value")),
        resolve=_read_formula(entry.get("resolve")),
        limit_to_extruder=_read_formula(entry.get("limit_to_extruder")),
        per_extruder=_read_value_or_formula(entry.get("settable_per_extruder", True)),
        minimum=_read_value_or_formula(entry.get("minimum_value")),
        maximum=_read_value_or_formula(entry.get("maximum_value")),
        options=tuple(entry.get("options", ())),
        enabled=_read_value_or_formula(entry.get("enabled", True)),
    )


def _read_formula(raw_value: Any) -> Formula | None:
    return None if raw_value is None else Formula(str(raw_value))


def _read_value_or_formula(raw_value: Any) -> Any:
    return Formula(raw_value) if isinstance(raw_value, str) else raw_value


def parse_value(setting: Setting, raw_value: Any) -> Any:
    """Read a value as a profile or a person writes it, in the setting's own type.

    Parameters
    ----------
    setting
        Setting that gives the type.
    raw_value
        The value as written.

    Raises
    ------
    BadSetting
        If the value is of another type, not finite, or not an option; the message gives the allowed values.
    """
    text = str(raw_value).strip()
    try:
        match setting.type:
            case SettingType.BOOL:
                return {"true": True, "false": False}[text.lower()]
            case SettingType.INT | SettingType.FLOAT:
                number = float(text)
                is_whole = setting.type is SettingType.INT
                if not math.isfinite(number) or (is_whole and not number.is_integer()):
                    raise ValueError
                return int(number) if is_whole else number
            case SettingType.ENUM if text not in setting.options:
                hint = suggest_names(text, setting.options) or f"; use one of {', '.join(setting.options)}"
                raise BadSetting(f"{setting.key}={_shorten_text(text)}: not one of the options{hint}")
            case SettingType.STR if any(ord(letter) < ord(" ") for letter in text.replace("\n", "")):
                raise ValueError
            case kind if kind in _EXTRUDER_TYPES:
                if text not in _EXTRUDER_NUMBERS:
                    raise ValueError
                return text
            case kind if kind in _LIST_TYPES:
                if not _is_list(setting.type, text):
                    raise ValueError
                return ast.literal_eval(text)
    except (KeyError, ValueError, SyntaxError, MemoryError, RecursionError):
        allowed = _ALLOWED_VALUES[setting.type]
        raise BadSetting(
            f"{setting.key}={_shorten_text(text)}: not a value of type {setting.type}; use {allowed}"
        ) from None
    return str(raw_value)


def _shorten_text(text: str) -> str:
    """Shorten a person's text to one line."""
    line = "".join(letter if letter.isprintable() else " " for letter in text)
    return line if len(line) <= _MAX_TEXT_LENGTH else f"{line[:_MAX_TEXT_LENGTH]}..."


def parse_literal(text: str) -> Any:
    """Read a value that is not of its setting's type, as Cura does: as a literal if possible."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return text


_ALLOWED_VALUES: Mapping[SettingType, str] = {
    SettingType.BOOL: "true or false",
    SettingType.INT: "a whole number",
    SettingType.FLOAT: "a number like 0.2",
    SettingType.STR: "text without control characters",
    SettingType.EXTRUDER: "0",
    SettingType.OPTIONAL_EXTRUDER: "0 or -1",
    SettingType.INTS: "a list like [0, 90]",
    SettingType.POLYGON: "a list of points",
    SettingType.POLYGONS: "a list of lists of points",
}


def fits_type(setting: Setting, value: Any) -> bool:
    """Check whether the engine reads a computed value as this setting's type."""
    match setting.type:
        case SettingType.BOOL:
            return isinstance(value, bool | int)
        case SettingType.INT:
            return isinstance(value, int | float) and math.isfinite(value) and float(value).is_integer()
        case SettingType.FLOAT:
            return isinstance(value, int | float) and math.isfinite(value)
        case SettingType.ENUM:
            return value in setting.options
        case kind if kind in _EXTRUDER_TYPES:
            return str(value) in _EXTRUDER_NUMBERS
        case kind if kind in _LIST_TYPES:
            return _is_list(kind, value)
    return isinstance(value, str)


def _is_list(kind: SettingType, value: Any) -> bool:
    """Check whether a value is a list, or the text of one; for `SettingType.INTS`, a list of ints."""
    try:
        items = ast.literal_eval(value) if isinstance(value, str) else value
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return False
    requires_ints = kind is SettingType.INTS
    return isinstance(items, list) and all(type(item) is int for item in items if requires_ints)
