"""`farm estop`: the emergency stop. It needs neither the daemon nor an agent, because both may hang."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from queue import Empty, Queue
from threading import Lock
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from drivers.printers import PROFILES, find_firmware
from farm.cli import completion
from farm.cli.estop_socket import ReportCallback, StopReport, find_estop_socket, request_stop, serve_request
from farm.cli.options import Json, with_paths
from farm.errors import FarmError, FleetFileError, NotFoundError
from farm.fleet_file import load_fleet
from farm.paths import FarmPaths
from farm.text import flatten_text

if TYPE_CHECKING:
    from drivers.records import StartFile
    from drivers.safety import ProgressCallback, StopResult, StopTarget

    Stop = Callable[[ProgressCallback], StopResult]
    Target: TypeAlias = "Stop | HostTarget"

_POLL_INTERVAL_S = 0.2


@with_paths
def estop(
    paths: FarmPaths,
    printers: Annotated[
        list[str] | None,
        typer.Argument(help="The printers to stop; default: all.", autocompletion=completion.printers),
    ] = None,
    serves_request: Annotated[bool, typer.Option("--asked", hidden=True)] = False,
    json: Json = False,
) -> None:
    """Stop printers at once by resetting their boards, even if the daemon and the agents hang."""
    if serves_request:
        serve_request(sys.stdin, sys.stdout, partial(stop_all, paths))
        return
    outcomes: list[StopReport] = []

    def report(line: StopReport) -> None:
        if line.seen_off is not None:
            outcomes.append(line)
        if not json:
            print_report(line)

    socket = find_estop_socket(paths)
    try:
        if socket is not None:
            request_stop(socket, printers or [], report)
        else:
            stop_all(paths, printers or [], report)
    finally:
        if json:
            from farm.cli.display.console import print_json  # slow to load

            rows = [line.model_dump() for line in sorted(outcomes, key=lambda line: line.printer)]
            print_json({"schema": 1, "printers": rows})


def stop_all(paths: FarmPaths, printers: Iterable[str], report: ReportCallback) -> None:
    """Stop the named printers, or all printers if no name is given.

    Raises
    ------
    NotFoundError
        If a name is unknown; the other printers are stopped.
    FarmError
        If some heaters are not confirmed to be off, or some printers are not confirmed to stand still.
    """
    start_s = time.time()
    targets, fleet_error = find_targets(paths)
    if not targets and fleet_error is not None:
        raise fleet_error
    names = list(printers)
    selected_targets = {name: targets[name] for name in names or targets if name in targets}
    report = synchronise_reports(report)
    hot_printers, moving_printers = [], []
    for result in _run_stops(selected_targets, report):
        report(_describe_outcome(result, start_s))
        if not result.is_confirmed_off:
            hot_printers.append(result.printer)
        elif not result.is_still:
            moving_printers.append(result.printer)
    unknown_names = [name for name in names if name not in targets]
    if unknown_names:
        raise NotFoundError(
            f"there is no printer {' '.join(unknown_names)}; the farm has {' '.join(targets)}"
        )
    if hot_printers:
        raise FarmError(
            f"heaters not confirmed off: {' '.join(sorted(hot_printers))}: switch these printers off by hand"
        )
    if moving_printers:
        raise FarmError(
            f"standstill not confirmed: {' '.join(sorted(moving_printers))}: "
            "check whether these printers still move"
        )


def _run_stops(targets: Mapping[str, Target], report: ReportCallback) -> Iterator[StopResult]:
    """Stop printers in parallel, with one connection to each host service; yield each result."""
    by_host: dict[tuple[str, str, str], list[StartFile]] = {}
    results: Queue[StopResult] = Queue()
    with ThreadPoolExecutor(max_workers=max(1, len(targets))) as pool:
        stops = []
        for name, target in targets.items():
            if callable(target):
                stops.append(pool.submit(_run_stop, target, partial(_report_progress, report, name), results))
            else:
                by_host.setdefault(target.connection, []).append(target.start_file)
        if by_host:
            from drivers.host.stop import stop_printers_on_host  # slow to load

            stops += [
                pool.submit(stop_printers_on_host, *key, start_files, results.put)
                for key, start_files in by_host.items()
            ]
        for _ in targets:
            while True:
                with suppress(Empty):
                    yield results.get(timeout=_POLL_INTERVAL_S)
                    break
                for stop in stops:
                    if stop.done():
                        stop.result()  # raises the error of a failed stop


def _run_stop(stop: Stop, notify: ProgressCallback, results: Queue[StopResult]) -> None:
    results.put(stop(notify))


def _describe_outcome(result: StopResult, start_s: float) -> StopReport:
    return StopReport(
        printer=result.printer,
        text=result.text,
        seen_off=result.is_confirmed_off,
        still=result.is_still,
        reset_after_s=None if result.reset_s is None else round(result.reset_s - start_s, 3),
    )


def _report_progress(report: ReportCallback, printer: str, text: str) -> None:
    """Report the progress of a stop that has not ended."""
    report(StopReport(printer=printer, text=text))


def print_report(line: StopReport) -> None:
    """Print a report as one line, in one write, so that lines of different printers never mix."""
    sys.stdout.write(f"{line.printer}: {flatten_text(line.text)}\n")
    sys.stdout.flush()


def synchronise_reports(report: ReportCallback) -> ReportCallback:
    """Return a function that calls `report` under a lock, so that several threads may call it."""
    lock = Lock()

    def report_with_lock(line: StopReport) -> None:
        with lock:
            report(line)

    return report_with_lock


@dataclass(frozen=True, slots=True)
class HostTarget:
    """Printer on another host, whose host service can stop several printers over one connection.

    Attributes
    ----------
    connection
        The host, the command that runs `farm host` there, and the name of the farm.
    start_file
        Start file of the printer's agent: the printer's name, model, port and mains relay.
    """

    connection: tuple[str, str, str]
    start_file: StartFile


def find_targets(paths: FarmPaths) -> tuple[dict[str, Target], FleetFileError | None]:
    """Find the target of the stop for each printer that has an agent folder or is in `fleet.yaml`.

    Disabled printers on this host without an agent folder are left out. If `fleet.yaml` cannot be read, only
    the printers with an agent folder are returned, with the error.
    """
    from drivers.records import StartFile  # slow to load
    from drivers.remote import runs_host_service
    from drivers.safety import StopTarget, list_targets

    agents = list_targets(paths.state.root / "agents")
    targets: dict[str, Target] = {name: _make_local_stop(target) for name, target in agents.items()}
    try:
        fleet = load_fleet(paths.fleet, frozenset(PROFILES))
    except FleetFileError as error:
        return targets, error
    for section in fleet.printers:
        name, relay = section.name, section.power_off_cmd
        if section.host is not None:
            start_file = StartFile(name, section.model, section.port, power_off_cmd=relay)
            connection = (section.host, section.host_command, fleet.fleet.name)
            has_service = runs_host_service(section.host_command)
            targets[name] = (
                HostTarget(connection, start_file)
                if has_service
                else _make_remote_stop(*connection, start_file)
            )
        elif section.enabled and name not in targets:
            folder, firmware = paths.state.find_agent_folder(name), find_firmware(section.model)
            target = StopTarget(name, section.port, folder, firmware, relay)
            targets[name] = _make_local_stop(target)
    return targets, None


def _make_local_stop(target: StopTarget) -> Stop:
    from drivers.safety import stop_printer

    return lambda notify: stop_printer(target, notify=notify)


def _make_remote_stop(host: str, command: str, farm: str, start_file: StartFile) -> Stop:
    from drivers.remote import stop_over_ssh  # slow to load, and most printers are on this host

    return lambda _: stop_over_ssh(host, command, farm, start_file)
