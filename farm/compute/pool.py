"""Pool: the interface behind which tasks run, on this computer or on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Protocol, TypeVar

from farm.compute.limits import CHECKING, Limit

T = TypeVar("T")


class Pool(Protocol):
    """Processes that run tasks. All methods are called on the event loop's thread."""

    @property
    def memory_bytes(self) -> int:
        """Memory that each worker on this computer may use, in bytes."""
        ...

    @property
    def start_step(self) -> str | None:
        """Current step while the workers on this computer start, as text; None once one of them is ready."""
        ...

    @property
    def has_idle(self) -> bool:
        """True if a task that is not urgent would start immediately."""
        ...

    async def run(
        self, work: Callable[..., T], *args: object, limit: Limit = CHECKING, group: Hashable = None
    ) -> T:
        """Run a function in a worker. Cancelling the call ends the function, and the engine that it runs.

        Parameters
        ----------
        work
            Function to run; it runs again if its worker dies.
        limit
            Time limit, and urgency.
        group
            Of the waiting tasks of equal urgency, those of the group with the fewest running tasks are
            started first. None: the task forms its own group.

        Raises
        ------
        FarmError
            If the function raises it; code `limit` if it exceeds its time or memory, or its workers died.
        """
        ...

    def close(self) -> None:
        """Abandon all work, and end every worker on this computer."""
        ...


class PoolShare:
    """Pool for the tasks of one group; see `Pool.run`.

    Parameters
    ----------
    urgent
        True if the tasks are started before other work.
    """

    def __init__(self, pool: Pool, group: Hashable, urgent: bool = False) -> None:
        self._pool, self._group, self._urgent = pool, group, urgent

    @property
    def has_idle(self) -> bool:
        """True if a task would start immediately; see `Pool.has_idle`."""
        return self._pool.has_idle

    async def run(self, work: Callable[..., T], *args: object, limit: Limit = CHECKING) -> T:
        """Run a function in a worker."""
        limit = replace(limit, urgent=True) if self._urgent else limit
        return await self._pool.run(work, *args, limit=limit, group=self._group)
