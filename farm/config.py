"""`fleet.yaml`: its records, read and checked before anything acts on them."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Self
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SecretStr,
    ValidationError,
    field_validator,
    model_validator,
)
from yaml.constructor import ConstructorError

from farm.errors import FleetFileError
from farm.fleet_errors import Misplaced, Place, in_words, line_of, place_of, written, written_twice
from farm.week_windows import Window, parse_window

SIMULATED = "sim://"
_FORWARDED = "rfc2217://"

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,40}$")]
_HOW = {
    "name": "letters, digits, '.', '_' and '-', 41 at most, the first a letter or a digit",
    "host": "a host as ssh knows it, like user@pc-b",
    "group": "a group of this host, like farm",
    "operators": "a group of this host, like farm-staff",
}
"""How the keys are written that have a pattern."""
_MOVED_MODULES = {"drivers.bridge": "drivers.remote.bridge"}
"""Modules that a fleet file of an earlier version may name, and where they are."""
Group = Annotated[str, Field(pattern=r"^[a-z_][a-z0-9_-]{0,31}$")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


def _windows(written: object) -> object:
    """One window or a list of them, each as a person writes it."""
    lines = written if isinstance(written, list | tuple) else [written]
    return tuple(line if isinstance(line, Window) else parse_window(str(line)) for line in lines)


Windows = Annotated[tuple[Window, ...], BeforeValidator(_windows)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ComputeSection(_Section):
    """The keys under `fleet.compute`: what planning may use of this machine."""

    workers: Annotated[int, Field(ge=1, le=256)] | None = None  # as many as cores
    memory_gb: Annotated[float, Field(ge=1, allow_inf_nan=False)] | None = None  # for each worker
    budget_s: Annotated[float, Field(ge=0, le=900)] = 20.0  # of one core, for the search of each job's parts


class FleetSection(_Section):
    """The keys under `fleet`."""

    name: Name = "farm"
    timezone: str = "UTC"
    time_scale: Annotated[float, Field(ge=1, le=1000)] = 1.0
    compute: ComputeSection = ComputeSection()
    currency: Annotated[str, Field(min_length=1, max_length=8)] | None = None
    attended: Windows = ()  # when somebody is there; none: nobody said
    quiet: Windows = ()  # when nothing may print
    first_layers_attended: bool = False  # a print starts only where its first layer ends in attended hours
    max_heating: Annotated[int, Field(ge=1)] | None = None  # printers that heat up at once: the breaker
    approve: bool = False  # no job prints before `farm approve`
    group: Group = "farm"  # who may use the daemon's socket, where there is such a group
    notify: tuple[SecretStr, ...] = ()  # whom to tell, as apprise writes addresses
    operators: Group | None = None  # who may say that printers go on; None: everybody

    @model_validator(mode="after")
    def _somebody_comes(self) -> Self:
        if self.first_layers_attended and not self.attended:
            raise Misplaced("needs `attended` hours under `fleet`", "fleet", "first_layers_attended")
        return self

    @field_validator("timezone")
    @classmethod
    def _known(cls, value: str) -> str:
        try:
            ZoneInfo(value)
        except (ZoneInfoNotFoundError, ValueError, OSError) as error:  # a folder of zones, like Europe
            raise ValueError(f"{value!r} is not a time zone; use a name like Europe/Berlin") from error
        return value


class PrinterSection(_Section):
    """One entry of `printers`."""

    name: Name
    model: str
    port: str
    material: str = "generic_pla"
    colour: str | None = None
    nozzle_mm: Positive = 0.4
    price_per_kg: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None  # of its reel
    volume_mm: tuple[Positive, Positive, Positive] | None = None
    host: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.@-]*$")] | None = None  # as ssh knows it
    host_command: str = "/opt/farm/.venv/bin/python -m drivers.remote.bridge"  # what ssh starts there
    enabled: bool = True
    unattended: bool = True  # it may print while nobody is there
    power_off_cmd: str | None = None  # what takes its mains away; {printer} is its name

    @property
    def simulated(self) -> bool:
        return self.port.startswith(SIMULATED)

    def price(self, grams: float) -> float | None:
        """What so much of its filament costs, in the fleet's currency; None where nobody said."""
        return None if self.price_per_kg is None else grams / 1000 * self.price_per_kg

    @field_validator("port")
    @classmethod
    def _printable(cls, value: str) -> str:
        if value.startswith((SIMULATED, _FORWARDED, "/")):
            return value
        if value.startswith("socket://"):
            raise ValueError("socket:// has no DTR, so a board could not be stopped: use rfc2217://HOST:PORT")
        raise ValueError(f"{value!r} is not a port: use a device path, rfc2217://HOST:PORT or sim://MODEL")

    @field_validator("host_command")
    @classmethod
    def _present(cls, value: str) -> str:
        for old, new in _MOVED_MODULES.items():
            if old in value.split():
                raise ValueError(f"{old} has moved: write {value.replace(old, new)!r}")
        return value

    @field_validator("power_off_cmd")
    @classmethod
    def _runnable(cls, value: str | None) -> str | None:
        try:
            words = value is None or shlex.split(value)
        except ValueError as error:
            raise ValueError(f"{value!r} is not a command: {error}") from error
        if not words:
            raise ValueError("is empty: leave it out if there is no relay")
        return value

    @model_validator(mode="after")
    def _simulates_itself(self) -> Self:
        if self.simulated and self.port.removeprefix(SIMULATED).partition("?")[0] != self.model:
            raise ValueError(f"{self.name}: port {self.port} simulates another model than {self.model}")
        return self


