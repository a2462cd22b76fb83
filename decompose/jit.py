"""Settings of the just-in-time compiler, and the folder of its machine code.

Compiled code contains functions and constants of other files, and numba compares the time stamp of one file
only: after an update it would use stale code. So the folder is named by a hash of all compiled files.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def hash_sources(folder: Path) -> str:
    """Hash the content of all files below a folder that have compiled functions."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        text = path.read_bytes()
        if b"decompose.jit" in text:
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + text)
    return digest.hexdigest()[:16]


def _kept_in() -> Path:
    """Find the folder of the machine code: beside the sources where writable, else in the user's cache."""
    here = Path(__file__).parent
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    root = here / "__pycache__" if os.access(here, os.W_OK) else home / "farm"
    return root / hash_sources(here)


numba.config.CACHE_DIR = str(_kept_in())  # type: ignore[attr-defined]
numba.config.CACHE_LOCATOR_CLASSES = "UserProvidedCacheLocator"  # type: ignore[attr-defined]


def jit(function: F) -> F:
    """Compile a function to machine code, and keep the code on disk where there is a place to write."""
    try:
        return cast(F, numba.njit(cache=True, nogil=True)(function))
    except RuntimeError:  # no writable folder: it is compiled on each run
        return cast(F, numba.njit(nogil=True)(function))


def jit_inline(function: F) -> F:
    """Compile a small function into the body of each compiled caller, for calls in inner loops."""
    return cast(F, numba.njit(nogil=True, inline="always")(function))
