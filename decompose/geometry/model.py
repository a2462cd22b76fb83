"""Reader of models: converts a mesh file to a closed solid in mm, or raises an error."""

from __future__ import annotations

import io
import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from decompose.arrays import Floats
from decompose.errors import (
    BadSize,
    ModelEmpty,
    ModelFlat,
    ModelHuge,
    ModelNotFinite,
    ModelTiny,
    ModelUnreadable,
)
from decompose.files.triangle_limit import (
    STL_COUNT_BYTES,
    STL_FACE_BYTES,
    STL_HEADER_BYTES,
    compute_max_triangles,
    is_binary_stl,
    read_face_count,
)
from decompose.geometry.formats import check_limits, count_stored_faces, parse_triangles, read_3mf, read_step
from decompose.geometry.repair import StepListener, close_surface
from decompose.geometry.solid import Solid
from decompose.geometry.weld import weld_triangles

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".3mf", ".step", ".stp")
MIN_PLAUSIBLE_SIDE_MM = 5.0  # longest side below which the unit is probably not mm
MIN_SIDE_MM = 0.1  # minimum longest side: a smaller model is thinner than the line of any nozzle
MAX_COORDINATE_MM = 1e6  # maximum coordinate; beyond it, double precision is too coarse for cuts
MIN_THICKNESS_SHARE = 1e-6  # minimum shortest side, as a share of the longest; a thinner model counts as flat
_BATCH_TRIANGLES = 100_000  # number of triangles that are measured at a time
MM_PER_UNIT = {"metres": 1000.0, "inches": 25.4}


@dataclass(frozen=True, slots=True)
class Model:
    """A model that is ready to be cut.

    Attributes
    ----------
    solid
        Closed solid in mm, in the file's own frame scaled by `scale`.
    repairs
        Sentences that describe the repairs.
    scale
        Factor from the file's numbers to mm.
    """

    solid: Solid
    repairs: tuple[str, ...]
    scale: float

    @property
    def extents_mm(self) -> Floats:
        """Size (3,) along the axes."""
        lo_mm, hi_mm = self.solid.bounds_mm
        return np.asarray(hi_mm - lo_mm)

    @property
    def mesh(self) -> Any:
        """Model as a `trimesh.Trimesh`, in mm."""
        vertices, faces = self.solid.arrays()
        return trimesh.Trimesh(vertices, faces, process=False)


def load_model(
    path: Path,
    *,
    scale: float | None = None,
    longest_side_mm: float | None = None,
    name: str | None = None,
    memory_bytes: int | None = None,
    report: StepListener = lambda _: None,
) -> Model:
    """Read a model file, scale it, and close its open surfaces.

    Parameters
    ----------
    path
        STL (ASCII or binary), OBJ, PLY, OFF, 3MF or STEP; the last two state their unit, and are converted to
        mm.
    scale
        Factor from the file's numbers to mm; 1 by default.
    longest_side_mm
        Longest side of the scaled model, instead of `scale`.
    name
        Name of the file in messages; its suffix gives the format. By default, it is the name of the path.
    memory_bytes
        Memory that the process may use; None if there is no limit.
    report
        Function that is called with a short name of each step when it begins.

    Raises
    ------
    ModelUnreadable, ModelEmpty, ModelTooDetailed, ModelNotFinite, ModelFlat, ModelTiny, ModelHuge,
    ModelNotSolid
        The model cannot be used, for the reason that the class describes. The classes are listed
        approximately in the order of the checks.
    """
    source = _replace_unprintable_characters(str(path) if name is None else name)
    suffix = Path(path.name if name is None else name).suffix.lower()
    name = _replace_unprintable_characters(path.name if name is None else name)
    _check_size_options(scale, longest_side_mm)
    report("reading")
    triangles, notes = _read_triangles(path, source, name, suffix, memory_bytes)
    longest_side, max_coordinate = _measure_triangles(name, triangles)
    factor = _choose_factor(name, longest_side, scale, longest_side_mm)
    _check_scaled_size(name, longest_side * factor, max_coordinate * factor)
    report("checking its surface")
    triangles *= factor
    surface = weld_triangles(triangles)
    del triangles  # the triangles of a large model take half a gigabyte
    solid, repairs = close_surface(name, surface, report)
    return Model(solid, (*notes, *repairs), factor)


def _check_size_options(scale: float | None, longest_side_mm: float | None) -> None:
    """Refuse a scale or a longest side that no model can have, and the combination of both."""
    for flag, value in (("--scale", scale), ("--longest-side", longest_side_mm)):
        if value is not None and not 0.0 < value <= sys.float_info.max:
            raise BadSize(f"{flag} {value}: give a number above 0")
    if scale is not None and longest_side_mm is not None:
        raise BadSize("--scale and --longest-side exclude each other: give one of them")


def _measure_triangles(name: str, triangles: Floats) -> tuple[float, float]:
    """Measure the longest side and the largest coordinate of triangles (m, 3, 3), in the unit of the file.

    A model is refused if any triangle is not finite, if no triangle has an area, or if it is flat.
    """
    if not np.isfinite(triangles).all():
        bad_count = int((~np.isfinite(triangles)).any(axis=(1, 2)).sum())
        raise ModelNotFinite(
            f"{name}: {bad_count} of {len(triangles)} triangles have a coordinate that is not a number"
        )
    lo, hi = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    max_coordinate = float(np.abs([lo, hi]).max())
    scale = max_coordinate or 1.0  # so that squares neither overflow nor underflow
    batches = (
        triangles[i : i + _BATCH_TRIANGLES] / scale for i in range(0, len(triangles), _BATCH_TRIANGLES)
    )
    if not any(np.cross(b[:, 1] - b[:, 0], b[:, 2] - b[:, 0]).any() for b in batches):
        raise ModelEmpty(f"{name}: has no triangle with an area; export the model again")
    size = hi / scale - lo / scale
    if size.min() <= MIN_THICKNESS_SHARE * size.max():
        axis = "xyz"[int(size.argmin())]
        raise ModelFlat(f"{name}: is flat, without thickness along {axis}; a print needs a solid")
    return float(size.max()) * max_coordinate, max_coordinate


