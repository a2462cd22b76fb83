"""Description of the state of the cluster. Pure."""

from __future__ import annotations

from collections import Counter

from farm import api
from farm.compute.cluster import ClusterState, Place, RunningTask
from farm.text import format_count


def describe_cluster(state: ClusterState) -> api.ClusterView:
    """Describe the state of the cluster, with the place where tasks run and the reason why they wait."""
    return api.ClusterView(
        scheduler=state.scheduler,
        place=state.place,
        text=_describe_work(state),
        workers=[
            api.ClusterWorkerView(name=worker.name, slots=worker.slot_count, refused=worker.refusal_reason)
            for worker in state.workers
        ],
        tasks=[
            api.ClusterTaskView(what=task.work_name, group=_name_group(task), worker=task.host)
            for task in state.tasks
        ],
        waiting=state.waiting_count,
        here=state.local_count,
    )


def _describe_work(state: ClusterState) -> str:
    """Describe in one sentence where tasks run."""
    if state.place is Place.THIS_COMPUTER:
        tasks = format_count(state.local_count, "task") if state.local_count else "nothing to do"
        return f"no worker of {state.scheduler} for {state.loss_s:.0f} s: computing on this host, {tasks}"
    queue_note = f", {format_count(state.waiting_count, 'task')} waiting" if state.waiting_count else ""
    if state.place is Place.WAITING:
        return f"waiting for a worker of {state.scheduler}, {state.loss_s:.0f} s so far{queue_note}"
    usable_workers = [worker for worker in state.workers if worker.refusal_reason is None]
    counts = Counter(task.host for task in state.tasks if task.host is not None)
    places = ", ".join(f"{host} {count}" for host, count in sorted(counts.items()))
    slots = format_count(sum(worker.slot_count for worker in usable_workers), "slot")
    head = f"{format_count(len(usable_workers), 'worker')} with {slots} on {state.scheduler}"
    sent_count = len(state.tasks) - counts.total()
    running_note = f"running: {places}" if places else "nothing is running"
    running_note += f", {format_count(sent_count, 'task')} on the way" if sent_count else ""
    local_note = f", {format_count(state.local_count, 'task')} on this host" if state.local_count else ""
    return f"{head}; {running_note}{queue_note}{local_note}"


def _name_group(task: RunningTask) -> str | None:
    if isinstance(task.group, int):
        return f"job {task.group}"
    return f"plate {task.group}" if isinstance(task.group, str) else None
