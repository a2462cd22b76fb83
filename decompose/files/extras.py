"""Optional packages that read more file formats, in a module whose import loads nothing else."""

from __future__ import annotations

import importlib.util


def reads_step() -> bool:
    """Check whether the package that reads STEP is installed."""
    return importlib.util.find_spec("cascadio") is not None
