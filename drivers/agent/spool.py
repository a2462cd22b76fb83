"""Spool: the agent's copies of G-code files, checked before anything heats."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import weakref
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from drivers.errors import AgentError, BadGcode
from drivers.gcode import MAX_LINE_BYTES, Program, read_program
from drivers.printers import Profile

_PRINT_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_GCODE_SUFFIX = ".gcode"
_UPLOAD_SUFFIX = ".part"


class Spool:
    """Folder with one file per print, checked for one printer model.

    Parameters
    ----------
    folder
        The folder, created if missing.
    profile
        The printer's model.
    """

    def __init__(self, folder: Path, profile: Profile) -> None:
        self._folder, self._profile = folder, profile
        folder.mkdir(parents=True, exist_ok=True)
        for partial_file in folder.glob(f"*{_UPLOAD_SUFFIX}"):
            partial_file.unlink()

    def _make_path(self, print_id: str) -> Path:
        if _PRINT_ID.fullmatch(print_id) is None:
            raise AgentError(f"{print_id!r}: a print id may contain only letters, digits, `.`, `-` and `_`")
        return self._folder / f"{print_id}{_GCODE_SUFFIX}"

    def check_print_id(self, print_id: str) -> None:
        """Check a print id. Raises AgentError if it is invalid."""
        self._make_path(print_id)

    def append_upload(self, print_id: str, offset: int, data: bytes) -> None:
        """Append a piece of an uploaded file.

        Parameters
        ----------
        print_id
            Id of the print.
        offset
            Offset of this piece in bytes; 0 begins a new file.
        data
            The piece.

        Raises
        ------
        AgentError
            The piece does not follow the last one, or cannot be written.
        """
        path = self.make_upload_path(print_id)
        try:
            with path.open("wb" if offset == 0 else "ab") as file:
                if file.tell() != offset:
                    raise AgentError(f"{path}: a piece at {offset} does not follow {file.tell()} bytes")
                file.write(data)
        except OSError as error:
            raise _make_write_error(path, error) from error

    def make_upload_path(self, print_id: str) -> Path:
        """Return the path of an uploaded file."""
        return self._make_path(print_id).with_suffix(_UPLOAD_SUFFIX)

    def import_gcode(self, print_id: str, source: Path, sha256: str) -> Program:
        """Read a file, and copy all of its commands into the spool.

        Parameters
        ----------
        print_id
            Id of the print.
        source
            The G-code file.
        sha256
            Its expected hash, in hexadecimal digits.

        Raises
        ------
        BadGcode
            The file cannot be read, has a different hash, or must not be printed.
        AgentError
            The copy cannot be written.
        """
        path = self._make_path(print_id)
        self.delete_others(print_id)
        digest = hashlib.sha256()
        refusal: BadGcode | None = None

        def hash_lines(lines: Iterable[bytes]) -> Iterator[bytes]:
            for line in lines:
                digest.update(line)
                yield line

        try:
            with source.open("rb") as raw:
                # The limit bounds the memory for a binary file, which may be one long line.
                lines = hash_lines(iter(lambda: raw.readline(MAX_LINE_BYTES + 1), b""))
                try:
                    program = read_program(lines, self._profile, _GcodeCopy(path))
                except BadGcode as error:
                    refusal = error
                    deque(lines, maxlen=0)
            if digest.hexdigest() != sha256.lower():
                raise BadGcode(f"{source}: has changed: its sha256 is {digest.hexdigest()}")
            if refusal is not None:
                raise refusal
            return program
        except OSError as error:
            with suppress(OSError):
                path.unlink()  # an incomplete copy is useless, and the disk may be full
            if source.is_file() and os.access(source, os.R_OK):
                raise _make_write_error(path, error) from error
            raise BadGcode(f"{source}: cannot be read ({error.strerror}); is its folder shared?") from error

    def delete_others(self, print_id: str | None) -> None:
        """Delete the files of all other prints, left by a dead agent or an upload that was never started."""
        kept_files = (
            set() if print_id is None else {self._make_path(print_id), self.make_upload_path(print_id)}
        )
        for path in self._folder.iterdir():
            if path not in kept_files and path.suffix in (_GCODE_SUFFIX, _UPLOAD_SUFFIX):
                with suppress(OSError):
                    path.unlink()

    def delete(self, print_id: str) -> None:
        """Delete the files of a print."""
        self._make_path(print_id).unlink(missing_ok=True)
        self.make_upload_path(print_id).unlink(missing_ok=True)


class _GcodeCopy:
    """New file that stays readable through this object, even after it is deleted."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
        weakref.finalize(self, os.close, self._fd)

    def write(self, data: bytes) -> None:
        if os.write(self._fd, data) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def read(self, start: int, end: int) -> bytes:
        return os.pread(self._fd, end - start, start)


def _make_write_error(path: Path, error: OSError) -> AgentError:
    return AgentError(f"{path}: cannot be written ({error.strerror}); make room on its disk")
