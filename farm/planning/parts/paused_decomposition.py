"""Continuation of a paused decomposition in workers: attempts of the next round, then the search itself."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from decompose.best import listen_to_progress
from decompose.paused_search import PausedSearch
from decompose.results import Decomposition
from farm.planning.decompose_progress import ProgressFile
from farm.planning.error_translation import translate_errors
from farm.planning.inspection.inspect_submission import read_inspected_model
from farm.planning.parts.decompose_job import finish_job
from farm.planning.parts.pricing import build_printer_cost
from farm.planning.plan import DecomposedJob, DecomposeTask, PausedDecomposition
from farm.planning.printer_settings import resolve_printer_settings
from slicing.settings import find_resources

OUTCOME_FILE_NAME = "outcome.pickle"


def make_attempt(task: DecomposeTask, record: Path, number: int, folder: Path) -> Path:
    """Make one attempt of the next round of a paused decomposition.

    Parameters
    ----------
    record
        See `PausedDecomposition`.
    number
        Number of the attempt in its round.
    folder
        Folder for its progress and its outcome.

    Returns
    -------
    Path
        File with its outcome.

    Raises
    ------
    FarmError
        With code `settings` or `model`, and the reason. An attempt without a result is not an error.
    """
    folder.mkdir(exist_ok=True)
    with _open_search(task, record, folder) as search:
        outcome = search.make_attempt(number)
    path = folder / OUTCOME_FILE_NAME
    path.write_bytes(pickle.dumps(outcome))
    return path


def continue_job(
    task: DecomposeTask, record: Path, outcomes: Sequence[Path | str], end_reason: str | None = None
) -> DecomposedJob | PausedDecomposition:
    """Continue a paused decomposition after a round of attempts; write its parts, or pause it again.

    Parameters
    ----------
    record
        See `PausedDecomposition`.
    outcomes
        File of each attempt of the round, or the reason why the attempt has no file.
    end_reason
        Reason to make no more attempts and end with the best result; None to continue the search.

    Raises
    ------
    FarmError
        See `decompose_job`.
    """
    with _open_search(task, record, task.folder) as search:
        best = search.resume(
            [
                search.make_failed_outcome(number, outcome)
                if isinstance(outcome, str)
                else pickle.loads(outcome.read_bytes())
                for number, outcome in enumerate(outcomes)
            ],
            end_reason,
        )
        return finish_job(replace(search, best_result=best), task)


@contextmanager
def _open_search(task: DecomposeTask, record: Path, folder: Path) -> Iterator[PausedSearch]:
    """Open the search of a paused decomposition, with threads; its progress is written into a folder."""
    progress = ProgressFile(folder)
    with (
        translate_errors(),
        listen_to_progress(lambda share: progress.report(share, time.monotonic())),
        ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads,
    ):
        first = task.printers[0]
        cost = build_printer_cost(
            first, resolve_printer_settings(first, task.options.quality, find_resources())
        )
        best: Decomposition = pickle.loads(record.read_bytes())
        yield PausedSearch(best, read_inspected_model(task.model), cost, threads)
