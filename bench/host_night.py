"""Night of a farm with printers on several hosts, during which hosts fail and are updated; needs root.

    PYTHONPATH=tests/support python -m bench.host_night --json
    PYTHONPATH=tests/support python -m bench.host_night --hosts 4 --printers 40 --scale 60 --seed 3

The night is that of `bench.night`, with real services, agents and emulators in a network namespace for each
host. At random moments a host's service is killed, its network is cut for a time, or the whole host fails and
comes back; in that case its agents are killed too, so its prints fail. While all printers print, the
farm is switched to its next version, installed from its own wheel, and the agents are updated to it.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from bench.night import Night, make_parser
from bench.process_use import read_cpu_s
from drivers.emulator.launch import Command, control, is_running
from farm import api
from farm.errors import FarmError
from farm.state.storage import Store
from farms.installed_version import Versions  # type: ignore[import-not-found]  # in tests/support
from hosts.network_hosts import NetworkHosts  # type: ignore[import-not-found]
from hosts.virtual_network import find_obstacle  # type: ignore[import-not-found]

OLD_VERSION, NEW_VERSION = "1.0.0", "1.0.1"
UPDATE_SHARE = 0.3  # printed share of the first plates when the new version is installed
# Wall seconds for which a host is away; after 30 s it counts as lost.
MIN_ABSENCE_S, MAX_ABSENCE_S = 5.0, 60.0
SERVICE_END_S = 90.0  # seconds of wall-clock time until a service without a daemon ends: 60, and a margin
SAMPLE_S = 20.0  # time between two samples of CPU time


class HostFault(StrEnum):
    """Fault of a host."""

    SERVICE = "service killed"
    NETWORK = "network cut"
    POWER = "host off"


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """Fault of a host at a moment of the night.

    Attributes
    ----------
    at_s
        Farm seconds after the first print began.
    duration_s
        Wall seconds until a cut network or a host is back.
    """

    at_s: float
    kind: HostFault
    host: str
    duration_s: float


def plan_faults(
    count: int, hosts: list[str], spans_s: list[tuple[float, float]], rng: random.Random
) -> list[PlannedFault]:
    """Plan faults of hosts over spans of farm seconds, each kind equally often, in order of time."""
    kinds = [list(HostFault)[index % len(HostFault)] for index in range(count)]
    faults = [
        PlannedFault(
            rng.uniform(*rng.choice(spans_s)),
            kind,
            rng.choice(hosts),
            rng.uniform(MIN_ABSENCE_S, MAX_ABSENCE_S),
        )
        for kind in kinds
    ]
    return sorted(faults, key=lambda fault: fault.at_s)


class CpuMeter:
    """Meter of the share of a core that processes use between samples some seconds apart."""

    def __init__(self, list_processes: Callable[[], list[int]]) -> None:
        self._list_processes = list_processes
        self._sampled_s = -SAMPLE_S
        self._used_s: dict[int, float] = {}
        self.shares: list[float] = []

    def sample(self) -> None:
        """Take a sample if it is due; processes that started or ended since the last one do not count."""
        now_s = time.monotonic()
        elapsed_s = now_s - self._sampled_s
        if elapsed_s < SAMPLE_S:
            return
        cpu_times_s = {
            pid: cpu_s for pid in self._list_processes() if (cpu_s := _read_running_cpu_s(pid)) is not None
        }
        if self._used_s:
            common_pids = cpu_times_s.keys() & self._used_s.keys()
            self.shares.append(sum(cpu_times_s[pid] - self._used_s[pid] for pid in common_pids) / elapsed_s)
        self._sampled_s, self._used_s = now_s, cpu_times_s


def _read_running_cpu_s(pid: int) -> float | None:
    """Read the CPU seconds of a process; None if it has ended."""
    with suppress(OSError):
        return read_cpu_s(pid)
    return None


class HostNight(Night):
    """Farm on several hosts for one night."""

    def __init__(self, folder: Path, args: argparse.Namespace) -> None:
        names = [f"pc-{number}" for number in range(1, args.hosts + 1)]
        (folder / "versions").mkdir()
        self.versions = Versions(folder / "versions")
        for version in (OLD_VERSION, NEW_VERSION):
            self.versions.install(version)
        self.versions.use(OLD_VERSION)
        program = self.versions.link / "bin" / "farm"
        self.hosts = NetworkHosts(folder / "hosts", names, "night", program)
        os.environ["FARM_SSH"] = self.hosts.ssh
        super().__init__(folder, args)
        self.command = [str(program)]
        spans_s = [(300.0, self.plate_s), (self.back_after_s, self.back_after_s + 2 * self.plate_s)]
        self.faults = plan_faults(args.faults, names, spans_s, random.Random(args.seed))
        self.fault_counts: Counter[str] = Counter()
        self._return_times_s: dict[str, float] = {}  # return of each absent host, on the monotonic clock
        self._updated_at_s: float | None = None  # elapsed farm seconds
        self._is_update_pending = False
        self._daemon_pid = 0
        self._meter = CpuMeter(lambda: [self._daemon_pid, *self.hosts.list_processes()])

    def _find_host(self, name: str) -> str:
        return f"pc-{self.names.index(name) % int(self.args.hosts) + 1}"

    def _describe_printer(self, seed: int, name: str) -> dict[str, str]:
        host = self._find_host(name)
        entry = super()._describe_printer(seed, name)
        return {**entry, "host": host, "host_command": self.hosts.make_command(host)}

    def _find_agent_folder(self, name: str) -> Path:
        folder: Path = self.hosts.paths[self._find_host(name)].find_agent_folder(name)
        return folder

    def _cause_failures(self, view: api.Status, job: api.JobView) -> None:
        super()._cause_failures(view, job)
        elapsed_s = job.elapsed_s or 0.0
        if view.daemon.pid != self._daemon_pid:  # a new daemon does not continue an update
            self._daemon_pid = view.daemon.pid
            self._is_update_pending = self._updated_at_s is not None
        if self._is_update_pending:
            self._begin_update()
        self._meter.sample()
        self._reconnect_hosts()
        if self._updated_at_s is None and elapsed_s > UPDATE_SHARE * self.plate_s:
            self._updated_at_s = elapsed_s
            self.versions.use(NEW_VERSION)
            os.kill(view.daemon.pid, signal.SIGKILL)
            self.run_farm("up")
        while self.faults and elapsed_s >= self.faults[0].at_s:
            self._cause_fault(self.faults.pop(0))

    def _begin_update(self) -> None:
        """Begin the update once all hosts are connected, with services of the new version."""
        hosts = self.client.fetch_hosts().hosts
        if all(host.connected and host.version == NEW_VERSION for host in hosts):
            self._is_update_pending = False
            with suppress(FarmError):  # all agents have been updated
                self.client.update_hosts()

    def _cause_fault(self, fault: PlannedFault) -> None:
        self.fault_counts[fault.kind] += 1
        if fault.kind is not HostFault.SERVICE:
            self.hosts.cut(fault.host)
            return_s = time.monotonic() + fault.duration_s
            self._return_times_s[fault.host] = max(return_s, self._return_times_s.get(fault.host, 0.0))
        if fault.kind is not HostFault.NETWORK:
            self.hosts.kill_service(fault.host)
        if fault.kind is HostFault.POWER:
            printers = [name for name in self.names if self._find_host(name) == fault.host]
            self.hosts.kill_agents(fault.host, printers)

    def _reconnect_hosts(self, at_once: bool = False) -> None:
        for host, return_s in list(self._return_times_s.items()):
            if at_once or time.monotonic() >= return_s:
                self.hosts.reconnect(host)
                del self._return_times_s[host]

    def _compute_figures(self, job: api.JobView, wall_s: float) -> dict[str, object]:
        with Store(self.state.books) as store:
            events = Counter(kind for _, kind, _ in store.read_all_events())
        agents = [agent for host in self.client.fetch_hosts().hosts for agent in host.agents]
        shares = self._meter.shares or [0.0]
        return {
            **super()._compute_figures(job, wall_s),
            "hosts": self.args.hosts,
            **{kind.replace(" ", "_"): self.fault_counts[kind] for kind in HostFault},
            "hosts_lost": events["HostLost"],
            "hosts_back": events["HostConnected"],
            "agents_updated": sum(
                self.versions.find_version(agent.installation) == NEW_VERSION for agent in agents
            ),
            "agents": len(agents),
            "updated_at_s": round(self._updated_at_s or 0.0),
            "cpu_share": round(sum(shares) / len(shares), 2),
            "cpu_share_max": round(max(shares), 2),
        }

    def _stop(self) -> None:
        self._reconnect_hosts(at_once=True)
        super()._stop()

    def count_remaining_processes(self) -> int:
        """Count the processes that still run on the hosts once their services have had time to end."""
        deadline_s = time.monotonic() + SERVICE_END_S
        while self.hosts.list_processes() and time.monotonic() < deadline_s:
            time.sleep(1.0)
        return len(self.hosts.list_processes())

    def close(self) -> None:
        """End the remaining processes, and remove the hosts."""
        for name in self.names:
            if is_running(self._find_emulator(name)):
                control(self._find_emulator(name), Command.POWER_OFF)
        self.hosts.close()


def parse_options(arguments: list[str] | None = None) -> argparse.Namespace:
    """Parse the options."""
    parser = make_parser(__doc__)
    parser.add_argument("--hosts", type=int, default=4)
    parser.add_argument("--faults", type=int, default=12, help="number of faults of hosts")
    parser.set_defaults(printers=40, plates=100, moves=400, scale=60, away_h=3.0, patience_s=1800.0)
    return parser.parse_args(arguments)


def run_night(folder: Path, args: argparse.Namespace) -> dict[str, object]:
    """Run a night in an existing folder, and return its figures."""
    night = HostNight(folder, args)
    try:
        figures = night.run()
        return {**figures, "processes_left": night.count_remaining_processes()}
    finally:
        night.close()


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    obstacle = find_obstacle()
    if obstacle is not None:
        raise SystemExit(f"not run: {obstacle}")
    args = parse_options()
    with tempfile.TemporaryDirectory(prefix="night-") as folder:
        if args.keep is not None:
            args.keep.mkdir(parents=True)
        figures = run_night(args.keep or Path(folder), args)
    print(json.dumps(figures, indent=2) if args.json else "\n".join(f"{k}: {v}" for k, v in figures.items()))


if __name__ == "__main__":
    main()
