"""Faults of hosts while a large fleet prints: a host lost, half of them lost, a poor network."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from bench.fleets.agents.host_services import HostGroups
from bench.fleets.agents.protocol_agents import ProtocolAgents
from bench.fleets.daemon_process import Daemon, EventFollower, NoticeReceiver
from farm import api

FIRST_HOST, FIRST_HALF, OTHER_HOSTS = "one", "half", "rest"
LOSS_SHARE, DELAY_S = 0.05, 0.3
_TIMEOUT_S = 180.0
_POLL_S = 2.0
_NOTICE_S = 20.0  # time until every notice is sent; a notice waits for 10 s to include further losses


def group_hosts(hosts: list[str]) -> dict[str, list[str]]:
    """Divide hosts into the first one, the others of the first half, and the rest."""
    half = max(1, len(hosts) // 2)
    groups = {FIRST_HOST: hosts[:1], FIRST_HALF: hosts[1:half], OTHER_HOSTS: hosts[half:]}
    return {name: group for name, group in groups.items() if group}


@dataclass(frozen=True, slots=True)
class PrintingFleet:
    """Printing fleet, and the objects that measure the effects of a fault."""

    daemon: Daemon
    agents: ProtocolAgents
    groups: HostGroups
    hosts_by_group: dict[str, list[str]]
    follower: EventFollower
    notices: NoticeReceiver

    def wait(self, condition: Callable[[], bool], name: str) -> float:
        """Serve the agents until a condition holds; return the seconds, or raise RuntimeError after 180 s."""
        start_s = time.monotonic()
        if not self.agents.serve(_TIMEOUT_S, limit_polls(condition)):
            raise RuntimeError(f"waited {_TIMEOUT_S:.0f} s for {name}")
        return time.monotonic() - start_s

    def count_unknown_printers(self) -> int:
        """Count the printers in an unknown state."""
        return sum(printer.state == "unknown" for printer in self.daemon.client.fetch_status().printers)

    def count_lost_hosts(self) -> int:
        """Count the hosts without a connection."""
        return sum(host.connected is None for host in self.daemon.client.fetch_hosts().hosts)


def limit_polls(condition: Callable[[], bool]) -> Callable[[], bool]:
    """Return a condition that polls only every `_POLL_S`, so that polls hardly load the daemon."""
    polled_s = 0.0

    def poll() -> bool:
        nonlocal polled_s
        if time.monotonic() - polled_s < _POLL_S:
            return False
        is_true = condition()
        polled_s = time.monotonic()
        return is_true

    return poll


def measure_loss(fleet: PrintingFleet, groups: list[str]) -> dict[str, Any]:
    """Lose groups of hosts, and reconnect them once the notices have been sent.

    Returns
    -------
    dict
        Seconds until the loss is reported as an event and until all hosts are connected again; numbers of
        lost hosts, of printers in an unknown state, of events, tasks and lines of notices, with their texts;
        number of prints that ended meanwhile; the daemon's share of a core.
    """
    host_count = sum(len(fleet.hosts_by_group[name]) for name in groups)
    fleet.agents.serve(_NOTICE_S)  # notices on prints and jobs that have ended are sent first
    printing_count, notice_count, start_s = (
        len(fleet.agents.printing_names),
        len(fleet.notices.lines),
        time.monotonic(),
    )
    start_cpu_s = fleet.daemon.read_cpu_s()
    fleet.groups.disconnect(*groups)
    loss_task_s = fleet.wait(
        lambda: fleet.follower.count("HostLost", start_s) >= host_count, "the loss to be noticed"
    )
    fleet.agents.serve(_NOTICE_S)
    status = fleet.daemon.client.fetch_status()
    tasks = [todo for todo in status.todo if todo.code == "host"]
    unknown_count = sum(printer.state == "unknown" for printer in status.printers)
    cpu_share = (fleet.daemon.read_cpu_s() - start_cpu_s) / (time.monotonic() - start_s)
    lines = fleet.notices.lines[notice_count:]
    fleet.groups.reconnect(*groups)
    reconnected_s = fleet.wait(
        lambda: fleet.count_lost_hosts() == 0 and fleet.count_unknown_printers() == 0,
        "the hosts to be connected",
    )
    return {
        "hosts": host_count,
        "printers": unknown_count,
        "loss_task_s": loss_task_s,
        "events": fleet.follower.count("HostLost", start_s),
        "tasks": len(tasks),
        "notices": len(lines),
        "notice_texts": lines,
        "prints_ended": printing_count - len(fleet.agents.printing_names),
        "cpu_share": cpu_share,
        "reconnected_s": reconnected_s,
    }


def measure_poor_network(fleet: PrintingFleet, seconds: float, plate_changes: int) -> dict[str, float]:
    """Lose and delay packets between the daemon and all hosts, then reconnect all hosts on this network.

    Returns
    -------
    dict
        Number of lost hosts, the daemon's share of a core, the delay of an event, and the seconds until all
        hosts are connected.
    """
    fleet.groups.disturb(LOSS_SHARE, DELAY_S)
    start_s, start_cpu_s = time.monotonic(), fleet.daemon.read_cpu_s()
    fleet.agents.serve(seconds)
    cpu_share = (fleet.daemon.read_cpu_s() - start_cpu_s) / (time.monotonic() - start_s)
    delays_s = measure_event_delays(fleet, plate_changes)
    lost_count = fleet.follower.count("HostLost", start_s)
    fleet.groups.break_connections()
    connect_s = fleet.wait(
        lambda: fleet.count_lost_hosts() == 0 and fleet.count_unknown_printers() == 0,
        "the hosts to be connected",
    )
    fleet.groups.disturb(0.0, 0.0)
    return {
        "loss": LOSS_SHARE,
        "delay_s": DELAY_S,
        "hosts_lost": lost_count,
        "cpu_share": cpu_share,
        "event_delay_median_s": sorted(delays_s)[len(delays_s) // 2],
        "event_delay_max_s": max(delays_s),
        "connect_s": connect_s,
    }


def measure_event_delays(fleet: PrintingFleet, plate_changes: int) -> list[float]:
    """End prints one after another, and start the next; return the seconds until `/events` has each end."""
    delays_s = []
    for name in fleet.agents.printing_names[:plate_changes]:
        since_s = time.monotonic()
        fleet.agents.end_print(name)

        def is_known(name: str = name, since_s: float = since_s) -> bool:
            return fleet.follower.find("PrintEnded", name, since_s) is not None

        if not fleet.agents.serve(_TIMEOUT_S, is_known):
            raise RuntimeError(f"waited {_TIMEOUT_S:.0f} s for the end of the print on {name}")
        event = fleet.follower.find("PrintEnded", name, since_s)
        assert event is not None
        delays_s.append(event.at_s - since_s)
        fleet.agents.serve(_TIMEOUT_S, lambda name=name: fleet.agents.is_forgotten(name))  # type: ignore[misc]
        fleet.daemon.client.clear_bed(name, api.ClearedRequest())
    return delays_s
