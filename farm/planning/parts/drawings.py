"""Drawing of a job's parts in the workers: pictures in parallel, then the page that shows them."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from math import sqrt
from pathlib import Path

from farm.compute import DRAWING_LIMIT, PoolShare
from farm.planning.plan import DecomposedJob, DecomposeTask
from farm.planning.tasks import draw_job_parts, draw_overview, draw_step_range

MAX_RANGES = 4
"""Maximum number of ranges of assembly steps; each is drawn by one worker. A worker also computes the views
of all steps before its range, so more ranges would save little time."""
MIN_STEPS = 5  # minimum average number of assembly steps in a range


class Drawings:
    """Drawings in progress, by the folder of the parts."""

    def __init__(self, workers: PoolShare) -> None:
        self._workers = workers
        self._running: dict[Path, asyncio.Future[None]] = {}

    def start(self, task: DecomposeTask, decomposed_job: DecomposedJob) -> None:
        """Start drawing parts, unless it has already started."""
        if task.folder not in self._running:
            drawing = draw_parts_in_parallel(self._workers, task, decomposed_job)
            self._running[task.folder] = asyncio.ensure_future(drawing)

    async def finish(self, task: DecomposeTask, decomposed_job: DecomposedJob) -> None:
        """Draw parts, or wait until they are drawn. Raises FarmError if they cannot be drawn."""
        self.start(task, decomposed_job)
        await self._running[task.folder]

    async def stop(self, folder: Path | None = None) -> None:
        """Stop drawing the parts in a folder, or all parts, and wait until the workers have ended."""
        folders = [other for other in self._running if folder in (None, other)]
        drawings = [self._running.pop(other) for other in folders]
        for drawing in drawings:
            drawing.cancel()
        await asyncio.gather(*drawings, return_exceptions=True)


async def draw_parts_in_parallel(
    workers: PoolShare, task: DecomposeTask, decomposed_job: DecomposedJob
) -> None:
    """Draw a job's parts into the folder of its task; several workers share the steps of a long assembly.

    Raises
    ------
    FarmError
        See `draw_job_parts`.
    """
    record, folder = decomposed_job.drawing_record, task.folder
    ranges = split_steps(decomposed_job.step_count)
    if not ranges:
        await workers.run(draw_job_parts, task, record, limit=DRAWING_LIMIT)
        return
    overview = folder / "overview.png"
    files = [folder / f"steps-{first}.pickle" for first, _ in ranges]
    drawings = [asyncio.ensure_future(workers.run(draw_overview, record, overview, limit=DRAWING_LIMIT))]
    for (first, end), file in zip(ranges, files, strict=True):
        drawing = workers.run(draw_step_range, record, first, end, file, limit=DRAWING_LIMIT)
        drawings.append(asyncio.ensure_future(drawing))
    try:
        await asyncio.gather(*drawings)
    finally:
        for running_drawing in drawings:
            running_drawing.cancel()
        await asyncio.gather(*drawings, return_exceptions=True)  # waits until their workers have ended
    await workers.run(draw_job_parts, task, record, overview, tuple(files), limit=DRAWING_LIMIT)


def split_steps(step_count: int) -> list[tuple[int, int]]:
    """Split the steps of an assembly into half-open ranges for several workers.

    The list is empty if one worker should draw all steps.
    Later ranges are shorter, because their steps join more parts and take more time.
    """
    range_count = min(MAX_RANGES, step_count // MIN_STEPS)
    edges = [i / range_count for i in range(range_count + 1)] if range_count > 1 else []
    return list(pairwise(round(step_count * (sqrt(1.0 + 8.0 * edge) - 1.0) / 2.0) for edge in edges))