def _check_scaled_size(name: str, longest_side_mm: float, max_coordinate_mm: float) -> None:
    """Refuse a model that is tiny, or far from its origin."""
    if longest_side_mm < MIN_SIDE_MM:
        raise ModelTiny(f"{name}: would be less than {MIN_SIDE_MM:g} mm long; give a larger --longest-side")
    if not max_coordinate_mm <= MAX_COORDINATE_MM:
        raise ModelHuge(
            f"{name}: would reach {max_coordinate_mm:.3g} mm from its origin (limit "
            f"{MAX_COORDINATE_MM:g} mm): give a smaller --longest-side, or move the model to its origin"
        )


def _replace_unprintable_characters(text: str) -> str:
    """Replace line breaks and unprintable characters, which file names may contain."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _read_triangles(
    path: Path, source: str, name: str, suffix: str, memory_bytes: int | None
) -> tuple[Floats, tuple[str, ...]]:
    """Read the triangles (m, 3, 3) of a file; also return sentences on what was left out or converted."""
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:  # a path with a null byte raises a ValueError
        reason = getattr(error, "strerror", None) or error
        raise ModelUnreadable(f"{source}: cannot be read ({reason}); check the path") from error
    if suffix not in SUFFIXES:
        formats = ", ".join(s[1:].upper() for s in SUFFIXES if s != ".stp")
        raise ModelUnreadable(f"{name}: not a known kind of model; export it as one of {formats}")
    if not data:
        raise ModelEmpty(f"{name}: the file is empty; export the model again")
    triangle_limit = None if memory_bytes is None else compute_max_triangles(memory_bytes)
    match suffix:
        case ".3mf":
            return read_3mf(name, data, triangle_limit)
        case ".step" | ".stp":
            return read_step(name, data, triangle_limit), ()
        case ".stl":
            data, notes = _check_stl(name, data)
        case _:
            notes = ()
    check_limits(name, data, suffix, memory_bytes)
    if suffix == ".stl" and is_binary_stl(data):
        triangles = parse_triangles(data)
        if not len(triangles):
            raise ModelEmpty(f"{name}: has no triangles; export the model again")
        return triangles, notes
    return _load_triangles(name, data, suffix), notes


def _check_stl(name: str, data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Refuse an incomplete STL; cut off bytes after its triangles, and also return a sentence on them."""
    if not is_binary_stl(data):
        if b"endsolid" not in data[-1000:].lower():
            raise ModelUnreadable(f"{name}: ends too early; copy or export it again")
        return data, ()
    if len(data) < STL_HEADER_BYTES + STL_COUNT_BYTES:
        raise ModelUnreadable(
            f"{name}: has only {len(data)} bytes, too few for an STL; export the model again"
        )
    stated_count, stored_count = read_face_count(data), count_stored_faces(data)
    if stated_count > stored_count:
        raise ModelUnreadable(
            f"{name}: its header states {stated_count} triangles, the file holds {int(stored_count)}: "
            "not an STL or only a part of one; copy or export it again"
        )
    if stated_count == stored_count:
        return data, ()
    # Some programs write colours or their name after the last triangle.
    stl_bytes = STL_HEADER_BYTES + STL_COUNT_BYTES + stated_count * STL_FACE_BYTES
    return data[:stl_bytes], (f"Left out {len(data) - stl_bytes} bytes after the last triangle.",)


def _load_triangles(name: str, data: bytes, suffix: str) -> Floats:
    """Parse the triangles (m, 3, 3) of a file with trimesh."""
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # its errors are raised as ModelUnreadable
    try:
        with np.errstate(all="ignore"):  # normals of hostile files; coordinates are checked by the caller
            mesh: Any = trimesh.load(io.BytesIO(data), file_type=suffix[1:], process=False, force="mesh")
            triangles = np.array(mesh.triangles, dtype=np.float64)
    except Exception as error:  # for hostile bytes a reader may raise any exception
        reason = (
            _replace_unprintable_characters(str(error).strip().splitlines()[0][:80])
            if str(error).strip()
            else "no reason given"
        )
        # For text that is not UTF-8, trimesh imports a package that guesses encodings; it is not installed.
        if isinstance(error, ImportError):
            reason = "its text is not UTF-8"
        raise ModelUnreadable(
            f"{name}: cannot be read as {suffix[1:].upper()} ({reason}); export it again"
        ) from error
    if triangles.size == 0:
        raise ModelEmpty(f"{name}: has no triangles; export the model again")
    return triangles.reshape(-1, 3, 3)


def _choose_factor(
    name: str, longest_side: float, scale: float | None, longest_side_mm: float | None
) -> float:
    """Choose the factor from the file's numbers to mm; refuse a model whose unit is probably not mm."""
    if longest_side_mm is not None:
        return longest_side_mm / longest_side
    if scale is not None:
        return scale
    if longest_side < MIN_PLAUSIBLE_SIDE_MM:
        guesses = " or ".join(
            f"--scale {factor:g} if it is in {unit}" for unit, factor in MM_PER_UNIT.items()
        )
        raise ModelTiny(f"{name}: longest side {longest_side:.3g} mm; give --longest-side MM, or {guesses}")
    return 1.0
