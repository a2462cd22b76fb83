"""Reader of `fleet.yaml`, with errors that name file, line and field, and suggest a correction."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails
from yaml.constructor import ConstructorError

from farm.config import (
    ComputeSection,
    FieldError,
    Fleet,
    FleetSection,
    KeepSection,
    KeyPath,
    PrinterSection,
    TlsSection,
    UploadsSection,
    WebSection,
)
from farm.errors import FleetFileError

MAX_FILE_BYTES = 512 * 1024  # enough for a thousand printers
MAX_VALUES = 100_000
"""Maximum number of keys and values once aliases (`*name`) are expanded: few lines can expand to billions."""

_TYPE_NAMES = {
    "int": "a whole number",
    "float": "a number",
    "finite": "a number",
    "decimal": "a number",
    "bool": "true or false",
    "string": "text; put it in quotes",
    "tuple": "a list: [..., ...]",
    "list": "a list: [..., ...]",
    "model": "keys with values: {key: value}",
    "dict": "keys with values: {key: value}",
}
_LIMIT_DESCRIPTIONS = {
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:g}",
    "string_too_short": "at least {min_length} characters long",
    "string_too_long": "at most {max_length} characters long",
}
_PATTERN_DESCRIPTIONS = {
    "name": "letters, digits, '.', '_' and '-', 41 at most, the first a letter or a digit",
    "host": "a host as ssh knows it, like user@pc-b",
    "group": "a group of this host, like farm",
    "operators": "a group of this host, like farm-staff",
}
"""Descriptions of the allowed values, by keys whose values must match a pattern."""

SectionCompleter = Callable[[PrinterSection, FleetSection], PrinterSection]
"""Function that checks a section and adds derived values. Raises FieldError with the key of a wrong value."""


def load_fleet(
    path: Path, models: frozenset[str], complete: SectionCompleter = lambda printer, _: printer
) -> Fleet:
    """Read and check a fleet file.

    Parameters
    ----------
    path
        The file.
    models
        The printer models that the drivers support.
    complete
        Function that checks and completes each printer whose keys are valid.

    Raises
    ------
    FleetFileError
        If the file is not valid; the message has the file, line and field of the first mistake, and a remedy.
    """
    document, raw_values = _parse_document(path, _read_text(path))
    values = _fill_in_defaults(document, raw_values)
    for index, printer in enumerate(values["printers"]):
        model = printer.get("model") if isinstance(printer, dict) else None
        if isinstance(model, str) and model not in models:
            advice = f"{model!r} is not a supported printer model: use one of {', '.join(sorted(models))}"
            raise document.make_error(("printers", index, "model"), advice)
    try:
        fleet = Fleet.model_validate(values)
    except ValidationError as error:
        raise document.convert_error(error.errors()[0]) from error
    fleet_section = _resolve_folders(fleet.fleet, path.absolute().parent)
    sections: list[PrinterSection] = []
    for index, section in enumerate(fleet.printers):
        try:
            sections.append(complete(section, fleet_section))
        except FieldError as error:
            is_fleet_key = error.key_path[0] == "fleet"
            key_path = error.key_path if is_fleet_key else ("printers", index, *error.key_path)
            raise document.make_error(key_path, str(error)) from error
    printers = (
        section.model_copy(update={"pin_fit_mm": fleet_section.pin_fit_mm})
        if section.pin_fit_mm is None
        else section
        for section in sections
    )
    return fleet.model_copy(update={"fleet": fleet_section, "printers": tuple(printers)})


def _resolve_folders(section: FleetSection, parent: Path) -> FleetSection:
    """Return the section with its relative paths resolved against the folder of the fleet file."""
    changes: dict[str, object] = {}
    if section.materials is not None:
        changes["materials"] = parent / section.materials
    if section.compute.certificates is not None:
        certificates = parent / section.compute.certificates
        changes["compute"] = section.compute.model_copy(update={"certificates": certificates})
    return section.model_copy(update=changes)


@dataclass(frozen=True, slots=True)
class _Document:
    """Fleet file as YAML nodes, which contain line numbers."""

    path: Path
    node: yaml.Node | None

    def make_error(self, key_path: KeyPath, message: str) -> FleetFileError:
        """Make an error with the file, the line of the value, the field, and the message in one line."""
        source = self._find_source(key_path)
        field = ".".join(map(str, source))
        text = f"{field}: {message}" if field else message
        return FleetFileError(f"{self.path}:{self.find_line(source)}: {text}")

    def convert_error(self, error: ErrorDetails) -> FleetFileError:
        """Convert an error of pydantic into an error in plain words."""
        cause = error.get("ctx", {}).get("error")
        key_path = cause.key_path if isinstance(cause, FieldError) else error["loc"]
        if error["type"] == "extra_forbidden":
            section = _find_section(self._find_source(key_path))
            keys = [*section.model_fields, *(["defaults"] if section is Fleet else [])]
            return self.make_error(key_path, f"unknown key; the known keys are {', '.join(keys)}")
        return self.make_error(
            key_path, _reword_error(error, _PATTERN_DESCRIPTIONS.get(str(key_path[-1])) if key_path else None)
        )

    def find_line(self, key_path: KeyPath) -> int:
        """Find the line number, counted from 1, of the deepest existing node on a path of keys."""
        line, node = 1, self.node
        for step in key_path:
            node = _find_child(node, step)
            if node is None:
                break
            line = node.start_mark.line + 1
        return line

    def find_duplicate(self) -> KeyPath | None:
        """Find a key that appears twice in one mapping; YAML would silently use the last one."""
        visited: set[int] = set()  # an alias may lead to a visited node, even to one that contains the alias

        def search_node(node: yaml.Node | None, key_path: KeyPath) -> KeyPath | None:
            if id(node) in visited:
                return None
            visited.add(id(node))
            keys: set[Any] = set()
            for key, child in _list_children(node):
                child_path = (*key_path, key)
                if key in keys:
                    return child_path
                keys.add(key)
                duplicate = search_node(child, child_path)
                if duplicate is not None:
                    return duplicate
            return None

        return search_node(self.node, ())

    def count_values(self) -> int:
        """Count keys and values, including those of each alias; an alias that contains itself counts once."""
        counts: dict[int, int] = {}

        def count_node(node: yaml.Node) -> int:
            if id(node) not in counts:
                counts[id(node)] = 0
                pairs = node.value if isinstance(node, yaml.CollectionNode) else []
                children = chain.from_iterable(pairs) if isinstance(node, yaml.MappingNode) else pairs
                counts[id(node)] = 1 + sum(map(count_node, children))
            return counts[id(node)]

        return 0 if self.node is None else count_node(self.node)

    def _find_source(self, key_path: KeyPath) -> KeyPath:
        """Find the path at which a value is written: a printer's key may be written in `defaults` instead."""
        if len(key_path) < 3 or key_path[0] != "printers":
            return key_path
        section = _find_child(_find_child(self.node, "printers"), key_path[1])
        default_node = _find_child(self.node, "defaults")
        if _find_child(section, key_path[2]) is None and _find_child(default_node, key_path[2]) is not None:
            return ("defaults", *key_path[2:])
        return key_path


