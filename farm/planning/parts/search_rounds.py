"""Search for parts in rounds: the workers make the attempts of a round in parallel.

An attempt cuts the model on one grid, at one angle (see `decompose.best`).
"""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path

from farm.compute import DECOMPOSING_LIMIT, PoolShare
from farm.errors import ErrorCode, FarmError
from farm.planning.decompose_progress import DecomposeProgress, ProgressRate, read_share
from farm.planning.plan import DecomposedJob, DecomposeTask, PausedDecomposition
from farm.planning.tasks import continue_job, decompose_job, make_attempt

log = logging.getLogger(__name__)


class SearchRounds:
    """Search for the parts of a job, with a task for each attempt of a round.

    Parameters
    ----------
    workers
        The job's share of the workers.
    task
        The job, its printers, and a scratch folder.
    """

    def __init__(self, workers: PoolShare, task: DecomposeTask) -> None:
        self._workers, self._task = workers, task
        self._spent_share = 0.0
        self._attempt_folders: list[Path] = []  # folders of the attempts of the last round
        self._rate = ProgressRate()

    async def run(self) -> DecomposedJob:
        """Search for parts. Raises FarmError; see `decompose_job`."""
        result: DecomposedJob | PausedDecomposition = await self._workers.run(
            decompose_job, self._task, limit=DECOMPOSING_LIMIT
        )
        while isinstance(result, PausedDecomposition):
            outcomes = await self._make_attempts(result)
            result = await self._continue_search(result.record, outcomes)
        return result

    async def _continue_search(
        self, record: Path, outcomes: tuple[Path | str, ...]
    ) -> DecomposedJob | PausedDecomposition:
        """Continue the search after a round; if that exceeds a limit, end it with the best result so far."""
        result: DecomposedJob | PausedDecomposition
        try:
            result = await self._workers.run(
                continue_job, self._task, record, outcomes, limit=DECOMPOSING_LIMIT
            )
        except FarmError as error:
            if error.code is not ErrorCode.LIMIT:
                raise
            self._log_warning("the search for parts ends early", error)
            reason = f"not started: {error}"
            result = await self._workers.run(
                continue_job, self._task, record, outcomes, reason, limit=DECOMPOSING_LIMIT
            )
        return result

    def read_progress(self, now_s: float) -> DecomposeProgress | None:
        """Read the progress of all tasks; None if no task has started.

        Parameters
        ----------
        now_s
            Seconds of a monotonic clock.
        """
        share = read_share(self._task.folder)
        if self._attempt_folders:
            attempt_shares = [read_share(folder) or 0.0 for folder in self._attempt_folders]
            share = max(share or 0.0, self._spent_share + sum(attempt_shares))
        return None if share is None else self._rate.estimate_progress(min(1.0, share), now_s)

    async def _make_attempts(self, paused_decomposition: PausedDecomposition) -> tuple[Path | str, ...]:
        """Make the attempts of a round; return the outcome of each; see `_make_attempt`."""
        self._spent_share = paused_decomposition.spent_share
        folders = [
            paused_decomposition.record.with_suffix(f".{number}")
            for number in range(paused_decomposition.attempt_count)
        ]
        attempts = [
            asyncio.ensure_future(self._make_attempt(paused_decomposition.record, number, folder))
            for number, folder in enumerate(folders)
        ]
        self._attempt_folders = folders
        try:
            return tuple(await asyncio.gather(*attempts))
        finally:
            for attempt in attempts:
                attempt.cancel()
            await asyncio.gather(*attempts, return_exceptions=True)  # waits until their workers have ended

    async def _make_attempt(self, record: Path, number: int, folder: Path) -> Path | str:
        """Make an attempt; return the file of its outcome, or a message if the attempt exceeded a limit."""
        try:
            outcome: Path = await self._workers.run(
                make_attempt, self._task, record, number, folder, limit=DECOMPOSING_LIMIT
            )
        except FarmError as error:
            if error.code is not ErrorCode.LIMIT:
                raise
            self._log_warning("an attempt failed", error)
            return str(error)
        return outcome

    def _log_warning(self, effect: str, error: FarmError) -> None:
        log.warning("job %d: %s: %s", self._task.job, effect, error, extra={"job": self._task.job})
