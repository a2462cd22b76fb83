"""Interface of a pool, which runs tasks on this computer or on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Protocol, TypeVar

from farm.compute.limits import CHECKING_LIMIT, Limit

T = TypeVar("T")


class Pool(Protocol):
    """Processes that run tasks. All methods are called on the event loop's thread."""

    @property
    def memory_bytes(self) -> int:
        """Memory that each worker on this computer may use, in bytes."""
        ...

    @property
    def start_step(self) -> str | None:
        """Current step in starting the workers on this computer, as text; None once one of them is ready."""
        ...

    @property
    def has_idle_worker(self) -> bool:
        """True if a task that is not urgent would start immediately."""
        ...

    async def run(
        self, work: Callable[..., T], *args: object, limit: Limit = CHECKING_LIMIT, group: Hashable = None
    ) -> T:
        """Run a function in a worker. Cancelling the call ends the function and its CuraEngine process.

        Parameters
        ----------
        work
            Function to run; it runs again if its worker dies.
        limit
            Time limit, and urgency.
        group
            Among waiting tasks of equal urgency, those of the group with the fewest running tasks start
            first. With None, the task forms its own group.

        Raises
        ------
        FarmError
            If the function raises it; with code `limit` if the function exceeds its time or memory, or if its
            workers died.
        """
        ...

    def close(self) -> None:
        """Abandon all work, and end every worker on this computer."""
        ...


class PoolShare:
    """Pool for the tasks of one group; see `Pool.run`.

    Parameters
    ----------
    pool
        Pool that runs the tasks.
    group
        Group of the tasks.
    is_urgent
        True if the tasks start before other work.
    """

    def __init__(self, pool: Pool, group: Hashable, is_urgent: bool = False) -> None:
        self._pool, self._group, self._is_urgent = pool, group, is_urgent

    @property
    def has_idle_worker(self) -> bool:
        """True if a task would start immediately; see `Pool.has_idle_worker`."""
        return self._pool.has_idle_worker

    async def run(self, work: Callable[..., T], *args: object, limit: Limit = CHECKING_LIMIT) -> T:
        """Run a function in a worker."""
        limit = replace(limit, is_urgent=True) if self._is_urgent else limit
        return await self._pool.run(work, *args, limit=limit, group=self._group)
