"""The agent's own copies of G-code files, checked before anything heats."""

from __future__ import annotations

import hashlib
import os
import re
from contextlib import suppress
from pathlib import Path

from drivers.errors import AgentError, BadGcode
from drivers.gcode import Program, strip

_PRINT_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_CHUNK_BYTES = 1 << 20
_PART = ".part"


class Spool:
    """A folder with one file a print."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob(f"*{_PART}"):
            left.unlink()

    def _path(self, print_id: str) -> Path:
        if _PRINT_ID.fullmatch(print_id) is None:
            raise AgentError(f"{print_id!r}: a print id is letters, digits, dot, dash and underscore")
        return self._folder / f"{print_id}.gcode"

    def check(self, print_id: str) -> None:
        """Raise AgentError where a print cannot have this id."""
        self._path(print_id)

    def put(self, print_id: str, at: int, data: bytes) -> None:
        """Keep a piece of a file that comes over the socket.

        Raises
        ------
        AgentError
            It does not begin where the last one ended, or the disk does not take it.
        """
        part = self.part(print_id)
        try:
            with part.open("wb" if at == 0 else "ab") as file:
                if file.tell() != at:
                    raise AgentError(f"{part}: a piece at {at} does not follow {file.tell()} bytes")
                file.write(data)
        except OSError as error:
            raise _unwritten(part, error) from error

    def part(self, print_id: str) -> Path:
        """The file that `put` makes."""
        return self._path(print_id).with_suffix(_PART)

    def take(self, print_id: str, source: Path, sha256: str) -> Program:
        """Copy a file, and make it ready for the wire.

        Raises
        ------
        BadGcode
            It cannot be read, is not the file of this hash, or must not go to a printer.
        AgentError
            The copy cannot be written.
        """
        path = self._path(print_id)
        digest = hashlib.sha256()
        try:
            with source.open("rb") as read, path.open("wb") as copy:
                while chunk := read.read(_CHUNK_BYTES):
                    digest.update(chunk)
                    copy.write(chunk)
            if digest.hexdigest() != sha256.lower():
                raise BadGcode(
                    f"{source}: is not the file that was meant: its sha256 is {digest.hexdigest()}"
                )
            with path.open("rb") as lines:
                return strip(lines)
        except OSError as error:
            with suppress(OSError):
                path.unlink()  # half a file is of no use, and its disk may be full
            if source.is_file() and os.access(source, os.R_OK):
                raise _unwritten(path, error) from error
            raise BadGcode(f"{source}: cannot be read ({error.strerror}); is its folder shared?") from error

    def drop(self, print_id: str) -> None:
        """Delete the copy, if there is one."""
        self._path(print_id).unlink(missing_ok=True)
        self.part(print_id).unlink(missing_ok=True)


def _unwritten(path: Path, error: OSError) -> AgentError:
    return AgentError(f"{path}: cannot be written ({error.strerror}); make room on its disk")
