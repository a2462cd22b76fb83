"""Pydantic models of `fleet.yaml`, with the validation of its values."""

from __future__ import annotations

import re
import shlex
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from typing import Annotated, Self
from urllib.parse import urlsplit
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    SecretStr,
    field_validator,
    model_validator,
)

from farm.log_format import LogFormat
from farm.week_windows import Window, parse_window

SIMULATED_PREFIX = "sim://"
_RFC2217_PREFIX = "rfc2217://"
_SCHEDULER_PATTERN = re.compile(r"(tls|tcp)://([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):([0-9]{1,5})")

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,40}$")]
_MOVED_MODULES = {"drivers.bridge": "drivers.remote.bridge"}
"""Current name of each renamed module, by its former name, which an old fleet file may contain."""
Group = Annotated[str, Field(pattern=r"^[a-z_][a-z0-9_-]{0,31}$")]
PinFit = Annotated[float, Field(ge=0, le=2)]
PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False)]
KeyPath = tuple[str | int, ...]
"""Path of a value in the file: keys, and indices of lists."""


class FieldError(ValueError):
    """Error in a field whose validity depends on other fields; `key_path` is the path of this field."""

    def __init__(self, message: str, *key_path: str | int) -> None:
        super().__init__(message)
        self.key_path = key_path


def _parse_windows(value: object) -> object:
    """Parse one weekly time window, or a list of windows."""
    lines = value if isinstance(value, list | tuple) else [value]
    return tuple(line if isinstance(line, Window) else parse_window(str(line)) for line in lines)


