"""Settings of the just-in-time compiler, and the folder of its machine code.

Compiled code contains functions and constants from other files. Numba, however, compares the time stamp of
only one file, so it would use stale code after an update. Therefore, the folder is named by a hash of all
compiled files.

The folder is next to the sources, where `farm setup` fills it (`decompose.compilation`). A user who may not
write there gets a copy in their own cache, because numba only uses a writable folder.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import shutil
import sysconfig
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TypeVar, cast

import llvmlite.binding
import numba

F = TypeVar("F", bound=Callable[..., object])


def hash_sources(folder: Path) -> str:
    """Hash the contents of all files with compiled functions in a folder and its subfolders."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        text = path.read_bytes()
        if b"decompose.jit import jit" in text:
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + text)
    return digest.hexdigest()[:16]


def find_code_folder(main_folder: Path, other_folders: Iterable[Path]) -> Path | None:
    """Find the folder for machine code, and create it.

    Parameters
    ----------
    main_folder
        Folder next to the sources.
    other_folders
        Folders to try in this order if the main folder is not writable; they get a copy of its code.

    Returns
    -------
    Path or None
        The first writable folder; None if there is none.
    """
    if is_writable(main_folder):
        return main_folder
    for folder in other_folders:
        if not folder.is_dir() and main_folder.is_dir():
            with contextlib.suppress(OSError):
                _copy_folder(main_folder, folder)
        if is_writable(folder):
            return folder
    return None


def is_writable(folder: Path) -> bool:
    """Create a folder if it is missing, and check whether files can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def is_compiled() -> bool:
    """Check whether the code of all compiled functions for this processor is stored."""
    return CODE_FOLDER is not None and (CODE_FOLDER / _MARKER_NAME).exists()


def mark_compiled() -> None:
    """Record that the code of all compiled functions for this processor is stored."""
    if CODE_FOLDER is not None:
        (CODE_FOLDER / _MARKER_NAME).touch()


def _copy_folder(source: Path, target: Path) -> None:
    """Copy a folder so that other processes see either all of it or nothing."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
        copy = Path(scratch) / target.name
        shutil.copytree(source, copy, copy_function=shutil.copyfile)
        copy.rename(target)


def _list_other_folders(name: str) -> Iterator[Path]:
    """Yield folders for a user who may not write next to the sources; only this process uses the last one."""
    with contextlib.suppress(RuntimeError):  # a user without a home folder
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "farm" / name
    with contextlib.suppress(OSError):
        scratch = tempfile.mkdtemp(prefix="farm-code-")
        atexit.register(shutil.rmtree, scratch, ignore_errors=True)
        yield Path(scratch) / name


_PACKAGE_FOLDER = Path(__file__).parent
_SOURCES_HASH = hash_sources(_PACKAGE_FOLDER)
INSTALLED_FOLDER = _PACKAGE_FOLDER / "__pycache__" / _SOURCES_HASH
"""Folder next to the sources, for all users."""
CODE_FOLDER = find_code_folder(INSTALLED_FOLDER, _list_other_folders(_SOURCES_HASH))
"""Folder of the machine code; None if no folder is writable."""
_MARKER_NAME = (
    f"compiled-{numba.__version__}-{sysconfig.get_config_var('SOABI')}-{llvmlite.binding.get_host_cpu_name()}"
)

if CODE_FOLDER is not None:
    numba.config.CACHE_DIR = str(CODE_FOLDER)  # type: ignore[attr-defined]
    numba.config.CACHE_LOCATOR_CLASSES = "UserProvidedCacheLocator"  # type: ignore[attr-defined]


def jit(function: F) -> F:
    """Compile a function to machine code, and keep the code on disk if a folder is writable."""
    return cast(F, numba.njit(cache=CODE_FOLDER is not None, nogil=True)(function))


def jit_inline(function: F) -> F:
    """Compile a small function into the body of each compiled caller, for calls in inner loops."""
    return cast(F, numba.njit(nogil=True, inline="always")(function))