class _Loader(yaml.SafeLoader):
    """YAML loader that reports the line of an invalid value, such as 30 February."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:
        try:
            return super().construct_object(node, deep)
        except (ValueError, LookupError) as error:
            raise ConstructorError(None, None, str(error), node.start_mark) from error


def _read_text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        if len(data) > MAX_FILE_BYTES:
            raise FleetFileError(f"{path}: is larger than {MAX_FILE_BYTES // 1024} KiB: not a fleet file")
        return data.decode()
    except FileNotFoundError as error:
        raise FleetFileError(
            f"{path}: no such file; write one with the printers that `farm discover` lists, or give "
            "another file with --fleet"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        cause = (error.strerror if isinstance(error, OSError) else None) or error
        raise FleetFileError(f"{path}: cannot be read ({cause}); give another file with --fleet") from error


def _parse_document(path: Path, text: str) -> tuple[_Document, Any]:
    """Parse YAML into nodes and values."""
    try:
        loader = _Loader(text)
        document = _Document(path, loader.get_single_node())
        if document.count_values() > MAX_VALUES:
            raise FleetFileError(f"{path}: expands to more than {MAX_VALUES} values: use fewer aliases")
        duplicate = document.find_duplicate()
        raw_values = None if document.node is None else loader.construct_document(document.node)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        source = f"{path}:{mark.line + 1}" if mark else str(path)
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        raise FleetFileError(f"{source}: not YAML: {problem}") from error
    except RecursionError as error:
        raise FleetFileError(f"{path}: nested too deeply; see the example in the README") from error
    if duplicate is not None:
        raise document.make_error(duplicate, "appears twice")
    return document, raw_values


def _fill_in_defaults(document: _Document, raw_values: Any) -> dict[str, Any]:
    """Return the values of the file, with those of `defaults` copied into each printer."""
    if not isinstance(raw_values, dict) or not isinstance(raw_values.get("printers"), list):
        raise FleetFileError(f"{document.path}: needs a list `printers`; see the example in the README")
    defaults = raw_values.pop("defaults", None) or {}
    if not isinstance(defaults, dict):
        line = document.find_line(("defaults",))
        raise FleetFileError(f"{document.path}:{line}: `defaults` must contain printer keys")
    values = {str(key): value for key, value in raw_values.items() if value is not None}
    values["printers"] = [
        {**defaults, **printer} if isinstance(printer, dict) else printer
        for printer in raw_values["printers"]
    ]
    return values


def _reword_error(error: ErrorDetails, allowed_values: str | None) -> str:
    """Describe an error in plain words; `allowed_values` describes the values that match a pattern."""
    kind, context = error["type"], error.get("ctx", {})
    if kind == "missing":
        return "is missing" if isinstance(error["loc"][-1], str) else "has one value too few"
    if kind == "string_pattern_mismatch":
        return f"must be {allowed_values or 'written differently'}, not {str(error['input'])!r}"
    if kind == "invalid_key":
        return "a key must be text"
    if kind in _LIMIT_DESCRIPTIONS:
        return f"must be {_LIMIT_DESCRIPTIONS[kind].format(**context)}"
    if kind == "too_long":
        return "has {actual_length} values; {max_length} at most".format(**context)
    type_name = _TYPE_NAMES.get(kind.partition("_")[0])
    return f"must be {type_name}" if type_name else error["msg"].removeprefix("Value error, ")


def _find_section(key_path: KeyPath) -> type[BaseModel]:
    """Return the model of the section to which a key belongs."""
    if len(key_path) > 2 and key_path[0] == "fleet":
        sections: dict[object, type[BaseModel]] = {
            "compute": ComputeSection,
            "keep": KeepSection,
            "uploads": UploadsSection,
        }
        return sections.get(key_path[1], FleetSection)
    if len(key_path) > 2 and key_path[:2] == ("web", "tls"):
        return TlsSection
    owners: dict[str, type[BaseModel]] = {"fleet": FleetSection, "web": WebSection}
    owners |= {"printers": PrinterSection, "defaults": PrinterSection}
    return owners.get(str(key_path[0]), Fleet) if len(key_path) > 1 else Fleet


def _find_child(node: yaml.Node | None, step: str | int) -> yaml.Node | None:
    return next((child for key, child in _list_children(node) if key == step), None)


def _list_children(node: yaml.Node | None) -> Iterator[tuple[Any, yaml.Node]]:
    if isinstance(node, yaml.MappingNode):
        yield from ((key.value, value) for key, value in node.value)
    elif isinstance(node, yaml.SequenceNode):
        yield from enumerate(node.value)
