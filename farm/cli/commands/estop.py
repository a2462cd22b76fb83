"""`farm estop`: the emergency stop. It needs neither the daemon nor an agent, as both may hang."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.printers import PROFILES, firmware_of
from drivers.records import StartFile
from farm.cli import completion
from farm.cli.client import estop_socket
from farm.cli.client.estop_socket import Said, Say
from farm.cli.display.console import print_json
from farm.cli.options import Json, placed
from farm.errors import FarmError, FleetFileError, NoSuchThing
from farm.fleet_file import load_fleet
from farm.paths import Places
from farm.text import flatten_text

if TYPE_CHECKING:
    from drivers.safety.estop import Stopped, Target, Tell

    Stop = Callable[[Tell], Stopped]


@placed
def estop(
    places: Places,
    printers: Annotated[
        list[str] | None,
        typer.Argument(help="The printers to stop; none: all.", autocompletion=completion.printers),
    ] = None,
    asked: Annotated[bool, typer.Option("--asked", hidden=True)] = False,
    json: Json = False,
) -> None:
    """Stop printers at once by resetting their boards, even if the daemon and the agents hang."""
    if asked:
        estop_socket.answer(sys.stdin, sys.stdout, partial(stop_all, places))
        return
    ended: list[Said] = []

    def say(said: Said) -> None:
        if said.seen_off is not None:
            ended.append(said)
        if not json:
            print_line(said)

    way = estop_socket.way(places)
    try:
        if way is not None:
            estop_socket.press(way, printers or [], say)
        else:
            stop_all(places, printers or [], say)
    finally:
        if json:
            rows = [said.model_dump() for said in sorted(ended, key=lambda said: said.printer)]
            print_json({"schema": 1, "printers": rows})


def stop_all(places: Places, printers: Iterable[str], say: Say) -> None:
    """Stop the printers of these names, all where there is none.

    Raises
    ------
    NoSuchThing
        Of what no printer is called; the others are stopped.
    FarmError
        Of those whose heaters were not seen off, or which were not seen to stand still.
    """
    began_s = time.time()
    targets, trouble = find_targets(places)
    if not targets and trouble is not None:
        raise trouble
    names = list(printers)
    wanted = {name: targets[name] for name in names or targets if name in targets}
    say = one_at_a_time(say)
    hot, moving = [], []
    with ThreadPoolExecutor(max_workers=max(1, len(wanted))) as pool:
        tells = {name: partial(_go_on, say, name) for name in wanted}
        for done in as_completed([pool.submit(stop, tells[name]) for name, stop in wanted.items()]):
            result = done.result()
            after_s = None if result.cut_s is None else round(result.cut_s - began_s, 3)
            say(
                Said(
                    printer=result.printer,
                    text=result.text,
                    seen_off=result.seen_off,
                    still=result.still,
                    reset_after_s=after_s,
                )
            )
            if not result.seen_off:
                hot.append(result.printer)
            elif not result.still:
                moving.append(result.printer)
    unknown = [name for name in names if name not in targets]
    if unknown:
        raise NoSuchThing(f"there is no printer {' '.join(unknown)}; the farm has {' '.join(targets)}")
    if hot:
        raise FarmError(
            f"heaters not confirmed off: {' '.join(sorted(hot))}: switch these printers off by hand"
        )
    if moving:
        raise FarmError(
            f"standstill not confirmed: {' '.join(sorted(moving))}: check whether these printers still move"
        )


def print_line(said: Said) -> None:
    """Print what is said of a printer as one line in one write, so that lines never run into one another."""
    sys.stdout.write(f"{said.printer}: {flatten_text(said.text)}\n")
    sys.stdout.flush()


def one_at_a_time(say: Say) -> Say:
    """Have lines of several printers said one after the other, whatever thread they come from."""
    lock = Lock()

    def locked(said: Said) -> None:
        with lock:
            say(said)

    return locked


def find_targets(places: Places) -> tuple[dict[str, Stop], FleetFileError | None]:
    """How to stop every printer of the state folder and of `fleet.yaml`; a bad file hides no agent's."""
    from drivers.safety.estop import Target, known  # slow to load

    agents = known(places.state.root / "agents")
    targets: dict[str, Stop] = {name: _here(target) for name, target in agents.items()}
    try:
        fleet = load_fleet(places.fleet, frozenset(PROFILES))
    except FleetFileError as error:
        return targets, error
    for section in fleet.printers:
        name, relay = section.name, section.power_off_cmd
        if section.host is not None:
            start = StartFile(name, section.model, section.port, power_off_cmd=relay)
            way = (section.host, section.host_command, fleet.fleet.name)
            targets[name] = _there(*way, start)
        elif section.enabled and name not in targets:
            target = Target(name, section.port, places.state.agent(name), relay, firmware_of(section.model))
            targets[name] = _here(target)
    return targets, None


def _here(target: Target) -> Stop:
    from drivers.safety.estop import stop

    return lambda tell: stop(target, tell=tell)


def _there(host: str, command: str, farm: str, start: StartFile) -> Stop:
    from drivers.remote.bridge import stop_there  # slow to load, and most printers are on this host

    return lambda _: stop_there(host, command, farm, start)


def _go_on(say: Say, printer: str, text: str) -> None:
    """What is to be said of a printer before it has ended."""
    say(Said(printer=printer, text=text))
