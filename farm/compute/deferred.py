"""References to functions whose modules are imported only for a call, and lists of the files of a call."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class TaskFiles:
    """Files that a task reads and writes, so that it can run on a computer without a shared disk.

    Attributes
    ----------
    input_files
        Files that it reads.
    output_folders
        Folders that it writes into.
    output_files
        Files that it writes, besides those in these folders.
    cache_folders
        Folders that cache results by content; another computer uses folders of its own.
    live_files
        Files in `output_folders` that others read while the task runs, such as its progress.
    """

    input_files: tuple[Path, ...] = ()
    output_folders: tuple[Path, ...] = ()
    output_files: tuple[Path, ...] = ()
    cache_folders: tuple[Path, ...] = ()
    live_files: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True)
class DeferredFunction:
    """Function whose module is imported only in the process that calls it.

    Attributes
    ----------
    target
        Module and function, as ``package.module:function``.
    list_files
        Function that lists the files of a call, from its arguments; None if calls must run on this computer.
    """

    target: str
    list_files: Callable[..., TaskFiles] | None = None

    def __call__(self, *args: object) -> Any:
        """Import the module and call the function."""
        return pkgutil.resolve_name(self.target)(*args)
