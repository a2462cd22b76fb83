"""Slicing of a batch of parts in the workers, each part for its own printer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from farm.compute import SLICING_LIMIT, PoolShare
from farm.planning.error_translation import translate_errors
from farm.planning.part_records import DecomposedPart, SliceBatch, SlicedPart, SliceTask
from farm.planning.printer_settings import (
    build_settings_request,
    find_usable_volumes,
    resolve_printer_settings,
)
from farm.planning.tasks import slice_part
from slicing.settings import find_engine, find_resources

if TYPE_CHECKING:
    from slicing.plate import PlateResult


async def slice_batch(
    workers: PoolShare, batch: SliceBatch, on_slice: Callable[[PlateResult], None] = lambda _: None
) -> tuple[SlicedPart, ...]:
    """Slice all parts of a batch; a failure or cancellation stops them all.

    Parameters
    ----------
    on_slice
        Called with each result as it completes.

    Returns
    -------
    tuple[SlicedPart, ...]
        The slices, in the order of the batch.

    Raises
    ------
    FarmError
        See `build_slice_tasks` and `slice_part`.
    """

    async def slice_one_part(part: DecomposedPart, task: SliceTask) -> SlicedPart:
        result = await workers.run(slice_part, task, limit=SLICING_LIMIT)
        on_slice(result)
        return SlicedPart(part, batch.find_printer(part), task, result)

    # In a thread: resolving settings and writing files would block the event loop.
    tasks = await asyncio.to_thread(build_slice_tasks, batch)
    # Longest first, so that all workers finish at about the same time.
    order = sorted(range(len(tasks)), key=lambda i: -batch.parts[i].price_s)
    slice_tasks = {i: asyncio.ensure_future(slice_one_part(batch.parts[i], tasks[i])) for i in order}
    try:
        await asyncio.gather(*slice_tasks.values())
        return tuple(slice_tasks[i].result() for i in range(len(tasks)))
    finally:
        for future in slice_tasks.values():
            future.cancel()
        await asyncio.gather(
            *slice_tasks.values(), return_exceptions=True
        )  # waits until their workers have ended


def build_slice_tasks(batch: SliceBatch) -> list[SliceTask]:
    """Build a slice task for each part of a batch.

    Raises
    ------
    FarmError
        With code `engine` if there is no CuraEngine, `settings` if the settings cannot be resolved.
    """
    with translate_errors():
        resources, engine = find_resources(), find_engine()
    tasks = []
    for part in batch.parts:
        section = batch.find_printer(part)
        settings = resolve_printer_settings(section, batch.quality, resources)
        tasks.append(
            SliceTask(
                part_name=part.id,
                stl=part.stl,
                request=build_settings_request(section, batch.quality),
                resources=resources,
                settings=settings,
                usable_volumes=find_usable_volumes(section, settings.brim_width_mm),
                engine=engine,
                out=batch.folder / f"{part.id}.gcode",
                cache=batch.cache,
                print_options=part.print_options,
            )
        )
    return tasks
