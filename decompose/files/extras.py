"""Optional packages that read more file formats; this module imports no other packages."""

from __future__ import annotations

import importlib.util


def can_read_step() -> bool:
    """Check whether the package that reads STEP files is installed."""
    return importlib.util.find_spec("cascadio") is not None
