"""Files of a job, fetched from the daemon into a folder. Received names and contents are not trusted."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from farm import api
from farm.cli.client import Client
from farm.errors import FarmError, RefusedError

_NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}")
_DIGEST_PATTERN = re.compile(r"[0-9a-f]{64}")
_REPORT_SUFFIXES = (".stl", ".png", ".jpg", ".jpeg")  # the report shows drawings of STL files


@dataclass(frozen=True, slots=True)
class FetchedFiles:
    """Files of a job in a folder: all files by name and by SHA-256, and the names of those newly written."""

    paths_by_name: dict[str, Path] = field(default_factory=dict)
    paths_by_sha256: dict[str, Path] = field(default_factory=dict)
    written_names: list[str] = field(default_factory=list)

    def find(self, path: str) -> Path | None:
        """Return the local copy of a file, given its path on the daemon's host; None if there is no copy.

        On the daemon's host, a file in the file store is named by its SHA-256.
        """
        return self.paths_by_sha256.get(Path(path).stem) or self.paths_by_name.get(Path(path).name)


def is_shown_in_report(name: str) -> bool:
    """Return whether the report of a job shows a file with this name."""
    return name.lower().endswith(_REPORT_SUFFIXES)


def fetch_files(
    client: Client,
    number: int,
    folder: Path,
    force: bool = False,
    select: Callable[[str], bool] = lambda _: True,
) -> FetchedFiles:
    """Fetch the files of a job, except for those that the folder already has.

    Each file appears only when it is complete and has the right SHA-256.

    Parameters
    ----------
    client
        The daemon.
    number
        Number of the job.
    folder
        Folder to write to; it is created if it is missing.
    force
        True to overwrite files with other content.
    select
        Function that returns whether to fetch the file with a given name.

    Raises
    ------
    RefusedError
        If the folder has another file with the same name; in this case nothing is written.
    FarmError
        If a name is not valid, the content differs from its hash, or a file cannot be written.
    """
    files = [file for file in client.list_files(number).files if select(file.name)]
    _check_names(files)
    result = FetchedFiles()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        missing_files = [file for file in files if not _is_fetched(folder / file.name, file)]
        _refuse_overwriting(folder, missing_files, force)
        for file in missing_files:
            _fetch_file(client, number, file, folder, force)
            result.written_names.append(file.name)
    except OSError as error:
        cause = error.strerror or error
        raise FarmError(f"{folder} cannot be written ({cause}); give another folder with --out") from error
    for file in files:
        result.paths_by_name[file.name] = result.paths_by_sha256[file.sha256] = folder / file.name
    return result


def _check_names(files: Iterable[api.FileView]) -> None:
    """Raise FarmError if a name or a hash that the daemon sent is not valid."""
    for file in files:
        if not _NAME_PATTERN.fullmatch(file.name) or not _DIGEST_PATTERN.fullmatch(file.sha256):
            raise FarmError(
                f"the daemon sent the file name {file.name!r}, which is not valid: nothing is written"
            )


def _is_fetched(path: Path, file: api.FileView) -> bool:
    """Return whether a file has already been fetched, by its size and hash."""
    if not path.is_file() or path.stat().st_size != file.size:
        return False
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest() == file.sha256


def _read_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _refuse_overwriting(folder: Path, files: list[api.FileView], force: bool) -> None:
    """Raise RefusedError if files with other content would be overwritten."""
    other_names = [file.name for file in files if os.path.lexists(folder / file.name)]
    if other_names and not force:
        raise RefusedError(
            f"{folder} has other files of these names: {' '.join(other_names[:5])}; give another folder with "
            "--out, or overwrite them with --force"
        )


def _fetch_file(client: Client, number: int, file: api.FileView, folder: Path, force: bool) -> None:
    digest, remaining_bytes = hashlib.sha256(), file.size
    descriptor, name = tempfile.mkstemp(prefix=".fetch-", dir=folder)
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as target:

            def write(chunk: bytes) -> None:
                nonlocal remaining_bytes
                remaining_bytes -= len(chunk)
                if remaining_bytes < 0:
                    raise FarmError(f"{file.name} is longer than {file.size} bytes: it is not written")
                digest.update(chunk)
                try:
                    target.write(chunk)
                except OSError as error:
                    raise FarmError(f"{temporary} cannot be written ({error.strerror})") from error

            client.download_file(number, file.name, write)
        if remaining_bytes or digest.hexdigest() != file.sha256:
            raise FarmError(f"{file.name} arrived damaged or incomplete: fetch it again")
        temporary.chmod(0o666 & ~_read_umask())
        _refuse_overwriting(folder, [file], force)  # another file may have been written in the meantime
        temporary.replace(folder / file.name)
    finally:
        temporary.unlink(missing_ok=True)
