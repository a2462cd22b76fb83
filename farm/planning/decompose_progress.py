"""Progress of a decomposition, in a file that its worker writes and the daemon reads."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

PROGRESS_FILE_NAME = "progress.json"
_INTERVAL_S = 0.5  # wall seconds between two reports


class DecomposeProgress(BaseModel):
    """Progress of a decomposition.

    Attributes
    ----------
    share
        Used share of the budget, 0 to 1.
    remaining_s
        Maximum wall seconds until the budget is used up, at the average rate so far; None if unknown.
    """

    model_config = ConfigDict(frozen=True)
    share: float
    remaining_s: float | None = None


class ProgressRate:
    """Rate at which a decomposition uses its budget, measured from its first report above 0."""

    def __init__(self) -> None:
        self._first_report: tuple[float, float] | None = None  # its share and time

    def estimate_progress(self, share: float, now_s: float) -> DecomposeProgress:
        """Return the progress, with the remaining time that follows from the average rate.

        Parameters
        ----------
        share
            Used share of the budget, 0 to 1.
        now_s
            Seconds of a monotonic clock.
        """
        if self._first_report is None and share > 0.0:
            self._first_report = share, now_s
        if self._first_report is None or share <= self._first_report[0]:
            return DecomposeProgress(share=share)
        first_share, start_s = self._first_report
        remaining_s = (now_s - start_s) * (1.0 - share) / (share - first_share)
        return DecomposeProgress(share=share, remaining_s=remaining_s)


class ProgressFile:
    """Writer of the used share of a decomposition's budget.

    Parameters
    ----------
    folder
        Scratch folder of the plan.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / PROGRESS_FILE_NAME
        self._due_s = -math.inf

    def report(self, share: float, now_s: float) -> None:
        """Write the used share of the budget, at most every half second.

        Parameters
        ----------
        share
            Used share, 0 to 1.
        now_s
            Seconds of a monotonic clock.
        """
        if now_s < self._due_s:
            return
        self._due_s = now_s + _INTERVAL_S
        text = DecomposeProgress(share=share).model_dump_json(exclude_none=True)
        new_file = self._path.with_suffix(".new")
        with suppress(OSError):  # on a full disk the decomposition itself may still succeed
            new_file.write_text(text)
            new_file.replace(self._path)


def read_share(folder: Path) -> float | None:
    """Read the used share of the budget; None if the decomposition has not started."""
    try:
        return DecomposeProgress.model_validate_json((folder / PROGRESS_FILE_NAME).read_bytes()).share
    except (OSError, ValidationError):
        return None
