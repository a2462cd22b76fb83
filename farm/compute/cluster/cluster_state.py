"""State of a cluster, for display and for the choice of the place where work runs. Pure."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from enum import StrEnum

WORKER_TIMEOUT_S = 30.0
"""Wall seconds without a usable worker after which work runs on this computer."""


class Place(StrEnum):
    """Place of new work."""

    CLUSTER = "cluster"
    WAITING = "waiting"  # nowhere yet: work waits for a worker of the cluster
    THIS_COMPUTER = "here"  # this computer, because there has been no usable worker for `WORKER_TIMEOUT_S`


@dataclass(frozen=True, slots=True)
class ClusterWorker:
    """Worker of a cluster.

    Attributes
    ----------
    slot_count
        Maximum number of tasks that it runs at the same time.
    refusal_reason
        Reason why it gets no tasks, as text; None if it gets tasks.
    """

    name: str
    address: str
    slot_count: int
    refusal_reason: str | None = None


@dataclass(frozen=True, slots=True)
class RunningTask:
    """Task that was submitted to the cluster; `host` is None until a worker starts the task."""

    work_name: str
    group: Hashable
    host: str | None = None


@dataclass(frozen=True, slots=True)
class ClusterState:
    """State of a cluster, and its tasks.

    Attributes
    ----------
    waiting_count
        Number of tasks that wait for a worker.
    local_count
        Number of tasks that run or wait on this computer instead.
    unusable_s
        Wall seconds since the cluster last had a usable worker; 0 while it has one.
    """

    scheduler: str
    place: Place
    workers: tuple[ClusterWorker, ...]
    tasks: tuple[RunningTask, ...]
    waiting_count: int
    local_count: int
    unusable_s: float

    def list_problems(self) -> list[str]:
        """Describe the problems that need a person; each sentence stays the same while its problem lasts."""
        problems = []
        if self.place is Place.THIS_COMPUTER:
            problems.append(
                f"no worker of the cluster {self.scheduler} is usable: running on this computer instead; "
                "check that the scheduler and its workers are running"
            )
        problems += [
            f"worker {worker.name} of the cluster is refused: {worker.refusal_reason}"
            for worker in self.workers
            if worker.refusal_reason
        ]
        return problems


def describe_place(place: Place, scheduler: str) -> str:
    """Describe for the log where tasks run from now on, or that they wait."""
    if place is Place.CLUSTER:
        return f"tasks run on the workers of {scheduler}"
    reason = f"no worker of {scheduler} can be used"
    if place is Place.WAITING:
        return f"{reason}: tasks wait for one"
    advice = "tasks run on this computer; check that the scheduler and its workers are running"
    return f"no worker of {scheduler} has been usable for {WORKER_TIMEOUT_S:.0f} s: {advice}"


def choose_place(unusable_s: float) -> Place:
    """Choose where new tasks run, from the time since the cluster last had a usable worker."""
    if unusable_s <= 0.0:
        return Place.CLUSTER
    return Place.WAITING if unusable_s < WORKER_TIMEOUT_S else Place.THIS_COMPUTER
