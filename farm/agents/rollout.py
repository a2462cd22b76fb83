"""Update of the agents of all hosts: one host first, then all others; it stops at the first failure. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.host import Update, UpdatePhase


@dataclass(frozen=True, slots=True)
class RolloutStep:
    """Instructions for the hosts in one step of an update.

    Attributes
    ----------
    hosts_to_begin
        Hosts whose update must begin now.
    hosts_to_halt
        Hosts whose update must stop now.
    is_finished
        True if the update is complete or has failed.
    fault
        Reason why the update has failed; None if it has not.
    """

    hosts_to_begin: tuple[str, ...] = ()
    hosts_to_halt: tuple[str, ...] = ()
    is_finished: bool = False
    fault: str | None = None


def plan_rollout(updates: Mapping[str, Update | None], started_hosts: tuple[str, ...]) -> RolloutStep:
    """Plan the next step of an update.

    Parameters
    ----------
    updates
        State of the update of each host, by the host's name; None for a host that is not connected.
    started_hosts
        Hosts whose update has begun, in order. The other hosts wait until the first of these is done.

    Returns
    -------
    RolloutStep
        The next step. Hosts that are not connected are updated when they are connected again. If the service
        of a host restarts during the update of that host, it forgets the update, which then begins again.
    """
    phases = {host: None if update is None else update.phase for host, update in updates.items()}
    for host in started_hosts:
        update = updates.get(host)
        if update is not None and update.phase is UpdatePhase.FAILED:
            running_hosts = tuple(
                other for other in started_hosts if phases.get(other) is UpdatePhase.RUNNING
            )
            return RolloutStep(
                hosts_to_halt=running_hosts, is_finished=True, fault=f"{host}: {update.reason}"
            )
    remaining_hosts = tuple(
        host
        for host in sorted(updates)
        if host not in started_hosts and phases[host] in (UpdatePhase.OUTDATED, UpdatePhase.FAILED)
    )
    if not started_hosts and remaining_hosts:
        return RolloutStep(hosts_to_begin=remaining_hosts[:1])
    outdated_hosts = tuple(host for host in started_hosts if phases.get(host) is UpdatePhase.OUTDATED)
    is_first_done = bool(started_hosts) and phases.get(started_hosts[0]) is UpdatePhase.CURRENT
    next_hosts = remaining_hosts if is_first_done else ()
    if outdated_hosts or next_hosts:
        return RolloutStep(hosts_to_begin=(*outdated_hosts, *next_hosts))
    is_done = all(phase is UpdatePhase.CURRENT for phase in phases.values())
    return RolloutStep(is_finished=is_done)
