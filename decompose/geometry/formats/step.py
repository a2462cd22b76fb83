"""Reader of STEP files: the surfaces of their solids as triangles in mm.

OpenCASCADE reads the files through the package cascadio, an optional extra. It runs in a process of its own,
because it prints to stdout and may crash on a damaged file.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from decompose.arrays import Floats
from decompose.errors import ModelEmpty, ModelTooDetailed, ModelUnreadable
from decompose.files.extras import can_read_step

LINEAR_DEFLECTION_MM = 0.01  # maximum distance between a curved face and its triangles
ANGULAR_DEFLECTION_RAD = 0.2  # maximum angle between neighbouring triangles of a curved face
MAX_READING_S = 300.0
MAX_GLB_BYTES = 2**31

_BEGIN_MARK, _END_MARK = b"ISO-10303-21;", b"END-ISO-10303-21;"
_MARK_RANGE_BYTES = 1024  # number of bytes at the start and at the end of a file in which these marks must be
_MM_PER_M = 1000.0  # GLB is in metres
_FACE_BYTES = 120  # maximum size of a face in a GLB: three corners with normals, and their indices
_GLB_HEAD_BYTES = 2**20
_CONVERTER_PROGRAM = """
import ctypes, resource, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # ends with its parent process
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[5]), int(sys.argv[5])))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
import cascadio
sys.exit(cascadio.step_to_glb(sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4])))
"""


def read_step(name: str, data: bytes, max_triangles: int | None = None) -> Floats:
    """Read the solids of a STEP file, converted from its unit to mm.

    Parameters
    ----------
    name
        Name of the file, for messages.
    data
        Content of the file.
    max_triangles
        Number of triangles that fit in memory; None if there is no limit.

    Returns
    -------
    ndarray
        (m, 3, 3) triangles in mm, at most `LINEAR_DEFLECTION_MM` away from the exact surface.

    Raises
    ------
    ModelUnreadable
        The file cannot be read, or cascadio is not installed.
    ModelEmpty
        The file contains no surface.
    ModelTooDetailed
        The surface has more triangles than fit in memory.
    """
    if _BEGIN_MARK not in data[:_MARK_RANGE_BYTES] or _END_MARK not in data[-_MARK_RANGE_BYTES:]:
        raise ModelUnreadable(f"{name}: not a STEP file or only a part of one; copy or export it again")
    if not can_read_step():
        raise ModelUnreadable(
            f"{name}: STEP needs the package cascadio: `pip install 'farm[step]'`, or export it as 3MF or STL"
        )
    with tempfile.TemporaryDirectory(prefix="farm-step-") as folder:
        glb = _convert_to_glb(name, data, Path(folder))
        max_bytes = _GLB_HEAD_BYTES + _FACE_BYTES * (max_triangles or MAX_GLB_BYTES)
        if glb.stat().st_size > max_bytes:
            raise ModelTooDetailed(f"{name}: has more triangles than the memory allows: simplify it")
        with np.errstate(all="ignore"):  # coordinates are checked by the caller
            mesh: Any = trimesh.load(glb, process=False, force="mesh")
            triangles = np.array(mesh.triangles, dtype=np.float64) * _MM_PER_M
    if triangles.size == 0:
        raise ModelEmpty(f"{name}: holds no surface; export the solid again")
    if max_triangles is not None and len(triangles) > max_triangles:
        raise ModelTooDetailed(
            f"{name}: has {len(triangles) / 1e6:.1f} million triangles, but the memory suffices only for "
            f"{max_triangles / 1e6:.1f} million: simplify it"
        )
    return triangles


def _convert_to_glb(name: str, data: bytes, folder: Path) -> Path:
    """Convert a STEP file to a GLB file in a folder; raise ModelUnreadable if that fails."""
    step, glb = folder / "model.step", folder / "model.glb"
    step.write_bytes(data)
    arguments = (
        str(step), str(glb), str(LINEAR_DEFLECTION_MM), str(ANGULAR_DEFLECTION_RAD), str(MAX_GLB_BYTES)
    )  # fmt: skip
    try:
        process = subprocess.run(
            [sys.executable, "-c", _CONVERTER_PROGRAM, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=folder,
            timeout=MAX_READING_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ModelUnreadable(
            f"{name}: OpenCASCADE has not read it within {MAX_READING_S:g} s; export a simpler one, or STL"
        ) from None
    if process.returncode or not glb.is_file():
        problem = "crashed on" if process.returncode < 0 else "cannot read"
        raise ModelUnreadable(f"{name}: OpenCASCADE {problem} it; export it again, or as 3MF or STL")
    return glb
