"""Queue of tasks that wait for a slot of the cluster."""

import asyncio
from contextlib import suppress

from farm.compute.cluster.slot_queue import SlotQueue


async def run_pending_tasks():
    for _ in range(5):
        await asyncio.sleep(0)


class QueuedTasks:
    """Tasks that wait for a slot, and the order in which they got one."""

    def __init__(self):
        self.slots, self.started_tasks, self.end_events = SlotQueue(), [], {}

    def add_task(self, name, group, urgent=False):
        self.end_events[name] = asyncio.Event()
        return asyncio.ensure_future(self._hold_slot(name, group, urgent))

    async def _hold_slot(self, name, group, urgent):
        async with self.slots.hold_slot(group, urgent) as has_slot:
            self.started_tasks.append((name, has_slot))
            await self.end_events[name].wait()


def run(run_scenario):
    async def main():
        queue = QueuedTasks()
        tasks = await run_scenario(queue)
        for event in queue.end_events.values():
            event.set()
        queue.slots.set_slot_count(9, False)
        for task in tasks:
            with suppress(asyncio.CancelledError):
                await task
        return queue

    return asyncio.run(main())


def test_groups_share_the_slots_and_urgent_tasks_go_first():
    async def run_scenario(queue):
        tasks = [queue.add_task(name, name[0]) for name in ("a1", "a2", "a3", "b1")]
        tasks.append(queue.add_task("c1", "c", urgent=True))
        await run_pending_tasks()
        assert queue.slots.waiting_count == 5 and queue.started_tasks == []
        queue.slots.set_slot_count(3, False)
        await run_pending_tasks()
        assert [name for name, _ in queue.started_tasks] == ["c1", "a1", "b1"]
        queue.end_events["c1"].set()
        await run_pending_tasks()
        assert queue.started_tasks[-1] == ("a2", True)
        return tasks

    assert len(run(run_scenario).started_tasks) == 5


def test_cancelled_task_gives_its_slot_back():
    async def run_scenario(queue):
        queue.slots.set_slot_count(1, False)
        first_task, second_task, third_task = (queue.add_task(name, name) for name in "xyz")
        await run_pending_tasks()
        second_task.cancel()
        first_task.cancel()
        await run_pending_tasks()
        assert [name for name, _ in queue.started_tasks] == ["x", "z"]
        return [first_task, second_task, third_task]

    assert run(run_scenario).slots.waiting_count == 0


def test_no_task_waits_once_the_cluster_is_given_up():
    async def run_scenario(queue):
        tasks = [queue.add_task(name, name) for name in "xy"]
        await run_pending_tasks()
        queue.slots.set_slot_count(0, True)
        await run_pending_tasks()
        assert queue.started_tasks == [("x", False), ("y", False)]
        return tasks

    run(run_scenario)


def test_slot_is_free_until_a_task_takes_it():
    slot_states = []

    async def run_scenario(queue):
        queue.slots.set_slot_count(1, False)
        slot_states.append(queue.slots.has_free_slot)
        tasks = [queue.add_task("a", 1)]
        await run_pending_tasks()
        slot_states.append(queue.slots.has_free_slot)
        return tasks

    run(run_scenario)
    assert slot_states == [True, False]
