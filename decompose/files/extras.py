"""Extras that read more kinds of files, apart so that asking for them loads nothing else."""

from __future__ import annotations

import importlib.util


def reads_step() -> bool:
    """Return whether the package that reads STEP is installed."""
    return importlib.util.find_spec("cascadio") is not None
