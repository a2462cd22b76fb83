"""Workers that run tasks in the process of a test."""

from farm.planning.plan import InspectedSubmission


class SameProcess:
    """Workers that run each task immediately."""

    start_step = None
    has_idle_worker = True
    memory_bytes = 2**40

    async def run(self, work, *args, limit=None, group=None):
        return work(*args)


class AcceptingWorkers(SameProcess):
    """Workers that accept every model."""

    async def run(self, work, *args, limit=None, group=None):
        return InspectedSubmission(file="m.npz", scale=1.0, repairs=())
