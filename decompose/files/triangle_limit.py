"""Limit on the triangles that fit in memory, checked on the first bytes of a file; quick to import."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping

from decompose.errors import ModelTooDetailed

BYTES_PER_TRIANGLE = 1500  # maximum memory for reading and repairing a triangle, measured
PROCESS_BYTES = 256 * 2**20  # memory of a process with its libraries
HEAD_BYTES = 64 * 1024
"""Number of bytes at the start of a file that these checks need."""

STL_HEADER_BYTES, STL_COUNT_BYTES, STL_FACE_BYTES = 80, 4, 50
_PLY_FACES_PATTERN = re.compile(rb"element\s+face\s+(\d{1,18})")
_OFF_COUNTS_PATTERN = re.compile(rb"(?:\s|#[^\n]*\n)*C?OFF(?:\s|#[^\n]*\n)+\d+\s+(\d{1,18})")


def check_head(name: str, head: bytes, size_bytes: int, suffix: str, memory_bytes: int) -> None:
    """Refuse a file whose first bytes state more triangles than fit in memory.

    Parameters
    ----------
    name
        Name of the file, for messages.
    head
        First bytes of the file, up to `HEAD_BYTES`.
    size_bytes
        Number of bytes of the whole file.
    suffix
        Format of the file, such as `.stl`. Files whose first bytes do not state the number of triangles are
        not refused.
    memory_bytes
        Memory of the process that will read the file.

    Raises
    ------
    ModelTooDetailed
        There are more triangles than fit in memory.
    """
    count_faces = _FACE_COUNTERS.get(suffix)
    if count_faces is not None:
        check_triangles(name, count_faces(head, size_bytes), memory_bytes)


def check_triangles(name: str, triangle_count: int, memory_bytes: int) -> None:
    """Raise `ModelTooDetailed` if a number of triangles does not fit in memory.

    Parameters
    ----------
    name
        Name of the file, for messages.
    triangle_count
        Number of triangles.
    memory_bytes
        Memory of the process that will read the file.
    """
    limit = compute_max_triangles(memory_bytes)
    if triangle_count > limit:
        raise ModelTooDetailed(
            f"{name}: has {triangle_count / 1e6:.1f} million triangles, but {memory_bytes / 2**30:.1f} GB of "
            f"memory suffice only for {limit / 1e6:.1f} million: simplify its mesh"
        )


def compute_max_triangles(memory_bytes: int) -> int:
    """Compute the number of triangles that can be read and repaired in an amount of memory."""
    return max(0, memory_bytes - PROCESS_BYTES) // BYTES_PER_TRIANGLE


def is_binary_stl(data: bytes) -> bool:
    """Check whether an STL file is binary: an ASCII file begins with `solid`, soon followed by `facet`."""
    return not (data[:5].lower() == b"solid" and b"facet" in data[:1000].lower())


def read_face_count(data: bytes) -> int:
    """Read the number of faces from the header of a binary STL file."""
    return int(struct.unpack_from("<I", data, STL_HEADER_BYTES)[0])


def read_ply_face_count(head: bytes) -> int:
    """Read the number of faces from the header of a PLY file; 0 if it states none."""
    match = _PLY_FACES_PATTERN.search(head, 0, HEAD_BYTES)
    return int(match[1]) if match else 0


def read_off_face_count(head: bytes) -> int:
    """Read the number of faces from the first lines of an OFF file; 0 if they state none."""
    match = _OFF_COUNTS_PATTERN.match(head, 0, HEAD_BYTES)
    return int(match[1]) if match else 0


def _read_stl_face_count(head: bytes, size_bytes: int) -> int:
    """Read the number of faces from the header of a binary STL file, at most as many as fit into the file."""
    header_bytes = STL_HEADER_BYTES + STL_COUNT_BYTES
    if len(head) < header_bytes or not is_binary_stl(head):
        return 0
    return min(read_face_count(head), (size_bytes - header_bytes) // STL_FACE_BYTES)


_FACE_COUNTERS: Mapping[str, Callable[[bytes, int], int]] = {
    ".stl": _read_stl_face_count,
    ".ply": lambda head, _: read_ply_face_count(head),
    ".off": lambda head, _: read_off_face_count(head),
}
