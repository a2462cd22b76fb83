"""`farm estop`: it needs neither the daemon nor an agent, for both may hang."""

from __future__ import annotations

import json as jsonlib
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from typing import Annotated

import typer

from drivers import estop as drv
from drivers.profiles import PROFILES
from drivers.start import Start
from farm.cli.options import Json, placed
from farm.config import load_fleet
from farm.errors import FarmError, FleetFileError, NoSuchThing
from farm.paths import Places

Stop = Callable[[drv.Tell], drv.Stopped]


@placed
def estop(
    places: Places,
    printers: Annotated[
        list[str] | None, typer.Argument(help="The printers to stop; all where none.")
    ] = None,
    json: Json = False,
) -> None:
    """Stop printers at once by resetting their boards, even where daemon and agents hang."""
    began_s = time.time()
    targets, trouble = find_targets(places)
    if not targets and trouble is not None:
        raise trouble
    wanted = {name: targets[name] for name in printers or targets if name in targets}
    results = []
    with ThreadPoolExecutor(max_workers=max(1, len(wanted))) as hands:
        tells = {name: _say_nothing if json else partial(_say, name) for name in wanted}
        for done in as_completed([hands.submit(stop, tells[name]) for name, stop in wanted.items()]):
            result = done.result()
            results.append(result)
            if not json:
                _say(result.printer, result.text)
    if json:
        rows = [
            {
                "printer": result.printer,
                "seen_off": result.seen_off,
                "reset_after_s": None if result.cut_s is None else round(result.cut_s - began_s, 3),
                "text": result.text,
            }
            for result in sorted(results, key=lambda result: result.printer)
        ]
        print(jsonlib.dumps({"schema": 1, "printers": rows}, indent=2))
    unknown = [name for name in printers or () if name not in targets]
    if unknown:
        raise NoSuchThing(f"there is no printer {' '.join(unknown)}; the farm has {' '.join(targets)}")
    hot = sorted(result.printer for result in results if not result.seen_off)
    if hot:
        raise FarmError(f"not seen off: {' '.join(hot)}: switch them off by hand")


def find_targets(places: Places) -> tuple[dict[str, Stop], FleetFileError | None]:
    """How to stop every printer of the state folder and of `fleet.yaml`; a bad file hides no agent's."""
    known = drv.known(places.state.root / "agents")
    targets: dict[str, Stop] = {name: _here(target) for name, target in known.items()}
    try:
        fleet = load_fleet(places.fleet, frozenset(PROFILES))
    except FleetFileError as error:
        return targets, error
    for section in fleet.printers:
        name, relay = section.name, section.power_off_cmd
        if section.host is not None:
            start = Start(name, section.model, section.port, power_off_cmd=relay)
            way = (section.host, section.host_command, fleet.fleet.name)
            targets[name] = _there(*way, start)
        elif section.enabled and name not in targets:
            target = drv.Target(name, section.port, places.state.agent(name), relay)
            targets[name] = _here(target)
    return targets, None


def _here(target: drv.Target) -> Stop:
    return lambda tell: drv.stop(target, tell=tell)


def _there(host: str, command: str, farm: str, start: Start) -> Stop:
    from drivers import bridge  # slow to load, and most printers are on this host

    return lambda _: bridge.stop_there(host, command, farm, start)


def _say(printer: str, text: str) -> None:
    print(f"{printer}: {text}", flush=True)


def _say_nothing(text: str) -> None:
    """For --json: one object at the end."""
