"""Record of the cuts of a job: a file that another worker reads to move the cuts.

The file is JSON of `_CutRecord`: the figures and options of a `Decomposition` and its `Cutting`, without
solids. Numbers are restored exactly, because faces on one cut plane are found by their equal
coordinates.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from decompose.engines.guillotine import CurvePoint
from decompose.options import Engine, Options
from decompose.printers import TargetPrinter
from decompose.results import Attempt, Coverage, Cutting, Decomposition
from farm.errors import ErrorCode, FarmError

CUT_RECORD_FILE_NAME = "cut-record.json"
_Row = tuple[float, float, float]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants")


class _CuttingRecord(_Record):
    """Record of a `decompose.results.Cutting`, with its arrays as rows."""

    granularity: str | int
    frame: tuple[_Row, _Row, _Row]
    boxes_mm: tuple[tuple[_Row, _Row], ...]
    cut_for: tuple[TargetPrinter | None, ...]
    printers: tuple[TargetPrinter, ...]
    prices_s: tuple[float, ...] = ()


class _CutRecord(_Record):
    """Record of a `decompose.results.Decomposition` without parts, joints and faults."""

    engine: Engine
    options: Options
    serial_s: float
    serial_as_is_s: float
    makespan_s: float
    sum_s: float
    grid_makespan_s: float
    lower_bound_s: float
    gap: float
    compute_s: dict[str, float]
    coverage: Coverage
    cells: tuple[int, int, int] | None
    yaw_deg: float
    attempts: tuple[Attempt, ...]
    curve: tuple[CurvePoint, ...]
    cutting: _CuttingRecord
    any_boxes_bound_s: float | None = None


def write_cut_record(decomposition: Decomposition, folder: Path) -> Path | None:
    """Write the cut record of a decomposition into a folder.

    Returns
    -------
    Path | None
        The file; None if the engine's cuts cannot be moved.
    """
    cutting = decomposition.cutting
    if cutting is None:
        return None
    figures = {name: getattr(decomposition, name) for name in _CutRecord.model_fields if name != "cutting"}
    rows = {"frame": cutting.frame.tolist(), "boxes_mm": cutting.boxes_mm.tolist()}
    values = {name: getattr(cutting, name) for name in ("granularity", "cut_for", "printers", "prices_s")}
    record = _CutRecord(**figures, cutting=_CuttingRecord(**rows, **values))
    path = folder / CUT_RECORD_FILE_NAME
    path.write_text(record.model_dump_json())
    return path


def read_cut_record(path: Path) -> Decomposition:
    """Read a cut record as a decomposition without parts.

    Raises
    ------
    FarmError
        If the file cannot be read.
    """
    try:
        record = _CutRecord.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise FarmError(f"{path}: cannot be read: {error}", ErrorCode.MODEL) from error
    figures = {name: getattr(record, name) for name in _CutRecord.model_fields}
    cutting = {field.name: getattr(record.cutting, field.name) for field in fields(Cutting)}
    arrays = {"frame": np.array(cutting["frame"]), "boxes_mm": np.array(cutting["boxes_mm"])}
    return Decomposition(**{**figures, "parts": (), "cutting": Cutting(**{**cutting, **arrays})})
