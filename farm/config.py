"""`fleet.yaml`: what a person says of the fleet, checked before anything acts on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Self
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

from farm.errors import FleetFileError
from farm.windows import Window, parse_window

SIMULATED = "sim://"
_FORWARDED = "rfc2217://"

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,40}$")]
Group = Annotated[str, Field(pattern=r"^[a-z_][a-z0-9_-]{0,31}$")]
Positive = Annotated[float, Field(gt=0)]


def _windows(written: object) -> object:
    """One window or a list of them, each as a person writes it."""
    lines = written if isinstance(written, list | tuple) else [written]
    return tuple(parse_window(line) if isinstance(line, str) else line for line in lines)


Windows = Annotated[tuple[Window, ...], BeforeValidator(_windows)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ComputeSection(_Section):
    """The keys under `fleet.compute`: what planning may use of this machine."""

    workers: Annotated[int, Field(ge=1, le=256)] | None = None  # as many as cores
    memory_gb: Annotated[float, Field(ge=1, allow_inf_nan=False)] | None = None  # for each worker


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
            raise ValueError("first_layers_attended needs `attended`: when is somebody there?")
        return self

    @field_validator("timezone")
    @classmethod
    def _known(cls, value: str) -> str:
        try:
            ZoneInfo(value)
        except (ZoneInfoNotFoundError, ValueError) as error:
            raise ValueError(f"{value!r} is no time zone; use a name like Europe/Berlin") from error
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
    host_command: str = "/opt/farm/.venv/bin/python -m drivers.bridge"  # what ssh starts there
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
        raise ValueError(f"{value!r} is no port: use a device path, rfc2217://HOST:PORT or sim://MODEL")

    @model_validator(mode="after")
    def _simulates_itself(self) -> Self:
        if self.simulated and self.port.removeprefix(SIMULATED).partition("?")[0] != self.model:
            raise ValueError(f"port {self.port} simulates another model than {self.model}")
        return self


class Fleet(_Section):
    """The whole file, with the defaults filled in."""

    fleet: FleetSection = FleetSection()
    printers: tuple[PrinterSection, ...]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names: set[str] = set()
        ports: dict[Path | str, str] = {}
        for printer in self.printers:
            if printer.name in names:
                raise ValueError(f"two printers are named {printer.name}: each needs a name of its own")
            names.add(printer.name)
            if not printer.unattended and not self.fleet.attended:
                raise ValueError(
                    f"{printer.name} has `unattended: false`: say `attended` hours under `fleet`"
                )
            if printer.simulated:
                continue
            here = printer.host is None and printer.port.startswith("/")
            port = Path(printer.port).resolve() if here else f"{printer.host}:{printer.port}"
            if port in ports:
                raise ValueError(
                    f"{ports[port]} and {printer.name} are on one port ({printer.port}): "
                    "a port belongs to one printer; see `ls -l /dev/serial/by-path`"
                )
            ports[port] = printer.name
        if self.fleet.time_scale != 1 and not all(printer.simulated for printer in self.printers):
            raise ValueError(
                "time_scale must be 1 unless every port is sim://: a real printer has no fast clock"
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
    except (OSError, UnicodeDecodeError) as error:
        raise FleetFileError(f"{path}: cannot be read ({error}); name another file with --fleet") from error
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        raw = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        raise FleetFileError(f"{where}: not YAML: {getattr(error, 'problem', None) or error}") from error
    if not isinstance(raw, dict) or not isinstance(raw.get("printers"), list):
        raise FleetFileError(f"{path}: needs a list `printers`; see the example in the README")
    defaults = raw.pop("defaults", None) or {}
    if not isinstance(defaults, dict):
        raise FleetFileError(f"{path}:{_line(node, ('defaults',))}: `defaults` must hold printer keys")
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


def _mistake(path: Path, node: yaml.Node | None, place: tuple[str | int, ...], message: str) -> str:
    """One line: the file, the line where a person wrote it, the field, and what is wrong."""
    written = _written(node, place)
    field = ".".join(map(str, written))
    return f"{path}:{_line(node, written)}: " + (f"{field}: {message}" if field else message)


def _first_mistake(path: Path, node: yaml.Node | None, error: ValidationError) -> str:
    first = error.errors()[0]
    place = _written(node, first["loc"])
    if first["type"] == "extra_forbidden":
        owners: dict[str, type[BaseModel]] = {"fleet": FleetSection}
        owners |= {"printers": PrinterSection, "defaults": PrinterSection}
        owner = owners.get(str(place[0]), Fleet) if len(place) > 1 else Fleet
        if place[:2] == ("fleet", "compute") and len(place) > 2:
            owner = ComputeSection
        message = f"unknown key; known are {', '.join(owner.model_fields)}"
    else:
        message = first["msg"].removeprefix("Value error, ")
    return _mistake(path, node, first["loc"], message)


def _written(node: yaml.Node | None, place: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Where a person wrote what is found at `place`: a printer's key may stand in `defaults`."""
    if len(place) < 3 or place[0] != "printers":
        return place
    own = _find(node, place[:2])
    shared = _find(node, ("defaults",))
    if any(key == place[2] for key, _ in _children(own)):
        return place
    return ("defaults", *place[2:]) if any(key == place[2] for key, _ in _children(shared)) else place


def _find(node: yaml.Node | None, place: tuple[str | int, ...]) -> yaml.Node | None:
    for step in place:
        node = next((child for key, child in _children(node) if key == step), None)
    return node


def _line(node: yaml.Node | None, place: tuple[str | int, ...]) -> int:
    """The line (from 1) of the deepest node on the way to `place`."""
    line = 1
    for step in place:
        for key, child in _children(node):
            if key == step:
                node = child
                line = child.start_mark.line + 1
                break
        else:
            break
    return line


def _children(node: yaml.Node | None) -> Iterator[tuple[Any, yaml.Node]]:
    if isinstance(node, yaml.MappingNode):
        yield from ((key.value, value) for key, value in node.value)
    elif isinstance(node, yaml.SequenceNode):
        yield from enumerate(node.value)
