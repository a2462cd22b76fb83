"""Records of a task that runs on another computer: the task and its answer."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from farm.compute.cluster.installation import Installation
from farm.compute.deferred import TaskFiles
from farm.compute.limits import Limit


class AttemptLost(Exception):
    """Error of an attempt to run a task: no worker returned a result; another attempt may succeed."""


@dataclass(frozen=True, slots=True)
class InputFile:
    """File that a task reads: its path on the submitting computer, hash and size."""

    path: str
    sha256: str
    size_bytes: int


@dataclass(frozen=True, slots=True)
class RemoteTask:
    """Task for a worker of a cluster; all its paths are those of the submitting computer.

    Attributes
    ----------
    id
        Unique name.
    call
        Function and arguments, written by `relocation.dump`.
    installation
        Versions that the worker must have.
    output_folders, output_files, cache_folders, live_files
        See `TaskFiles`.
    """

    id: str
    call: bytes
    limit: Limit
    installation: Installation
    input_files: tuple[InputFile, ...] = ()
    output_folders: tuple[str, ...] = ()
    output_files: tuple[str, ...] = ()
    cache_folders: tuple[str, ...] = ()
    live_files: tuple[str, ...] = ()

    def list_hashes(self) -> tuple[str, ...]:
        """Return the hashes of the files that the task reads."""
        return tuple(file.sha256 for file in self.input_files)


@dataclass(frozen=True, slots=True)
class RemoteAnswer:
    """Outcome of a task on a worker.

    Attributes
    ----------
    host
        Name of the worker.
    missing_hashes
        Hashes of files that the worker lacks; if there are any, the task was not run.
    result
        Result, written by `relocation.dump`; None if there is none.
    error
        Exception that the function raised; None if it raised none.
    mismatch
        Reason why this worker could not run the task, although another worker may; None if it could.
    files
        The files that the task wrote, by their paths on the submitting computer.
    """

    host: str
    missing_hashes: tuple[str, ...] = ()
    result: bytes | None = None
    error: Exception | None = None
    mismatch: str | None = None
    files: dict[str, bytes] = field(default_factory=dict)


def hash_files(files: TaskFiles) -> tuple[InputFile, ...]:
    """Hash the files that a task reads. Raises OSError if one of them cannot be read."""
    hashed_files = []
    for path in dict.fromkeys(files.input_files):
        with path.open("rb") as source:
            sha256 = hashlib.file_digest(source, "sha256").hexdigest()
        hashed_files.append(InputFile(str(path), sha256, path.stat().st_size))
    return tuple(hashed_files)


def write_files(task: RemoteTask, files: dict[str, bytes]) -> None:
    """Write the files that a task wrote on a worker to their paths on this computer.

    Raises
    ------
    ValueError
        If the worker names a file that the task does not write.
    OSError
        If a file cannot be written.
    """
    for name, content in files.items():
        path = Path(name)
        if ".." in path.parts or not (name in task.output_files or _is_in_folder(name, task.output_folders)):
            raise ValueError(f"the worker wrote {name}, which is not a file of its task")
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.new")
        partial.write_bytes(content)
        partial.replace(path)


def _is_in_folder(name: str, folders: Iterable[str]) -> bool:
    return any(name.startswith(f"{folder}/") for folder in folders)
