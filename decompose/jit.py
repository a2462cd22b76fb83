"""One place for the settings of the just-in-time compiler."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def jit(function: F) -> F:
    """Compile a function to machine code, and keep the code on disk where there is a place to write.

    Numba looks beside the source file, then in the user's cache folder; with neither it compiles on each run.
    """
    try:
        return cast(F, numba.njit(cache=True, nogil=True)(function))
    except RuntimeError:
        return cast(F, numba.njit(nogil=True)(function))
