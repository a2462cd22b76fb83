"""Costs of a large fleet in the daemon: CPU of an event, bytes of a commit, `farm status`, all printing.

``python -m bench.fleet_scale [--printers N] [--idle N] [--plates N] [--turns N] [--seconds S] [--json]``.
The daemon is a process of its own on a state folder with that many waiting plates; its agents only speak the
protocol, all in this process. First every printer gets a plate, then all print for `--seconds`, then
`--turns` prints end one after the other: each bed is cleared, and gets its next plate.

All times are CPU time, which other load hardly changes. An event is anything that commits: a report of an
agent, a command of a person, a timer; reading and answering of the socket is not in it, but in `cpu_share`,
the daemon's share of a core while all print. `start_commit_bytes` is the largest commit of an event that
starts a print.
"""

from __future__ import annotations

import argparse
import json
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import yaml

from bench.measured_daemon import MEASURES, fill_books
from bench.protocol_agents import MODEL, PORT, ProtocolAgents
from drivers.clock import Clock
from farm import api
from farm.cli.client import Client
from farm.errors import FarmError
from farm.paths import StateFolder, write_anchor

PATIENCE_S = 600.0
STATUS_TIMES = 5
GOALS = {
    "event_median_ms": 5.0,
    "event_p99_ms": 20.0,
    "start_commit_bytes": 4096,
    "status_cpu_ms": 200.0,
    "cpu_share": 0.2,
}


class Daemon:
    """Daemon on a state folder, with its CPU time."""

    def __init__(self, folder: Path, profile: Path | None) -> None:
        words = [sys.executable, "-m", "bench.measured_daemon", str(folder)]
        words += [] if profile is None else [str(profile.absolute())]
        with (folder / "daemon.log").open("wb") as log:
            self._process = subprocess.Popen(words, stdout=log, stderr=log)
        self._folder = folder
        self.client = Client(folder / "farm.sock")

    def cpu_s(self) -> float:
        """Return the CPU seconds of all its threads."""
        return time.clock_gettime((~self._process.pid << 3) | 2)

    def answers(self) -> bool:
        """Check whether it answers."""
        try:
            self.client.status()
        except FarmError:
            if self._process.poll() is not None:
                raise RuntimeError((self._folder / "daemon.log").read_text()[-2000:]) from None
            return False
        return True

    def end(self) -> dict[str, list[float]]:
        """End it without ending prints; return its own measurements."""
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(60.0)
        measures: dict[str, list[float]] = json.loads((self._folder / MEASURES).read_text())
        return measures

    def kill(self) -> None:
        """Kill it in any state."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def percentile(values: Sequence[float], share: float) -> float:
    """Return the value that a share of the values does not exceed."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def measure(
    printers: int, idle: int, plates: int, rounds: int, seconds: float, profile: Path | None
) -> dict[str, float]:
    """Run the whole measurement in a temporary folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        names = [f"um2-{number:03d}" for number in range(1, printers + 1)]
        idle_names = [f"abs-{number:03d}" for number in range(1, idle + 1)]
        rows = [{"name": name, "model": MODEL, "port": PORT} for name in [*names, *idle_names]]
        for row in rows[printers:]:
            row["material"] = "generic_abs"
        (folder / "fleet.yaml").write_text(yaml.safe_dump({"printers": rows}))
        state = StateFolder(folder)
        write_anchor(state.clock, 1.0, time.time())
        fill_books(state.books, names, plates)
        agents = ProtocolAgents(state, [*names, *idle_names], Clock())
        daemon = Daemon(folder, profile)
        try:
            return _run(daemon, agents, len(names), rounds, seconds)
        finally:
            daemon.kill()
            agents.close()


def _run(
    daemon: Daemon, agents: ProtocolAgents, printers: int, turns: int, seconds: float
) -> dict[str, float]:
    def everybody_prints() -> bool:
        agents.begin()
        return len(agents.printing) == printers

    began_cpu_s, began_s = daemon.cpu_s(), time.monotonic()
    _wait(agents, everybody_prints, "all printers to print")
    _wait(agents, daemon.answers, "the daemon to answer")
    begin_cpu_s, begin_s = daemon.cpu_s() - began_cpu_s, time.monotonic() - began_s
    agents.serve(3.0)

    before_s, begun_s = daemon.cpu_s(), time.monotonic()
    agents.serve(seconds)
    share = (daemon.cpu_s() - before_s) / (time.monotonic() - begun_s)

    status_cpu_s, status_s = [], []
    for _ in range(STATUS_TIMES):
        before_s, begun_s = daemon.cpu_s(), time.monotonic()
        daemon.client.status()
        status_s.append(time.monotonic() - begun_s)
        status_cpu_s.append(daemon.cpu_s() - before_s)
        agents.serve(2.0)

    for name in agents.printing[:turns]:
        agents.end(name)
        _wait(agents, partial(agents.is_forgotten, name), f"{name} to end")
        daemon.client.cleared(name, api.ClearedRequest())
        _wait(agents, everybody_prints, f"{name} to print again")
    measures = daemon.end()
    return {
        "begin_s": begin_s,
        "begin_cpu_s": begin_cpu_s,
        "events": len(measures["event_s"]),
        "event_median_ms": 1000 * statistics.median(measures["event_s"]),
        "event_p99_ms": 1000 * percentile(measures["event_s"], 0.99),
        "event_max_ms": 1000 * max(measures["event_s"]),
        "report_median_ms": 1000 * statistics.median(measures["report_s"]),
        "timer_median_ms": 1000 * statistics.median(measures["timer_s"]),
        "commit_median_bytes": statistics.median(measures["commit_bytes"]),
        "commit_max_bytes": max(measures["commit_bytes"]),
        "start_commit_bytes": max(measures["start_bytes"]),
        "status_cpu_ms": 1000 * max(status_cpu_s),
        "status_ms": 1000 * max(status_s),
        "cpu_share": share,
    }


def _wait(agents: ProtocolAgents, condition: Callable[[], bool], condition_name: str) -> None:
    if not agents.serve(PATIENCE_S, condition):
        raise RuntimeError(f"waited {PATIENCE_S:.0f} s for {condition_name}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--printers", type=int, default=200)
    parser.add_argument("--idle", type=int, default=0, help="printers more, which no plate can take")
    parser.add_argument("--plates", type=int, default=2000)
    parser.add_argument("--turns", type=int, default=40, help="prints that end")
    parser.add_argument("--seconds", type=float, default=20.0, help="for which all print")
    parser.add_argument("--profile", type=Path, help="writes the daemon's profile (cProfile) to this file")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    figures = measure(
        options.printers, options.idle, options.plates, options.turns, options.seconds, options.profile
    )
    missed = [name for name, limit in GOALS.items() if figures[name] > limit]
    if options.json:
        head = {"schema": 1, "printers": options.printers, "idle": options.idle, "plates": options.plates}
        print(json.dumps({**head, **figures, "missed": missed}))
        return
    for name, value in figures.items():
        goal = f"  (at most {GOALS[name]:g}{': missed' if name in missed else ''})" if name in GOALS else ""
        print(f"{name:20} {value:12.3f}{goal}")


if __name__ == "__main__":
    main()
