"""Queue of tasks for the slots of a cluster, each of which runs one task at a time.

Urgent tasks get slots first, then tasks of the groups with the fewest running tasks.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Hashable
from contextlib import asynccontextmanager
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class _WaitingTask:
    """Task that waits for a slot; the result of `grant` is True if it gets one."""

    group: Hashable
    is_urgent: bool
    grant: asyncio.Future[bool]


class SlotQueue:
    """Queue of tasks for a number of slots, which may change."""

    def __init__(self) -> None:
        self._slot_count = 0
        self._is_closed = False  # if True, no task waits for a slot, because there is no cluster
        self._waiting_tasks: list[_WaitingTask] = []
        self._running_counts: Counter[Hashable] = Counter()

    @property
    def waiting_count(self) -> int:
        """Number of tasks that wait for a slot."""
        return len(self._waiting_tasks)

    @property
    def has_free_slot(self) -> bool:
        """True if a slot is free."""
        return self._running_counts.total() < self._slot_count

    def set_slot_count(self, slot_count: int, is_closed: bool) -> None:
        """Set the number of slots; with `is_closed`, refuse a slot to all waiting tasks."""
        self._slot_count, self._is_closed = slot_count, is_closed
        self._assign_slots()

    @asynccontextmanager
    async def hold_slot(self, group: Hashable, is_urgent: bool) -> AsyncIterator[bool]:
        """Wait for a slot, and hold it in the `with` block. Yields False if the queue is closed."""
        task = _WaitingTask(group, is_urgent, asyncio.get_running_loop().create_future())
        self._waiting_tasks.append(task)
        self._assign_slots()
        try:
            has_slot = await task.grant
        except asyncio.CancelledError:
            if task in self._waiting_tasks:
                self._waiting_tasks.remove(task)
            elif not task.grant.cancelled() and task.grant.result():  # cancelled just as it got a slot
                self._release_slot(group)
            raise
        if not has_slot:
            yield False
            return
        try:
            yield True
        finally:
            self._release_slot(group)

    def _release_slot(self, group: Hashable) -> None:
        self._running_counts -= Counter([group])
        self._assign_slots()

    def _assign_slots(self) -> None:
        """Grant free slots to waiting tasks, urgent ones first; if the queue is closed, refuse them all."""
        while self._waiting_tasks and (self._is_closed or self._running_counts.total() < self._slot_count):
            first = min(
                self._waiting_tasks, key=lambda task: (not task.is_urgent, self._running_counts[task.group])
            )
            self._waiting_tasks.remove(first)
            if first.grant.done():  # its task was cancelled
                continue
            if not self._is_closed:
                self._running_counts[first.group] += 1
            first.grant.set_result(not self._is_closed)
