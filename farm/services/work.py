"""What workers are asked. Whoever names these loads nothing: each loads what it needs where it runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from farm.config import PrinterSection
from farm.model import JobOptions
from farm.services.again import AgainTask, Pieces
from farm.services.booking import SliceTask
from farm.services.planning import Decomposed, DecomposeTask, Inspected, Plan, Sliced, check_settings

if TYPE_CHECKING:
    from slicing.plate import PlateResult


def warm() -> None:
    """See `decomposing.warm`."""
    from farm.services import decomposing

    decomposing.warm()


def inspect(
    path: Path, name: str, options: JobOptions, printers: Sequence[PrinterSection], files: Path
) -> Inspected:
    """A submission, which a person knows by `name`: see `gcode.inspect_gcode` and `models.inspect_model`.

    Raises
    ------
    FarmError
        Also those of `planning.check_settings`.
    """
    from farm.services import gcode, models

    if gcode.is_gcode(name):
        return gcode.inspect_gcode(path, name, options, printers, files)
    check_settings(printers, options)
    return models.inspect_model(path, name, options, files)


def decompose_job(task: DecomposeTask) -> Decomposed:
    """See `decomposing.decompose_job`."""
    from farm.services import decomposing

    return decomposing.decompose_job(task)


def level_again(sliced: Sliced, folder: Path) -> Decomposed | None:
    """See `decomposing.level_again`."""
    from farm.services import decomposing

    return decomposing.level_again(sliced, folder)


def plan_gcode(task: DecomposeTask, files: Path) -> Plan:
    """See `gcode.plan_gcode`."""
    from farm.services import gcode

    return gcode.plan_gcode(task, files)


def slice_part(task: SliceTask) -> PlateResult:
    """See `plates.slice_part`."""
    from farm.services import plates

    return plates.slice_part(task)


def cut_part(task: AgainTask) -> Pieces:
    """See `recut.cut_part`."""
    from farm.services import recut

    return recut.cut_part(task)
