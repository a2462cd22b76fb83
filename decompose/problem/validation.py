"""Checks of a model, printers and options before any engine works on them."""

from __future__ import annotations

import math

import numpy as np

from decompose.errors import DecomposeError, NoFit, size_text
from decompose.geometry import Model
from decompose.options import Options
from decompose.printers import PrinterRoom

MAX_PARTS = 200  # a model that surely takes more is not for more printers, or for rounds: it is too long


def validate_problem(
    model: Model,
    printers: tuple[PrinterRoom, ...],
    options: Options,
) -> None:
    """Refuse a problem that no engine can work on.

    Parameters
    ----------
    model, printers, options
        As of `decompose.decompose_model`.

    Raises
    ------
    DecomposeError
        No printer, a printer without room, or a wall that is no length.
    """
    if not printers:
        raise NoFit("no printer: name at least one")
    for printer in printers:
        if not printer.boxes:
            raise NoFit(f"{printer.name} has no room for a part; take a narrower brim or a larger volume")
    if not (math.isfinite(options.min_wall_mm) and options.min_wall_mm >= 0.0):
        raise DecomposeError(f"--min-wall {options.min_wall_mm}: give a number of mm, 0 or more")
    if not (math.isfinite(options.min_glue_mm2) and options.min_glue_mm2 >= 0.0):
        raise DecomposeError(f"--min-glue {options.min_glue_mm2}: give a number of mm2, 0 or more")
    _refuse_too_long(model, printers)


def _refuse_too_long(model: Model, printers: tuple[PrinterRoom, ...]) -> None:
    """Refuse models longer than all printers' rooms one after the other, along their diagonals."""
    reach_mm = sum(max(math.hypot(*box) for box in p.boxes) for p in printers)
    if float(model.extents_mm.max()) <= reach_mm:
        return
    spans = np.array([piece.bounds_mm for piece in model.solid.pieces()])
    for axis in range(3):
        order = spans[np.argsort(spans[:, 0, axis]), :, axis]
        before = np.maximum.accumulate(np.concatenate([[-np.inf], order[:-1, 1]]))
        solid_mm = float(np.maximum(0.0, order[:, 1] - np.maximum(order[:, 0], before)).sum())  # without gaps
        if solid_mm > reach_mm:
            least = math.ceil(solid_mm / reach_mm * len(printers))
            longest = max(1, math.floor(float(model.extents_mm.max()) * reach_mm / solid_mm / math.sqrt(3.0)))
            raise NoFit(
                f"{size_text(model.extents_mm)} mm needs {least} parts at least, each on a printer of its "
                f"own, and there are {len(printers)}: free more printers, or try --longest-side {longest}",
                least if least <= MAX_PARTS else None,
            )
