"""What workers are asked. Whoever names these loads nothing: each loads what it needs where it runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from farm.config import PrinterSection
from farm.model import JobOptions
from farm.planning.plan import Decomposed, DecomposeTask, Inspected, Plan, Sliced, check_settings
from farm.planning.plan_records import SliceTask
from farm.planning.replanning.replan import AgainTask, Pieces

if TYPE_CHECKING:
    from slicing.plate import PlateResult


def warm() -> None:
    """See `decomposing.warm`."""
    from farm.planning.parts import decompose_job as decomposing

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
    from farm.planning import inspect_model, own_gcode

    if own_gcode.is_gcode(name):
        return own_gcode.inspect_gcode(path, name, options, printers, files)
    check_settings(printers, options)
    return inspect_model.inspect_model(path, name, options, files)


def decompose_job(task: DecomposeTask) -> Decomposed:
    """See `decomposing.decompose_job`."""
    from farm.planning.parts import decompose_job as decomposing

    return decomposing.decompose_job(task)


def level_again(sliced: Sliced, folder: Path) -> Decomposed | None:
    """See `decomposing.level_again`."""
    from farm.planning.parts import decompose_job as decomposing

    return decomposing.level_again(sliced, folder)


def plan_gcode(task: DecomposeTask, files: Path) -> Plan:
    """See `gcode.plan_gcode`."""
    from farm.planning import own_gcode

    return own_gcode.plan_gcode(task, files)


def slice_part(task: SliceTask) -> PlateResult:
    """See `plates.slice_part`."""
    from farm.planning.parts import slice_part as plates

    return plates.slice_part(task)


def cut_part(task: AgainTask) -> Pieces:
    """See `recut.cut_part`."""
    from farm.planning.replanning import cut_part as recut

    return recut.cut_part(task)
