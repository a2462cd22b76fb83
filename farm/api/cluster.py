"""Cluster that computes plans, as `farm status` shows it."""

from __future__ import annotations

from farm.api.base import View


class ClusterWorkerView(View):
    """Worker of the cluster."""

    name: str
    slots: int  # number of tasks that it runs at the same time
    refused: str | None  # reason why it gets no tasks


class ClusterTaskView(View):
    """Task that was sent to the cluster."""

    what: str
    group: str | None  # its job, or the plate that is replanned
    worker: str | None  # null until it starts


class ClusterView(View):
    """State of the cluster."""

    scheduler: str
    place: str  # where new work runs: cluster, waiting or here
    text: str
    workers: list[ClusterWorkerView]
    tasks: list[ClusterTaskView]
    waiting: int  # number of tasks that wait for a worker
    here: int  # number of tasks that this computer runs
