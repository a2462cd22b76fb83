"""`farm discover`: what is plugged in, and whether the farm can stop it."""

from __future__ import annotations

import json as jsonlib
from pathlib import Path
from typing import Annotated

import typer

from drivers.errors import DriverError
from drivers.locks import AGENT_LOCK, held
from drivers.ports.port import NET
from drivers.printers.profiles import PROFILES
from farm.cli.options import Json, placed
from farm.config import PrinterSection, load_fleet
from farm.errors import ErrorCode, FarmError, NoSuchThing, Refused
from farm.paths import Places

_MODEL = "ultimaker2_plus"


@placed
def discover(
    places: Places,
    commission: Annotated[
        str | None,
        typer.Option(help="A printer of the fleet, or a port: reset its board and see it start again."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="It is idle: do not ask.")] = False,
    json: Json = False,
) -> None:
    """List the serial ports that are plugged in, and which printer each is; opens none of them."""
    sections = _printers(places)
    if commission is not None:
        _commission(places, sections, commission, yes)
        return
    from drivers.discovery import plugged  # slow to load, and an emergency stop does without it

    rows = plugged((section.name, section.port) for section in sections if section.host is None)
    if json:
        ports = [
            {"port": str(row.port), "device": str(row.device), "what": row.what, "printer": row.printer}
            for row in rows
        ]
        print(jsonlib.dumps({"schema": 1, "ports": ports}, indent=2))
        return
    if not rows:
        print("no serial port is plugged in; is the printer's cable in, and the printer switched on?")
    for row in rows:
        print(f"{row.port}  {row.what}  {row.printer or 'not in fleet.yaml'}")
    new = [row for row in rows if row.printer is None]
    if new:
        print(f"\nfor the printers among them, under `printers` in {places.fleet}:")
    taken = {section.name for section in sections}
    for row in new:
        print(_line(_name(taken), _MODEL, str(row.port)))
    if new:
        print("then `farm discover --commission PORT` says its model, and whether it can be stopped")


def _printers(places: Places) -> tuple[PrinterSection, ...]:
    """The fleet's; none where there is no fleet file yet."""
    if not places.fleet.exists():
        return ()
    return load_fleet(places.fleet, frozenset(PROFILES)).printers


def _same_port(wanted: str, section: PrinterSection) -> bool:
    """Whether that is this host's port of a printer, by any of its names."""
    if section.host is not None:
        return False
    same = wanted.startswith("/") and Path(wanted).resolve() == Path(section.port).resolve()
    return same or wanted == section.port


def _name(taken: set[str]) -> str:
    """A name that no printer has."""
    name = next(name for number in range(1, 1000) if (name := f"um2-{number:02}") not in taken)
    taken.add(name)
    return name


def _line(name: str, model: str, port: str) -> str:
    return f'  - {{name: {name}, model: {model}, port: "{port}"}}'


def _commission(places: Places, sections: tuple[PrinterSection, ...], wanted: str, yes: bool) -> None:
    """Reset the board of an idle printer, by its agent where that is running."""
    from drivers import discovery as drv

    section = next((one for one in sections if wanted == one.name or _same_port(wanted, one)), None)
    if section is None and not wanted.startswith(("/", NET)):
        names = " ".join(one.name for one in sections)
        raise NoSuchThing(f"there is no printer {wanted}; the fleet has {names or 'none'}; or name a port")
    if section is not None and section.host is not None:
        raise Refused(
            f"{section.name}: is on {section.host}: `farm cleared {section.name}` tries its reset there"
        )
    if section is not None and section.simulated:
        print(f"{section.name}: is simulated: nothing to see to")
        return
    if not yes:
        print(f"This resets the board of {wanted}, which ends what it prints from its card.")
        typer.confirm("Is it idle, and its bed as you want it?", abort=True)
    try:
        if section is not None and held(places.state.agent(section.name) / AGENT_LOCK):
            drv.commission_by_agent(places.state.agent(section.name))
            print(f"{section.name}: its board starts again when DTR is pulsed: it can be stopped")
            return
        folder = places.state.agent(section.name) if section is not None else None
        model = drv.commission(section.port if section is not None else wanted, folder)
    except DriverError as error:
        raise Refused(str(error)) from error
    print(f"{wanted}: its board starts again when DTR is pulsed: it can be stopped; it is an {model}")
    if section is None:
        print(_line(_name({one.name for one in sections}), model, wanted))
    elif section.model != model:
        raise FarmError(f"{section.name}: fleet.yaml says {section.model}: change it", ErrorCode.FLEET_FILE)
