"""Binary STL: the format of the parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 80


def write_stl(path: Path, vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> None:
    """Write a mesh, in mm. The file's numbers are single precision; that is the format's."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    records = np.zeros(len(faces), dtype=RECORD)
    records["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    records["corners"] = corners
    with path.open("wb") as file:
        file.write(b"part in printing pose, mm".ljust(HEADER))
        file.write(np.array([len(faces)], dtype="<u4").tobytes())
        file.write(records.tobytes())


def is_binary_stl(data: bytes) -> bool:
    """Whether an STL is of the binary kind. An ASCII one begins with `solid` and has `facet` soon after."""
    return not (data[:5].lower() == b"solid" and b"facet" in data[:1000].lower())


def faces_promised(data: bytes) -> int:
    """The number of faces that a binary STL's header promises."""
    return int(np.frombuffer(data[HEADER : HEADER + 4], dtype="<u4")[0])


def faces_present(data: bytes) -> float:
    """How many faces the bytes of a binary STL hold."""
    return max(0, len(data) - HEADER - 4) / RECORD.itemsize