Windows = Annotated[tuple[Window, ...], Field(max_length=7 * 24), BeforeValidator(_parse_windows)]
"""Weekly time windows, at most one for each hour of a week."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def check_scheduler(value: str) -> str:
    """Check the address of a scheduler. Raises ValueError, whose message shows a valid form."""
    match = _SCHEDULER_PATTERN.fullmatch(value)
    if match is None or not 0 < int(match[3]) < 65536:
        raise ValueError(f"{value!r} is not the address of a scheduler: use tls://HOST:PORT")
    if match[1] == "tcp" and match[2] not in ("localhost", "127.0.0.1", "[::1]"):
        raise ValueError(f"{value!r} is not encrypted: use tls://HOST:PORT, except on this computer")
    return value


class ComputeSection(_Section):
    """The keys under `fleet.compute`: limits on the resources that planning uses."""

    workers: Annotated[int, Field(ge=1, le=256)] | None = None  # None: one for each core
    memory_gb: Annotated[float, Field(ge=1, allow_inf_nan=False)] | None = None  # memory of each worker
    budget_s: Annotated[float, Field(ge=0, le=900)] = 20.0  # CPU time to search for a job's decomposition
    scheduler: str | None = None  # address of the scheduler of a Dask cluster that computes plans
    certificates: Path | None = None  # folder with ca.pem, cert.pem and key.pem

    @field_validator("scheduler")
    @classmethod
    def _check_scheduler(cls, value: str | None) -> str | None:
        return value if value is None else check_scheduler(value)

    @model_validator(mode="after")
    def _check_certificates(self) -> Self:
        if (self.scheduler or "").startswith("tls:") and self.certificates is None:
            raise FieldError(
                "is needed for a scheduler with TLS: a folder with ca.pem, cert.pem and key.pem",
                "fleet",
                "compute",
                "certificates",
            )
        return self


class UploadsSection(_Section):
    """The keys under `fleet.uploads`: limits on submitted models."""

    model_gb: Annotated[float, Field(gt=0, le=64)] = 2.0  # size of one model
    at_once: Annotated[int, Field(ge=1, le=64)] = 8  # number of models received and checked at the same time
    free_gb: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.5  # space that uploads leave free
    open_jobs: Annotated[int, Field(ge=1)] = 1000  # number of jobs that have not ended


class KeepSection(_Section):
    """The keys under `fleet.keep`: limits on old events and on files of ended jobs, except pictures."""

    # Maximum age of events and of files, and maximum size of all files; the oldest are deleted first.
    days: Annotated[float, Field(ge=2, allow_inf_nan=False)] = 90.0
    gb: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 50.0


class TlsSection(_Section):
    """The keys under `web.tls`: files in PEM format."""

    cert: Path
    key: Path


_WEB_URL_PATTERN = re.compile(r"https?://(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(:[0-9]{1,5})?/?")
_WEB_ADDRESS_PATTERN = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[0-9.]+|localhost):([0-9]{1,5})")


class WebSection(_Section):
    """The keys under `web`: the server for callers on the network."""

    listen: str = "127.0.0.1:8467"
    names: tuple[str, ...] = ()  # names of this host in URLs, in addition to its host name
    tls: TlsSection | None = None
    url: str | None = None  # URL of a proxy through which browsers reach this server

    @field_validator("listen")
    @classmethod
    def _check_listen(cls, value: str) -> str:
        match = _WEB_ADDRESS_PATTERN.fullmatch(value)
        try:
            is_valid = match is not None and 0 < int(match[2]) < 65536 and bool(_parse_address(match[1]))
        except ValueError:
            is_valid = False
        if not is_valid:
            raise ValueError(
                f"{value!r} is not an address: use ADDRESS:PORT, like 127.0.0.1:8467 or 0.0.0.0:8467"
            )
        return value

    @field_validator("names")
    @classmethod
    def _lower_names(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(name.lower().rstrip(".") for name in value)

    @field_validator("url")
    @classmethod
    def _check_url(cls, value: str | None) -> str | None:
        if value is not None and _WEB_URL_PATTERN.fullmatch(value) is None:
            raise ValueError(
                f"{value!r} is not the address of a host: use a URL like https://farm.lab.example"
            )
        return value if value is None else value.lower().rstrip("/")

    @property
    def address(self) -> tuple[str, int]:
        """IP address and port on which the server listens."""
        host, _, port = self.listen.rpartition(":")
        return str(_parse_address(host)), int(port)

    @property
    def is_local(self) -> bool:
        """True if only this host can reach the server."""
        return ip_address(self.address[0]).is_loopback

    @property
    def listen_url(self) -> str:
        """URL of the address on which the server listens."""
        return f"{self._scheme}://{self.listen}"

    @property
    def is_encrypted(self) -> bool:
        """True if browsers use HTTPS."""
        return self.tls is not None if self.url is None else self.url.startswith("https:")

    def find_browser_url(self, host: str) -> str:
        """Return the URL at which browsers reach the server.

        Parameters
        ----------
        host
            Name of this host, used if the server listens on all addresses.
        """
        if self.url is not None:
            return self.url
        address, port = self.address
        if self.names and not self.is_local:
            return f"{self._scheme}://{self.names[0]}:{port}"
        return f"{self._scheme}://{host}:{port}" if ip_address(address).is_unspecified else self.listen_url

    @property
    def _scheme(self) -> str:
        return "http" if self.tls is None else "https"


def _is_web_address(url: str) -> bool:
    """Return whether a text is an HTTP or HTTPS address."""
    try:
        parts = urlsplit(url)
        has_valid_port = parts.port != 0
    except ValueError:  # the port or an IPv6 address is invalid
        return False
    return has_valid_port and parts.scheme in ("http", "https") and bool(parts.hostname) and url.isprintable()


def _parse_address(host: str) -> IPv4Address | IPv6Address:
    return ip_address("127.0.0.1" if host == "localhost" else host.strip("[]"))


class FleetSection(_Section):
    """The keys under `fleet`."""

    name: Name = "farm"
    timezone: str = "UTC"
    time_scale: Annotated[float, Field(ge=1, le=1000)] = 1.0
    compute: ComputeSection = ComputeSection()
    uploads: UploadsSection = UploadsSection()
    keep: KeepSection = KeepSection()
    log: LogFormat = LogFormat.TEXT  # format of the daemon's log; json: one line of JSON for each record
    currency: Annotated[str, Field(min_length=1, max_length=8)] | None = None
    pin_fit_mm: PinFit | None = None  # clearance of a hole around its pin; see `farm coupon`
    attended: Windows = ()  # hours when somebody is present; empty: unknown
    quiet: Windows = ()  # hours when nothing may print
    first_layers_attended: bool = False  # first layers must end in attended hours
    max_heating: Annotated[int, Field(ge=1)] | None = None  # printers that may heat up at the same time
    approve: bool = False  # True: every job waits for `farm approve`
    materials: Path | None = None  # folder with material files in Cura's format, besides Cura's own
    group: Group = "farm"  # group of users that may use the daemon's socket, if that group exists
    notify: tuple[SecretStr, ...] = ()  # receivers of notices, as URLs of the library apprise
    operators: Group | None = None  # group that may approve, clear and resume; None: all users

    @model_validator(mode="after")
    def _check_attended(self) -> Self:
        if self.first_layers_attended and not self.attended:
            raise FieldError("needs `attended` hours under `fleet`", "fleet", "first_layers_attended")
        return self

    @field_validator("timezone")
    @classmethod
    def _check_timezone(cls, value: str) -> str:
        try:
            ZoneInfo(value)
        except (ZoneInfoNotFoundError, ValueError, OSError) as error:  # OSError if it is a folder
            raise ValueError(f"{value!r} is not a time zone; use a name like Europe/Berlin") from error
        return value


class PrinterSection(_Section):
    """One entry of `printers`."""

    name: Name
    model: str
    port: str
    material: str = "generic_pla"
    colour: str | None = None
    nozzle_mm: PositiveNumber = 0.4
    price_per_kg: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None  # price of its filament
    volume_mm: tuple[PositiveNumber, PositiveNumber, PositiveNumber] | None = None
    pin_fit_mm: PinFit | None = None  # clearance of a hole around its pin; None: the fleet's
    host: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.@-]*$")] | None = None  # host name for ssh
    host_command: str = (
        "/opt/farm/.venv/bin/python -m drivers.remote.bridge"  # command that ssh runs on the host
    )
    enabled: bool = True
    unattended: bool = True  # may print while nobody is present
    power_off_cmd: str | None = None  # command that switches the mains power off; {printer} becomes its name
    camera: SecretStr | None = None  # URL of a picture by its camera; {printer} becomes its name

    _material_kind: str | None = PrivateAttr(default=None)

    @property
    def material_kind(self) -> str | None:
        """Kind of its material, like PLA; None if it is not known."""
        return self._material_kind

    def has_material(self, material: str | None) -> bool:
        """Return whether the printer has a material, given by file name or kind; None: any material."""
        return material in (None, self.material, self._material_kind)

    def with_filament(self, material: str, kind: str | None, colour: str | None) -> Self:
        """Return the section with another colour and another material, given by file name and kind."""
        section = self.model_copy(update={"material": material, "colour": colour})
        section._material_kind = kind
        return section

    @property
    def camera_url(self) -> str | None:
        """URL of a picture by the printer's camera; it may contain a password. None if there is no camera."""
        return None if self.camera is None else self.camera.get_secret_value().replace("{printer}", self.name)

    @property
    def is_simulated(self) -> bool:
        """True if an emulator simulates the printer."""
        return self.port.startswith(SIMULATED_PREFIX)

    def compute_price(self, grams: float) -> float | None:
        """Return the price of an amount of filament in the fleet's currency; None if no price is known."""
        return None if self.price_per_kg is None else grams / 1000 * self.price_per_kg

    @field_validator("port")
    @classmethod
    def _check_port(cls, value: str) -> str:
        if value.startswith((SIMULATED_PREFIX, _RFC2217_PREFIX, "/")):
            return value
        if value.startswith("socket://"):
            raise ValueError("socket:// has no DTR, so a board could not be stopped: use rfc2217://HOST:PORT")
        raise ValueError(f"{value!r} is not a port: use a device path, rfc2217://HOST:PORT or sim://MODEL")

    @field_validator("host_command")
    @classmethod
    def _check_host_command(cls, value: str) -> str:
        for old, new in _MOVED_MODULES.items():
            if old in value.split():
                raise ValueError(f"{old} has moved: write {value.replace(old, new)!r}")
        return value

    @field_validator("power_off_cmd")
    @classmethod
    def _check_command(cls, value: str | None) -> str | None:
        try:
            words = value is None or shlex.split(value)
        except ValueError as error:
            raise ValueError(f"{value!r} is not a command: {error}") from error
        if not words:
            raise ValueError("is empty: leave it out if there is no relay")
        return value

    @field_validator("camera")
    @classmethod
    def _check_camera(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None and not _is_web_address(value.get_secret_value()):
            raise ValueError("must be the address of a still, like http://camera-1/snapshot.jpg")
        return value

    @model_validator(mode="after")
    def _check_simulation(self) -> Self:
        if self.is_simulated and self.port.removeprefix(SIMULATED_PREFIX).partition("?")[0] != self.model:
            raise ValueError(f"{self.name}: port {self.port} simulates a model other than {self.model}")
        return self


class Fleet(_Section):
    """The whole file, with defaults filled in."""

    fleet: FleetSection = FleetSection()
    web: WebSection | None = None  # None: no server for callers on the network
    printers: tuple[PrinterSection, ...]

    @model_validator(mode="after")
    def _check_printers(self) -> Self:
        names: set[str] = set()
        ports: dict[Path | str, str] = {}
        for number, printer in enumerate(self.printers):
            place = ("printers", number)
            if printer.name in names:
                problem = f"two printers are named {printer.name}: each needs a name of its own"
                raise FieldError(problem, *place, "name")
            names.add(printer.name)
            if not printer.unattended and not self.fleet.attended:
                problem = f"{printer.name} has `unattended: false`: this needs `attended` hours under `fleet`"
                raise FieldError(problem, *place, "unattended")
            if printer.is_simulated:
                continue
            is_local_device = printer.host is None and printer.port.startswith("/")
            port = Path(printer.port).resolve() if is_local_device else f"{printer.host}:{printer.port}"
            if port in ports:
                raise FieldError(
                    f"{ports[port]} and {printer.name} are on one port ({printer.port}): "
                    "a port belongs to one printer; see `ls -l /dev/serial/by-path`",
                    *place,
                    "port",
                )
            ports[port] = printer.name
        if self.fleet.time_scale != 1 and not all(printer.is_simulated for printer in self.printers):
            raise FieldError(
                "must be 1 unless every port is sim://: only simulated printers can run faster",
                "fleet",
                "time_scale",
            )
        return self

    def find_printer(self, name: str) -> PrinterSection:
        """Return the section of a printer. Raises KeyError if there is none."""
        return {printer.name: printer for printer in self.printers}[name]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(printer.name for printer in self.printers)

    @property
    def zone(self) -> ZoneInfo:
        return ZoneInfo(self.fleet.timezone)
