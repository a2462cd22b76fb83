"""Generator of the pages of docs/reference that describe the program: its commands, records and names.

The meanings of names are in docs/reference/words.yaml; a name without a meaning there is an error.

Usage: python docs/generate.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from drivers.errors import Fault
from drivers.printers import PROFILES
from farm import api
from farm.cli.command_group import load_commands
from farm.cli.estop_socket import StopReport
from farm.cli.main import app
from farm.config import (
    ComputeSection,
    FleetSection,
    KeepSection,
    PrinterSection,
    TlsSection,
    UploadsSection,
    WebSection,
)
from farm.errors import EXIT_CODES, ErrorCode, ExitCode
from farm.model import Bed, FilamentState, HoldCode, JobState, Link, PrintState
from farm.state import FarmFault
from farm.state.lifecycles import FARM_WIDE_EVENTS, LIFECYCLES, NO_STATE, Lifecycle
from slicing.errors import Rule

FOLDER = Path(__file__).parent / "reference"
WORDS = FOLDER / "words.yaml"
NOTE = "<!-- Written by `python docs/generate.py`: change the program or words.yaml instead. -->"
SHARED_OPTIONS = ("--state", "--socket", "--fleet")
NETWORK_OPTIONS = ("--url", "--key-file")
SCHEMAS: tuple[tuple[str, type[BaseModel]], ...] = (
    ("farm status --json", api.Status),
    ("farm status JOB --json and farm submit --json", api.JobStatus),
    ("farm submit --dry-run --json", api.Timeline),
    ("farm history --json", api.History),
    ("farm queue --json", api.Queue),
    ("farm hosts --json", api.HostList),
    ("farm submit of several models, --json", api.Submissions),
    ("farm prune --json", api.PruneResponse),
    ("One printer of farm estop --json", StopReport),
    ("farm key --json", api.Keys),
    ("farm key add --json", api.NewKey),
    ("farm web --json", api.LoginLink),
    ("farm web --end-all --json", api.EndedSessions),
)


class MissingWords(Exception):
    """A name of the program is missing in words.yaml, or a name in words.yaml is missing in the program."""


def make_table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Lay out a Markdown table."""
    lines = [list(headings)]
    lines.append(["---"] * len(lines[0]))
    lines += [[cell.replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def pair_with_words(names: Iterable[str], section: str, words: dict[str, str]) -> list[tuple[str, str]]:
    """Pair each name with its meaning.

    Raises
    ------
    MissingWords
        If a name has no meaning, or a meaning has no name.
    """
    known_names = list(names)
    for name in known_names:
        if name not in words:
            raise MissingWords(f"{WORDS}: add a line for {name!r} under {section!r}")
    if unknown_names := sorted(set(words) - set(known_names)):
        raise MissingWords(
            f"{WORDS}: the program no longer has {unknown_names[0]!r}: remove it from {section!r}"
        )
    return [(f"`{name}`", words[name]) for name in known_names]


def make_names_table(kind: type[Enum], section: str, words: dict[str, Any]) -> str:
    """Lay out the members of an enumeration with their meanings."""
    rows = pair_with_words((str(member.value) for member in kind), section, words[section])
    return make_table(("name", "meaning"), rows)


def describe_value(schema: dict[str, Any]) -> str:
    """Describe the values that a JSON schema allows in a few words."""
    if "$ref" in schema:
        name = str(schema["$ref"]).rpartition("/")[2]
        return "hours of the week" if name == "Window" else f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(describe_value(alternative) for alternative in schema["anyOf"])
    kind = str(schema.get("type", "anything"))
    if kind == "array":
        if "prefixItems" in schema:
            return f"{len(schema['prefixItems'])} numbers"
        return f"list of {describe_value(schema['items'])}"
    if kind == "object" and "additionalProperties" in schema:
        return f"object of {describe_value(schema['additionalProperties'])}"
    type_name = {"boolean": "true or false", "integer": "whole number", "string": "text"}.get(kind, kind)
    minimum = schema.get("minimum")
    limits = [f"from {minimum:g}"] if minimum is not None else []
    limits += [f"above {schema['exclusiveMinimum']:g}"] if "exclusiveMinimum" in schema else []
    limits += [f"to {schema['maximum']:g}"] if "maximum" in schema else []
    return " ".join([type_name, *limits])


def write_commands_page(_: dict[str, Any]) -> str:
    """Describe every command and its options, as `farm COMMAND --help` does."""
    parts = [
        "# Commands",
        "Every command except `decompose` and `slice` also takes "
        f"{', '.join(f'`{option}`' for option in SHARED_OPTIONS)} "
        "(or the variables `FARM_STATE`, `FARM_SOCKET`, `FARM_FLEET`): another state folder, another "
        "daemon's socket, another fleet file. With them several farms can run on one host. If only a state "
        "folder is given, the socket is in it.",
        "The commands that need only the daemon also take "
        f"{' and '.join(f'`{option}`' for option in NETWORK_OPTIONS)} (or `FARM_URL` and `FARM_KEY_FILE`), "
        "for [a farm on another host](../how-to/network.md): "
        f"{', '.join(f'`{name}`' for name in _list_network_commands())}.",
        "`farm --install-completion` makes the shell complete commands, printers, jobs and parts.",
    ]
    for name, command in load_commands(app).items():
        parts.append(f"## farm {name}\n{command.help}")
        rows = list(_list_options(command))
        if rows:
            parts.append(make_table(("option", "default", "meaning"), rows))
    return "\n\n".join(parts)


def _list_network_commands() -> list[str]:
    return [
        name
        for name, command in load_commands(app).items()
        if any(NETWORK_OPTIONS[0] in param.opts and not param.hidden for param in command.params)
    ]


def _list_options(command: Any) -> Iterator[tuple[str, str, str]]:
    for param in command.params:
        if getattr(param, "hidden", False) or param.opts[-1] in (*SHARED_OPTIONS, *NETWORK_OPTIONS):
            continue
        is_argument = param.param_type_name == "argument"
        name = (param.metavar or param.name).upper() if is_argument else " ".join(param.opts)
        default = param.default
        is_hidden = is_argument or default is None or default is False or callable(default)
        yield f"`{name}`", "" if is_hidden else f"`{default}`", getattr(param, "help", None) or ""


def write_fleet_page(words: dict[str, Any]) -> str:
    """Describe every key of fleet.yaml."""
    models = ", ".join(f"`{model}`" for model in sorted(PROFILES))
    parts = [(FOLDER / "fleet-yaml.intro.md").read_text(encoding="utf-8").strip()]
    sections: tuple[tuple[str, str, type[BaseModel]], ...] = (
        ("Keys under `fleet`", "fleet", FleetSection),
        ("Keys under `fleet.compute`", "compute", ComputeSection),
        ("Keys under `fleet.keep`", "keep", KeepSection),
        ("Keys under `fleet.uploads`", "uploads", UploadsSection),
        ("Keys under `web`", "web", WebSection),
        ("Keys under `web.tls`", "tls", TlsSection),
        ("Keys of a printer", "printers", PrinterSection),
    )
    for title, section, model in sections:
        schema = model.model_json_schema()
        keys = pair_with_words(schema["properties"], section, words["fleet_yaml"][section])
        rows = []
        for (key, meaning), name in zip(keys, schema["properties"], strict=True):
            field = schema["properties"][name]
            has_keys = any("$ref" in alternative for alternative in field.get("anyOf", [field]))
            value = "keys" if has_keys else describe_value(field).replace(" or null", "")
            rows.append((key, value, _describe_default(name, schema), meaning.format(models=models)))
        parts.append(f"## {title}\n" + make_table(("key", "value", "default", "meaning"), rows))
    return "\n\n".join(parts)


def _describe_default(name: str, schema: dict[str, Any]) -> str:
    if name in schema.get("required", ()):
        return "required"
    default = schema["properties"][name].get("default")
    if default is None or default == [] or isinstance(default, dict):
        return ""
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"


def write_json_page(words: dict[str, Any]) -> str:
    """Describe the objects that `--json` prints."""
    fields = words["json_fields"]
    parts = [(FOLDER / "json.intro.md").read_text(encoding="utf-8").strip()]
    objects: dict[str, dict[str, Any]] = {}
    for title, model in SCHEMAS:
        schema = model.model_json_schema(by_alias=True)
        objects |= schema.get("$defs", {})
        parts.append(f"## {title}\n" + _make_fields_table(model.__name__, schema, fields))
    parts.append("## Objects inside these objects")
    for name, schema in sorted(objects.items()):
        if "enum" in schema:
            body = "One of " + ", ".join(f"`{value}`" for value in schema["enum"]) + "."
        else:
            body = _make_fields_table(name, schema, fields)
        parts.append(f"### {name}\n{body}")
    return "\n\n".join(parts)


def _make_fields_table(name: str, schema: dict[str, Any], words: dict[str, dict[str, str]]) -> str:
    object_words = words.get(name, {})
    if unknown_fields := sorted(set(object_words) - set(schema["properties"])):
        raise MissingWords(
            f"{WORDS}: {name} has no field {unknown_fields[0]!r}: remove it from 'json_fields'"
        )
    rows = []
    for field, values in schema["properties"].items():
        meaning = object_words.get(field) or words["any"].get(field)
        if not meaning:
            raise MissingWords(f"{WORDS}: add a line for {field!r} under 'json_fields', {name}")
        rows.append((f"`{field}`", describe_value(values), meaning))
    return make_table(("field", "value", "meaning"), rows)


def write_states_page(words: dict[str, Any]) -> str:
    """Explain the states of jobs, prints and printers."""
    parts = ["# States", "As `farm status` and `--json` name them."]
    for title, kind, section in (
        ("A job", JobState, "job_states"),
        ("A print", PrintState, "print_states"),
        ("The bed of a printer", Bed, "beds"),
        ("The filament of a printer", FilamentState, "filaments"),
        ("The connection to a printer", Link, "links"),
    ):
        parts.append(f"## {title}\n{make_names_table(kind, section, words)}")
    return "\n\n".join(parts)


def write_lifecycles_page(words: dict[str, Any]) -> str:
    """Draw the transitions between states with their events, from the program's own tables."""
    parts = [(FOLDER / "lifecycles.intro.md").read_text(encoding="utf-8").strip()]
    parts += [f"## A {table.entity_name}\n```text\n{draw_lifecycle(table)}\n```" for table in LIFECYCLES]
    all_rows = (row for table in LIFECYCLES for row in (*table.transitions, *table.consequences))
    kinds = sorted({row.event_kind for row in all_rows} | FARM_WIDE_EVENTS, key=lambda kind: kind.__name__)
    rows = pair_with_words((kind.__name__ for kind in kinds), "events", words["events"])
    parts.append("## Events\n" + make_table(("event", "meaning"), rows))
    return "\n\n".join(parts)


def draw_lifecycle(lifecycle: Lifecycle) -> str:
    """Draw a table as text: under each state the events that can happen in it, and where they lead."""
    lines = []
    for state in (NO_STATE, *lifecycle.states):
        lines.append("(new)" if state is NO_STATE else str(state))
        for mark, rows in (("──", lifecycle.transitions), ("··", lifecycle.consequences)):
            for row in rows:
                if state not in row.start_states:
                    continue
                ends = (
                    ["(stays)"]
                    if row.end_states is None
                    else [str(s) for s in lifecycle.states if s in row.end_states]
                )
                lines.append(f"  {mark} {row.event_kind.__name__} {mark}> {' | '.join(ends)}")
    return "\n".join(lines)


def write_holds_page(words: dict[str, Any]) -> str:
    """Explain the reasons for which a plate or a job waits."""
    intro = (
        "The reason for which a plate or a job waits: `hold.code` in `--json`. "
        "`hold.text` describes the case in a sentence."
    )
    return f"# Hold codes\n\n{intro}\n\n{make_names_table(HoldCode, 'hold_codes', words)}"


def write_faults_page(words: dict[str, Any]) -> str:
    """Explain the reasons for failed prints and refused slices."""
    parts = [
        "# Faults",
        "The reason for which a print failed: `fault` in `--json`. "
        "`reason` describes the case in a sentence.",
    ]
    parts.append(f"## Detected at the printer\n{make_names_table(Fault, 'faults', words)}")
    parts.append(f"## Detected by the farm\n{make_names_table(FarmFault, 'own_faults', words)}")
    parts.append(
        "## Rules that a slice must keep\n"
        "A slice that breaks one of them is refused, and the error names the rule.\n\n"
        + make_names_table(Rule, "slice_rules", words)
    )
    return "\n\n".join(parts)


def write_exit_codes_page(words: dict[str, Any]) -> str:
    """Explain the meaning of each exit code, and list the errors that end with it."""
    meanings = pair_with_words((code.name.lower() for code in ExitCode), "exit_codes", words["exit_codes"])
    rows = []
    for code, (_, meaning) in zip(ExitCode, meanings, strict=True):
        errors = ", ".join(f"`{error}`" for error in ErrorCode if EXIT_CODES[error] is code)
        rows.append((str(int(code)), meaning, errors))
    intro = (
        "Every error is reported as one line on stderr: `farm: what, where, what to do`. "
        "The error of a failed job is in `error` of `--json`."
    )
    return f"# Exit codes\n\n{intro}\n\n" + make_table(("code", "meaning", "errors that end with it"), rows)


PAGES = {
    "commands.md": write_commands_page,
    "fleet-yaml.md": write_fleet_page,
    "json.md": write_json_page,
    "states.md": write_states_page,
    "lifecycles.md": write_lifecycles_page,
    "hold-codes.md": write_holds_page,
    "faults.md": write_faults_page,
    "exit-codes.md": write_exit_codes_page,
}


def main() -> int:
    """Write the pages, or with --check report those that are not up to date."""
    words = yaml.safe_load(WORDS.read_text(encoding="utf-8"))
    stale_pages = []
    for name, write_page in PAGES.items():
        title, newline, rest = write_page(words).partition("\n")
        text = f"{title}{newline}{NOTE}\n{rest}\n"
        page = FOLDER / name
        if page.is_file() and page.read_text(encoding="utf-8") == text:
            continue
        stale_pages.append(page)
        if "--check" not in sys.argv:
            page.write_text(text, encoding="utf-8")
    if stale_pages and "--check" in sys.argv:
        paths = " ".join(map(str, stale_pages))
        print(f"{paths}: not up to date: run `python docs/generate.py`", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except MissingWords as error:
        sys.exit(str(error))