class Fleet(_Section):
    """The whole file, with the defaults filled in."""

    fleet: FleetSection = FleetSection()
    printers: tuple[PrinterSection, ...]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names: set[str] = set()
        ports: dict[Path | str, str] = {}
        for number, printer in enumerate(self.printers):
            place = ("printers", number)
            if printer.name in names:
                twice = f"two printers are named {printer.name}: each needs a name of its own"
                raise Misplaced(twice, *place, "name")
            names.add(printer.name)
            if not printer.unattended and not self.fleet.attended:
                nobody = f"{printer.name} has `unattended: false`: this needs `attended` hours under `fleet`"
                raise Misplaced(nobody, *place, "unattended")
            if printer.simulated:
                continue
            here = printer.host is None and printer.port.startswith("/")
            port = Path(printer.port).resolve() if here else f"{printer.host}:{printer.port}"
            if port in ports:
                raise Misplaced(
                    f"{ports[port]} and {printer.name} are on one port ({printer.port}): "
                    "a port belongs to one printer; see `ls -l /dev/serial/by-path`",
                    *place,
                    "port",
                )
            ports[port] = printer.name
        if self.fleet.time_scale != 1 and not all(printer.simulated for printer in self.printers):
            raise Misplaced(
                "must be 1 unless every port is sim://: a real printer has no fast clock",
                "fleet",
                "time_scale",
            )
        return self

    def printer(self, name: str) -> PrinterSection:
        """The entry of a printer; KeyError where there is none."""
        return {printer.name: printer for printer in self.printers}[name]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(printer.name for printer in self.printers)

    @property
    def zone(self) -> ZoneInfo:
        return ZoneInfo(self.fleet.timezone)


class _Loader(yaml.SafeLoader):
    """Says where a value stands that cannot be what it looks like: a 30th of February, say."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:
        try:
            return super().construct_object(node, deep)
        except (ValueError, LookupError) as error:
            raise ConstructorError(None, None, str(error), node.start_mark) from error


Check = Callable[["PrinterSection"], "tuple[str, str] | None"]
"""Looks a printer over: the key that is wrong, and what to write instead; None where all is well."""


def load_fleet(path: Path, models: frozenset[str], check: Check = lambda _: None) -> Fleet:
    """Read and check a fleet file.

    Parameters
    ----------
    path
        The file.
    models
        The printer models that the drivers know.
    check
        Looks over each printer that is well written.

    Raises
    ------
    FleetFileError
        With file, line and field of the first mistake, and what to write instead.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise FleetFileError(
            f"{path}: no such file; write one with the printers that `farm discover` lists, or give "
            "yours with --fleet"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        why = (error.strerror if isinstance(error, OSError) else None) or error
        raise FleetFileError(f"{path}: cannot be read ({why}); give another file with --fleet") from error
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        raw = yaml.load(text, Loader=_Loader)  # a SafeLoader
        twice = written_twice(node)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        what = " ".join(str(getattr(error, "problem", None) or error).split())
        raise FleetFileError(f"{where}: not YAML: {what}") from error
    except RecursionError as error:
        raise FleetFileError(f"{path}: nested too deeply; see the example in the README") from error
    if twice is not None:
        raise FleetFileError(_mistake(path, node, twice, "appears twice"))
    if not isinstance(raw, dict) or not isinstance(raw.get("printers"), list):
        raise FleetFileError(f"{path}: needs a list `printers`; see the example in the README")
    defaults = raw.pop("defaults", None) or {}
    if not isinstance(defaults, dict):
        raise FleetFileError(f"{path}:{line_of(node, ('defaults',))}: `defaults` must hold printer keys")
    raw = {str(key): value for key, value in raw.items() if value is not None}
    raw["printers"] = [
        {**defaults, **printer} if isinstance(printer, dict) else printer for printer in raw["printers"]
    ]
    for index, printer in enumerate(raw["printers"]):
        model = printer.get("model") if isinstance(printer, dict) else None
        if isinstance(model, str) and model not in models:
            known = f"{model!r} is not one of the printers that can be driven: {', '.join(sorted(models))}"
            raise FleetFileError(_mistake(path, node, ("printers", index, "model"), known))
    try:
        fleet = Fleet.model_validate(raw)
    except ValidationError as error:
        raise FleetFileError(_first_mistake(path, node, error)) from error
    for index, section in enumerate(fleet.printers):
        found = check(section)
        if found is not None:
            raise FleetFileError(_mistake(path, node, ("printers", index, found[0]), found[1]))
    return fleet


def _mistake(path: Path, node: yaml.Node | None, place: Place, message: str) -> str:
    """One line: the file, the line where a person wrote it, the field, and what is wrong."""
    where = written(node, place)
    field = ".".join(map(str, where))
    return f"{path}:{line_of(node, where)}: " + (f"{field}: {message}" if field else message)


def _first_mistake(path: Path, node: yaml.Node | None, error: ValidationError) -> str:
    first = error.errors()[0]
    place = place_of(first)
    if first["type"] == "extra_forbidden":
        section = _section(written(node, place))
        known = [*section.model_fields, *(["defaults"] if section is Fleet else [])]
        message = f"unknown key; known are {', '.join(known)}"
    else:
        message = in_words(first, _HOW.get(str(place[-1])) if place else None)
    return _mistake(path, node, place, message)


def _section(place: Place) -> type[BaseModel]:
    """What a key stands in."""
    if place[:2] == ("fleet", "compute") and len(place) > 2:
        return ComputeSection
    owners: dict[str, type[BaseModel]] = {"fleet": FleetSection}
    owners |= {"printers": PrinterSection, "defaults": PrinterSection}
    return owners.get(str(place[0]), Fleet) if len(place) > 1 else Fleet
