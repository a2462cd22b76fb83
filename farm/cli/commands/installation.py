"""`farm discover`, `farm doctor` and `farm setup`: ports and installation of this host."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from drivers.errors import DriverError
from drivers.locks import AGENT_LOCK, is_locked
from drivers.ports import NET_PREFIX
from drivers.printers import PROFILES, find_firmware
from farm.cli.client import Client
from farm.cli.display import print_json
from farm.cli.options import Json, with_paths
from farm.config import PrinterSection
from farm.errors import ErrorCode, ExitCode, FarmError, NotFoundError, RefusedError
from farm.fleet_file import load_fleet
from farm.paths import FarmPaths

_DEFAULT_MODEL = "ultimaker2_plus"
_SCHEMA_VERSION = 1  # version of the schema of --json


@with_paths
def discover(
    paths: FarmPaths,
    commission: Annotated[
        str | None,
        typer.Option(help="Test whether the board of this printer, or the board on this port, can be reset."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="The printer is idle: do not ask.")] = False,
    json: Json = False,
) -> None:
    """List the plugged-in serial ports and their printers, without opening any of them."""
    sections = _load_printers(paths)
    if commission is not None:
        _commission_printer(paths, sections, commission, yes)
        return
    from drivers.discovery import list_plugged_devices  # slow to load

    rows = list_plugged_devices((section.name, section.port) for section in sections if section.host is None)
    if json:
        ports = [
            {
                "port": str(row.port),
                "device": str(row.device),
                "what": row.description,
                "printer": row.printer,
            }
            for row in rows
        ]
        print_json({"schema": _SCHEMA_VERSION, "ports": ports})
        return
    if not rows:
        print("no serial port found: check the USB cable, and that the printer is switched on")
    for row in rows:
        print(f"{row.port}  {row.description}  {row.printer or 'not in fleet.yaml'}")
    new_rows = [row for row in rows if row.printer is None]
    if new_rows:
        print(f"\nadd the new printers under `printers` in {paths.fleet}:")
    names = {section.name for section in sections}
    for row in new_rows:
        print(_format_entry(_make_name(names), _DEFAULT_MODEL, str(row.port)))
    if new_rows:
        print(
            "then test the emergency stop with `farm discover --commission PORT`, which also names the model"
        )


def _load_printers(paths: FarmPaths) -> tuple[PrinterSection, ...]:
    """Load the printers of the fleet file; return no printers if there is no file yet."""
    if not paths.fleet.exists():
        return ()
    return load_fleet(paths.fleet, frozenset(PROFILES)).printers


def _is_same_port(path: str, section: PrinterSection) -> bool:
    """Return whether a path names the port of a printer on this host, directly or through a symbolic link."""
    if section.host is not None:
        return False
    is_same_device = path.startswith("/") and Path(path).resolve() == Path(section.port).resolve()
    return is_same_device or path == section.port


def _make_name(names: set[str]) -> str:
    """Make a name that no printer has, and add it to `names`."""
    name = next(name for number in range(1, 1000) if (name := f"um2-{number:02}") not in names)
    names.add(name)
    return name


def _format_entry(name: str, model: str, port: str) -> str:
    return f'  - {{name: {name}, model: {model}, port: "{port}"}}'


def _commission_printer(
    paths: FarmPaths, sections: tuple[PrinterSection, ...], target: str, yes: bool
) -> None:
    """Reset the board of an idle printer, and check that it restarts; use the agent if one is running."""
    from drivers.discovery import verify_reset, verify_reset_through_agent

    section = next(
        (section for section in sections if target == section.name or _is_same_port(target, section)), None
    )
    if section is None and not target.startswith(("/", NET_PREFIX)):
        names = " ".join(section.name for section in sections)
        raise NotFoundError(
            f"there is no printer {target} (the fleet has {names or 'none'}); "
            "give the name of a printer, or a port such as /dev/ttyUSB0"
        )
    if section is not None and section.host is not None:
        raise RefusedError(
            f"{section.name} is on {section.host}: `farm cleared {section.name}` tests its reset there"
        )
    if section is not None and section.is_simulated:
        print(f"{section.name} is simulated: nothing to test")
        return
    if not yes:
        print(f"This resets the board of {target}, which ends a print from its SD card.")
        typer.confirm("Is the printer idle?", abort=True)
    try:
        if section is not None and is_locked(paths.state.find_agent_folder(section.name) / AGENT_LOCK):
            verify_reset_through_agent(paths.state.find_agent_folder(section.name))
            print(f"{section.name}: its board restarts when DTR is pulsed, so the printer can be stopped")
            return
        folder = paths.state.find_agent_folder(section.name) if section is not None else None
        firmware = find_firmware(_DEFAULT_MODEL if section is None else section.model)
        model = verify_reset(section.port if section is not None else target, folder, firmware)
    except DriverError as error:
        raise RefusedError(str(error)) from error
    print(f"{target}: its board restarts when DTR is pulsed, so the printer can be stopped; model: {model}")
    if section is None:
        print(_format_entry(_make_name({section.name for section in sections}), model, target))
    elif section.model != model:
        raise FarmError(
            f"the model of {section.name} is {model}, but fleet.yaml says {section.model}: correct it there",
            ErrorCode.FLEET_FILE,
        )


@with_paths
def doctor(paths: FarmPaths, json: Json = False) -> None:
    """Check database, files, agents, ports, CuraEngine, clock and disks, and say what to do.

    Ends with exit code 1 if there is a problem; warnings do not count.
    """
    from farm.doctor import Level, check_installation, collect_facts  # slow to load

    version = daemon_error = None
    try:
        version = Client(paths.socket).fetch_status().daemon.version
    except FarmError as error:
        daemon_error = str(error)
    findings = check_installation(collect_facts(paths, version, daemon_error))
    if json:
        rows = [
            {
                "check": finding.check,
                "level": str(finding.level),
                "text": finding.text,
                "action": finding.action,
            }
            for finding in findings
        ]
        print_json({"schema": _SCHEMA_VERSION, "findings": rows})
    else:
        for finding in findings:
            action = f"; {finding.action}" if finding.action else ""
            print(f"{finding.level:<8} {finding.check}: {finding.text}{action}")
    if any(finding.level is Level.PROBLEM for finding in findings):
        raise typer.Exit(ExitCode.FAILED)


def setup() -> None:
    """Install CuraEngine and its settings, and compile the planning code; run it after each update.

    This takes one to five minutes, or a few seconds if everything is installed. sudo may ask for a password.
    """
    from decompose.compilation import ensure_compiled  # slow to load
    from slicing.errors import EngineMissing
    from slicing.installation import install_cura
    from slicing.settings import find_engine, find_resources

    try:
        install_cura()
        print(f"CuraEngine is {find_engine()}, and its settings are in {find_resources().root}")
    except EngineMissing as error:
        raise FarmError(str(error), ErrorCode.ENGINE) from error
    print("compiling the planning code: one to five minutes ...", flush=True)
    ensure_compiled()
    print("everything is installed; `farm doctor` checks it")
