"""Conversion of errors of the packages decompose, slicing and drivers into farm errors with a code."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import decompose.errors as de
import slicing.errors as se
from drivers.errors import DriverError
from farm.errors import ErrorCode, FarmError

_CODES: tuple[tuple[type[Exception], ErrorCode], ...] = (
    (de.NoFit, ErrorCode.NO_FIT),
    (de.GeometryError, ErrorCode.GEOMETRY),
    (de.BadSize, ErrorCode.SETTINGS),
    (de.ModelTooDetailed, ErrorCode.LIMIT),
    (de.DecomposeError, ErrorCode.MODEL),
    (se.EngineMissing, ErrorCode.ENGINE),
    (se.EngineFailed, ErrorCode.ENGINE),
    (se.EngineTimeout, ErrorCode.ENGINE),
    (se.BadSetting, ErrorCode.SETTINGS),
    (se.SlicingError, ErrorCode.SLICE),
    (DriverError, ErrorCode.FAILED),
)


@contextmanager
def translate_errors() -> Iterator[None]:
    """Convert an error of decompose, slicing or drivers to a FarmError with the matching code."""
    try:
        yield
    except tuple(kind for kind, _ in _CODES) as error:
        code = next(code for kind, code in _CODES if isinstance(error, kind))
        raise FarmError(str(error), code) from error
