"""ZIP archive of files, written while it is sent, so that neither disk nor memory holds all of it."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

_CHUNK_BYTES = 1 << 18
_COMPRESSION_LEVEL = 1  # halves the size of an STL, at about 50 MB/s


class _ChunkBuffer:
    """Stream that cannot seek, and buffers content until `take` is called."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []

    def write(self, content: bytes) -> int:
        """Append content."""
        self._chunks.append(bytes(content))
        return len(content)

    def flush(self) -> None:
        """Do nothing: `take` returns all content."""

    def take(self) -> bytes:
        """Return the buffered content, and remove it."""
        content = b"".join(self._chunks)
        self._chunks.clear()
        return content


def generate_archive(files: Mapping[str, Path]) -> Iterator[bytes]:
    """Yield the chunks of a ZIP archive of files.

    Parameters
    ----------
    files
        Paths of the files, by their names in the archive.

    Raises
    ------
    OSError
        If a file cannot be read; the content so far is not a valid archive.
    """
    buffer = _ChunkBuffer()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=_COMPRESSION_LEVEL) as archive:  # type: ignore[call-overload]
        for name, path in files.items():
            with path.open("rb") as source, archive.open(name, "w", force_zip64=True) as entry:
                while chunk := source.read(_CHUNK_BYTES):
                    entry.write(chunk)
                    yield buffer.take()
    yield buffer.take()
