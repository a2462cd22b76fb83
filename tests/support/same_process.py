"""Workers that work in the process of a test."""

from farm.planning.plan import InspectedSubmission


class SameProcess:
    """Workers that run each task at once."""

    starting = None
    memory_bytes = 2**40

    def share(self, group, urgent=False):
        return self

    async def run(self, work, *args, limit=None):
        return work(*args)


class AcceptAll(SameProcess):
    """Workers that accept every model."""

    async def run(self, work, *args, limit=None):
        return InspectedSubmission(file="m.npz", scale=1.0, repairs=())
