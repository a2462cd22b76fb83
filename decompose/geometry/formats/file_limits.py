"""Limits on a model file, which are checked on its bytes before a parser spends memory or time on them.

All functions are pure.
"""

from __future__ import annotations

import re

import numpy as np

from decompose.errors import ModelUnreadable
from decompose.files.triangle_limit import (
    HEAD_BYTES,
    check_triangles,
    is_binary_stl,
    read_face_count,
    read_off_face_count,
    read_ply_face_count,
)

# Maximum number of corners of a face. The triangles of a larger face would meet at one corner, and their
# repair would take hours.
MAX_CORNERS = 10_000
MAX_PLY_HEADER_BYTES = HEAD_BYTES

_COMMENT_MARKS = (b"#", b"comment")
_CORNER_BYTES = 4  # minimum bytes of a corner in a binary PLY
_LINE_CONTINUATION_PATTERN = re.compile(rb"\\\r?\n")
_PLY_BINARY_PATTERN = re.compile(rb"format\s+binary")


def check_limits(name: str, data: bytes, suffix: str, memory_bytes: int | None) -> None:
    """Refuse a file with more triangles than fit in memory, too large a face, or an unterminated header.

    Parameters
    ----------
    name
        Name of the file, for messages.
    data
        Content of the file.
    suffix
        Format of the file: one of `geometry.model.SUFFIXES`.
    memory_bytes
        Memory that the process may use; None if there is no limit.

    Raises
    ------
    ModelUnreadable
        A face is too large, or the header is not terminated.
    ModelTooDetailed
        The file has more triangles than fit in memory.
    """
    if suffix == ".ply" and b"end_header" not in data[:MAX_PLY_HEADER_BYTES]:
        raise ModelUnreadable(
            f"{name}: no end_header within {MAX_PLY_HEADER_BYTES // 1024} KiB; the file may be truncated or "
            "not a PLY file. Copy or export it again"
        )
    triangle_count = count_triangles(data, suffix)
    if memory_bytes is not None:
        check_triangles(name, triangle_count, memory_bytes)
    if suffix == ".ply" and _PLY_BINARY_PATTERN.search(data, 0, MAX_PLY_HEADER_BYTES):
        if triangle_count and len(data) > triangle_count * MAX_CORNERS * _CORNER_BYTES:
            raise ModelUnreadable(
                f"{name}: has {triangle_count} faces in {len(data) / 1e6:.0f} MB: either its faces have too "
                "many corners, or it is a point cloud; export it with triangles"
            )
    elif suffix != ".stl" and (max_corner_count := _find_max_corner_count(data)) > MAX_CORNERS:
        raise ModelUnreadable(
            f"{name}: has a face with {max_corner_count} corners (limit {MAX_CORNERS}); "
            "export it with triangles"
        )


def count_triangles(data: bytes, suffix: str) -> int:
    """Count the triangles or faces of a file by its header or its keywords; 0 if these give no number.

    Parameters
    ----------
    data, suffix
        As in `check_limits`.
    """
    match suffix:
        case ".stl":
            return read_face_count(data) if is_binary_stl(data) else data.count(b"endloop")
        case ".obj":
            return data.count(b"\nf ")
    return read_ply_face_count(data) if suffix == ".ply" else read_off_face_count(data)


def _find_max_corner_count(data: bytes) -> int:
    """Find the number of corners of the largest face of a text file; 0 if no face is larger than allowed."""
    if b"\\" in data:
        data = _LINE_CONTINUATION_PATTERN.sub(b" ", data)
    ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n"))
    begins, ends = np.append(0, ends + 1), np.append(ends, len(data))
    is_long = ends - begins > 2 * MAX_CORNERS  # a corner takes at least a digit and a blank
    lines = (data[begin:end].split() for begin, end in zip(begins[is_long], ends[is_long], strict=True))
    return max(
        (len(words) - 1 for words in lines if words and not words[0].startswith(_COMMENT_MARKS)), default=0
    )
