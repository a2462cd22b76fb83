"""Costs of a large printing fleet in the daemon: CPU time of an event, bytes of a commit, `farm status`.

``python -m bench.fleet_scale [--hosts N] [--printers N] [--idle N] [--plates N] [--plate-changes N]
[--seconds S] [--gcode-kb N] [--profile FILE] [--json]``.
The daemon is a separate process on a state folder with that many waiting plates; its agents only speak the
protocol, all in this process. First every printer gets a plate, then all print for `--seconds`, then
`--plate-changes` prints end one after the other: each bed is cleared, and its printer gets the next plate.

With `--hosts` the printers are spread over hosts, each with the real service of `farm host`, and the daemon
connects to each as over ssh. After the prints, one host is lost, then half of them. Then, if this computer
allows network namespaces (as root), packets are lost and delayed (`bench.fleets.faults`).

Costs are CPU time, which other load hardly changes. An event is anything that commits: a report of an
agent, a command of a person, a timer. The CPU time of reading from and writing to the socket counts only in
`cpu_share`, the daemon's share of a core while all printers print. `status_cpu_ms` is for the page of `farm
status`, and `status_json_cpu_ms` for `farm status --json`, both the worst of five. `start_commit_bytes` is
the largest commit of an event that starts a print, and `report_s` the wall time between two reports of a
printer. The delay of an event is the time from an agent's report to `/events`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from bench.fleets.agents.host_services import FARM, HostGroups, find_network_obstacle, make_paths
from bench.fleets.agents.protocol_agents import PORT, PRINTER_MODEL, ProtocolAgents
from bench.fleets.daemon_process import Daemon, EventFollower, NoticeReceiver
from bench.fleets.faults import (
    FIRST_HALF,
    FIRST_HOST,
    PrintingFleet,
    group_hosts,
    measure_event_delays,
    measure_loss,
    measure_poor_network,
)
from bench.fleets.measured_daemon import fill_books
from drivers.clock import Clock
from farm.paths import StateFolder, write_anchor

TIMEOUT_S = 600.0
STATUS_REQUESTS = 5
PLATES_PER_PRINTER = 10
_HOST_COMMAND = "farm host"
GOALS = {
    "event_median_ms": 5.0,
    "event_p99_ms": 20.0,
    "start_commit_bytes": 4096,
    "status_cpu_ms": 200.0,
    "cpu_share": 0.2,
}
HOST_GOALS = GOALS | {"status_cpu_ms": 300.0, "cpu_share": 0.5, "memory_mb": 400.0, "connect_s": 60.0}


@dataclass(frozen=True, slots=True)
class FleetSize:
    """Size of a measured fleet; see the options of `main`."""

    printers: int
    hosts: int
    idle: int
    plates: int
    plate_changes: int
    seconds: float
    gcode_kb: int
    profile: Path | None

    @property
    def printer_names(self) -> list[str]:
        """Names of the printers that print."""
        return [f"um2-{number:03d}" for number in range(1, self.printers + 1)]

    @property
    def idle_names(self) -> list[str]:
        """Names of the printers that no plate fits."""
        return [f"abs-{number:03d}" for number in range(1, self.idle + 1)]

    @property
    def host_names(self) -> list[str]:
        """Names of the hosts."""
        return [f"pc-{number:02d}" for number in range(1, self.hosts + 1)]

    def find_host(self, number: int) -> str:
        """Find the host of a printer by its number; empty if there are no hosts."""
        return self.host_names[number * self.hosts // (self.printers + self.idle)] if self.hosts else ""


def compute_percentile(values: Sequence[float], share: float) -> float:
    """Return the value that a share of the values does not exceed."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def write_state(size: FleetSize, folder: Path, notify: str) -> dict[str, Path]:
    """Write the fleet, the books and the G-code of the plates; return the folder of each agent."""
    state, rows, folders = StateFolder(folder), [], {}
    for number, name in enumerate([*size.printer_names, *size.idle_names]):
        host, row = size.find_host(number), {"name": name, "model": PRINTER_MODEL, "port": PORT}
        if number >= size.printers:
            row["material"] = "generic_abs"
        if host:
            row |= {"host": host, "host_command": _HOST_COMMAND}
        rows.append(row)
        folders[name] = (
            make_paths(folder / "hosts", host).find_agent_folder(name)
            if host
            else state.find_agent_folder(name)
        )
    fleet = {"fleet": {"name": FARM, "notify": [notify]}, "printers": rows}
    (folder / "fleet.yaml").write_text(yaml.safe_dump(fleet))
    write_anchor(state.clock, 1.0, time.time())
    fill_books(state.books, size.printer_names, size.plates)
    state.files.mkdir()
    (state.files / "g.gcode").write_bytes(b"G1 X10\n" * (size.gcode_kb * 1024 // 7))
    return folders


def measure(size: FleetSize) -> dict[str, Any]:
    """Run the whole measurement in a temporary folder."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        notices = stack.enter_context(contextlib.closing(NoticeReceiver()))
        folders = write_state(size, folder, notices.url)
        agents = stack.enter_context(contextlib.closing(ProtocolAgents(folders, Clock())))
        hosts_by_group = group_hosts(size.host_names)
        (folder / "hosts").mkdir(exist_ok=True)
        groups = HostGroups(
            folder / "hosts", hosts_by_group, bool(hosts_by_group) and find_network_obstacle() is None
        )
        stack.callback(groups.close)
        daemon = Daemon(folder, size.profile, groups.ssh if hosts_by_group else None)
        stack.callback(daemon.kill)
        return _run(daemon, agents, groups, notices, size)


def _run(
    daemon: Daemon, agents: ProtocolAgents, groups: HostGroups, notices: NoticeReceiver, size: FleetSize
) -> dict[str, Any]:
    hosts_by_group = group_hosts(size.host_names)
    figures = _wait_until_printing(daemon, agents, size)
    follower = EventFollower(daemon.socket)
    fleet = PrintingFleet(daemon, agents, groups, hosts_by_group, follower, notices)
    figures |= _measure_prints(fleet, size)
    figures["memory_mb"] = daemon.read_memory_mb()
    figures |= _measure_faults(fleet, size)
    period_s = figures.pop("period_s")
    return _summarise(daemon.stop(), daemon, size, period_s) | figures


def _wait_until_printing(daemon: Daemon, agents: ProtocolAgents, size: FleetSize) -> dict[str, Any]:
    """Wait until all printers print; return the wall and CPU seconds that this takes."""
    initial_cpu_s = daemon.read_cpu_s()
    _wait_for_prints(agents, size.printers)
    until_printing_s = time.monotonic() - daemon.started_s
    until_printing_cpu_s = daemon.read_cpu_s() - initial_cpu_s
    _wait_for(agents, daemon.is_answering, "the daemon to answer")
    agents.serve(3.0)
    return {"until_printing_s": until_printing_s, "until_printing_cpu_s": until_printing_cpu_s}


def _measure_prints(fleet: PrintingFleet, size: FleetSize) -> dict[str, Any]:
    """Measure the load of all prints and of `farm status`, and the delays of events."""
    daemon, agents = fleet.daemon, fleet.agents
    start_cpu_s, start_s = daemon.read_cpu_s(), time.monotonic()
    agents.serve(size.seconds)
    end_s = time.monotonic()
    cpu_share = (daemon.read_cpu_s() - start_cpu_s) / (end_s - start_s)
    status = _measure_requests(
        fleet, daemon.client.fetch_status_summary
    )  # first, so that it includes a cold cache
    full_status = _measure_requests(fleet, daemon.client.fetch_status)
    delays_s = measure_event_delays(fleet, size.plate_changes)
    _wait_for_prints(agents, size.printers)
    return {
        "period_s": (start_s, end_s),
        "cpu_share": cpu_share,
        "status_cpu_ms": 1000 * max(cpu_s for cpu_s, _ in status),
        "status_ms": 1000 * max(wall_s for _, wall_s in status),
        "status_json_cpu_ms": 1000 * max(cpu_s for cpu_s, _ in full_status),
        "event_delay_median_s": statistics.median(delays_s),
        "event_delay_max_s": max(delays_s),
    }


def _measure_requests(fleet: PrintingFleet, request: Callable[[], object]) -> list[tuple[float, float]]:
    """Send a request several times; return the daemon's CPU seconds and the wall-clock time of each in s."""
    durations_s = []
    for _ in range(STATUS_REQUESTS):
        start_cpu_s, start_s = fleet.daemon.read_cpu_s(), time.monotonic()
        request()
        wall_s = time.monotonic() - start_s
        durations_s.append((fleet.daemon.read_cpu_s() - start_cpu_s, wall_s))
        fleet.agents.serve(2.0)
    return durations_s


def _measure_faults(fleet: PrintingFleet, size: FleetSize) -> dict[str, Any]:
    """Measure the effects of lost hosts and of a poor network."""
    if not fleet.hosts_by_group:
        return {}
    figures: dict[str, Any] = {
        "one_host_lost": measure_loss(fleet, [FIRST_HOST]),
        "half_lost": measure_loss(
            fleet, [name for name in (FIRST_HOST, FIRST_HALF) if name in fleet.hosts_by_group]
        ),
    }
    if fleet.groups.uses_namespaces:
        figures["poor_network"] = measure_poor_network(fleet, size.seconds, min(size.plate_changes, 10))
    return figures


def _summarise(
    measures: dict[str, list[float]], daemon: Daemon, size: FleetSize, period_s: tuple[float, float]
) -> dict[str, Any]:
    """Summarise the daemon's own measurements."""
    reports = sum(period_s[0] <= at_s < period_s[1] for at_s in measures["snapshot_at_s"])
    return {
        "connect_s": max(measures["connected_at_s"]) - daemon.started_s,
        "report_s": (size.printers + size.idle) * (period_s[1] - period_s[0]) / max(1, reports),
        "events": len(measures["event_s"]),
        "event_median_ms": 1000 * statistics.median(measures["event_s"]),
        "event_p99_ms": 1000 * compute_percentile(measures["event_s"], 0.99),
        "event_max_ms": 1000 * max(measures["event_s"]),
        "report_median_ms": 1000 * statistics.median(measures["report_s"]),
        "timer_median_ms": 1000 * statistics.median(measures["timer_s"]),
        "commit_median_bytes": statistics.median(measures["commit_bytes"]),
        "commit_max_bytes": max(measures["commit_bytes"]),
        "start_commit_bytes": max(measures["start_bytes"]),
    }


def _wait_for_prints(agents: ProtocolAgents, printers: int) -> None:
    """Serve the agents until all printers print."""

    def are_all_printing() -> bool:
        agents.advance_heating()
        return len(agents.printing_names) == printers

    _wait_for(agents, are_all_printing, "all printers to print")


def _wait_for(agents: ProtocolAgents, condition: Callable[[], bool], condition_name: str) -> None:
    if not agents.serve(TIMEOUT_S, condition):
        raise RuntimeError(f"waited {TIMEOUT_S:.0f} s for {condition_name}")


def list_missed_goals(figures: dict[str, Any], goals: dict[str, float]) -> list[str]:
    """List the figures that miss their goals.

    A loss of hosts must cause one task and one notice, and end no print.
    """
    missed = [name for name, limit in goals.items() if figures[name] > limit]
    for name in ("one_host_lost", "half_lost"):
        loss = figures.get(name, {"tasks": 1, "notices": 1, "prints_ended": 0})
        missed += [name] if (loss["tasks"], loss["notices"], loss["prints_ended"]) != (1, 1, 0) else []
    return missed


def read_options() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--printers", type=int, default=200)
    parser.add_argument(
        "--hosts", type=int, default=0, help="hosts with their services; 0 for agents of this host"
    )
    parser.add_argument("--idle", type=int, default=0, help="additional printers, which no plate fits")
    parser.add_argument("--plates", type=int, help=f"{PLATES_PER_PRINTER} for each printer by default")
    parser.add_argument("--plate-changes", type=int, default=40, help="number of prints that end")
    parser.add_argument("--seconds", type=float, default=20.0, help="time for which all printers print")
    parser.add_argument("--gcode-kb", type=int, default=64, help="size of each plate's G-code")
    parser.add_argument("--profile", type=Path, help="file for the daemon's profile (cProfile)")
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    options = vars(read_options())
    as_json, plates = options.pop("json"), options.pop("plates")
    plates = PLATES_PER_PRINTER * options["printers"] if plates is None else plates
    size = FleetSize(plates=plates, **options)
    figures = measure(size)
    goals = HOST_GOALS if size.hosts else GOALS
    missed = list_missed_goals(figures, goals)
    if as_json:
        head = {name: getattr(size, name) for name in ("printers", "hosts", "idle", "plates", "gcode_kb")}
        print(json.dumps({"schema": 1, **head, **figures, "missed": missed}))
        return
    for name, value in figures.items():
        if isinstance(value, dict):
            numbers = {key: number for key, number in value.items() if isinstance(number, int | float)}
            print(f"{name:20} " + ", ".join(f"{key} {number:.3g}" for key, number in numbers.items()))
            continue
        goal = f"  (at most {goals[name]:g}{': missed' if name in missed else ''})" if name in goals else ""
        print(f"{name:20} {value:12.3f}{goal}")


if __name__ == "__main__":
    main()
