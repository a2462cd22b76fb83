"""Functions by name, for work that is sent to another process."""

from __future__ import annotations

import pkgutil
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Deferred:
    """A function whose module is imported only where it is called.

    The process that names it loads nothing; the process that calls it loads what it needs.

    Attributes
    ----------
    target
        Module and function, as ``package.module:function``.
    """

    target: str

    def __call__(self, *args: object) -> Any:
        """Import the module and call the function."""
        return pkgutil.resolve_name(self.target)(*args)
