"""Inspection of a submitted file, a model or G-code, before its job is taken. Runs in a worker."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from farm.config import PrinterSection
from farm.model import JobOptions
from farm.planning.inspection.inspect_model import inspect_model
from farm.planning.inspection.own_gcode import inspect_gcode, is_gcode
from farm.planning.plan import InspectedSubmission
from farm.planning.printer_settings import check_settings


def inspect_submission(
    path: Path, name: str, options: JobOptions, printers: Sequence[PrinterSection], files: Path
) -> InspectedSubmission:
    """Check a submission, and put what can be printed of it into the file store.

    Parameters
    ----------
    path
        The upload.
    name
        The file's name as a person knows it; its suffix tells a model from G-code.
    options
        Options of the submission.
    printers
        The fleet.
    files
        The file store.

    Raises
    ------
    FarmError
        As `inspect_gcode`, `check_settings` and `inspect_model`.
    """
    if is_gcode(name):
        return inspect_gcode(path, name, options, printers, files)
    check_settings(printers, options)
    return inspect_model(path, name, options, files)
