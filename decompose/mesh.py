"""Reading a model: any file that claims to be a mesh -> a closed solid in mm, or a reason why not."""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pymeshfix
import trimesh

from decompose.errors import (
    ModelEmpty,
    ModelFlat,
    ModelNotFinite,
    ModelNotSolid,
    ModelTiny,
    ModelUnreadable,
)
from decompose.solid import Solid
from decompose.stl import faces_present, faces_promised, is_binary_stl

SUFFIXES = (".stl", ".obj", ".ply", ".off")
TINY_MM = 5.0  # under this longest side the unit is doubted
FLAT_RATIO = 1e-6  # of the longest side
REPAIR_SHARE = 0.10  # of area or of an extent: more change than this is no repair
UNITS = {"metres": 1000.0, "inches": 25.4}

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Model:
    """A model ready to cut.

    Attributes
    ----------
    solid
        Closed, in mm, in the file's own frame times `scale`.
    repairs
        What was done to it, a sentence each.
    scale
        The factor from the file's numbers to mm.
    """

    solid: Solid
    repairs: tuple[str, ...]
    scale: float

    @property
    def extents_mm(self) -> Floats:
        lo, hi = self.solid.bounds_mm
        return np.asarray(hi - lo)

    @property
    def mesh(self) -> Any:
        """As a `trimesh.Trimesh`, in mm."""
        vertices, faces = self.solid.arrays()
        return trimesh.Trimesh(vertices, faces, process=False)


def load_model(path: Path, *, scale: float | None = None, longest_side_mm: float | None = None) -> Model:
    """Read a model file, scale it, and close it where it is open.

    Parameters
    ----------
    path
        STL (ASCII or binary), OBJ, PLY or OFF.
    scale
        Factor from the file's numbers to mm; 1 by default.
    longest_side_mm
        Instead of `scale`: the longest side that the model shall have.

    Raises
    ------
    ModelUnreadable, ModelEmpty, ModelNotFinite, ModelFlat, ModelTiny, ModelNotSolid
        In the order in which they are looked for.
    """
    name = path.name
    for flag, value in (("--scale", scale), ("--longest-side", longest_side_mm)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise ModelUnreadable(f"{flag} {value}: give a number above 0")
    if scale is not None and longest_side_mm is not None:
        raise ModelUnreadable("--scale and --longest-side exclude each other: give one of them")
    triangles = _read(path)
    if not np.isfinite(triangles).all():
        bad = int((~np.isfinite(triangles)).any(axis=(1, 2)).sum())
        raise ModelNotFinite(
            f"{name}: {bad} of {len(triangles)} triangles have a coordinate that is no number"
        )
    area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    if not (area > 0.0).any():
        raise ModelEmpty(f"{name}: holds no triangle with an area; export the model again")
    size = triangles.max(axis=(0, 1)) - triangles.min(axis=(0, 1))
    if size.min() <= FLAT_RATIO * size.max():
        axis = "xyz"[int(size.argmin())]
        raise ModelFlat(f"{name}: is flat, without thickness along {axis}; a print needs a solid")
    factor = _factor(name, float(size.max()), scale, longest_side_mm)
    solid, repairs = _close(name, triangles * factor)
    return Model(solid, tuple(repairs), factor)


def _read(path: Path) -> Floats:
    """The file's triangles (m, 3, 3)."""
    name = path.name
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelUnreadable(f"{path}: cannot be read ({error.strerror}); check the path") from error
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        known = ", ".join(s[1:].upper() for s in SUFFIXES)
        raise ModelUnreadable(f"{name}: not a known kind of model; export it as one of {known}")
    if not data:
        raise ModelEmpty(f"{name}: the file is empty; export the model again")
    if suffix == ".stl" and is_binary_stl(data):
        if len(data) < 84:
            raise ModelUnreadable(f"{name}: {len(data)} bytes are no STL; export the model again")
        promised, present = faces_promised(data), faces_present(data)
        if promised > present:
            raise ModelUnreadable(
                f"{name}: its header promises {promised} triangles, the file holds {int(present)}: "
                "not an STL or only a part of one; copy or export it again"
            )
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # its errors come back as ours
    try:
        loaded: Any = trimesh.load(io.BytesIO(data), file_type=suffix[1:], process=False, force="mesh")
        triangles = np.array(loaded.triangles, dtype=np.float64)
    except Exception as error:  # readers of hostile bytes raise anything
        why = str(error).splitlines()[0][:80] if str(error) else type(error).__name__
        raise ModelUnreadable(
            f"{name}: cannot be read as {suffix[1:].upper()} ({why}); export it again"
        ) from error
    if triangles.size == 0:
        raise ModelEmpty(f"{name}: holds no triangles; export the model again")
    return triangles.reshape(-1, 3, 3)


def _factor(name: str, longest: float, scale: float | None, longest_side_mm: float | None) -> float:
    if longest_side_mm is not None:
        return longest_side_mm / longest
    if scale is not None:
        return scale
    if longest < TINY_MM:
        guesses = " or ".join(f"--scale {factor:g} if it is in {unit}" for unit, factor in UNITS.items())
        raise ModelTiny(f"{name}: longest side {longest:.3g} mm; give --longest-side MM, or {guesses}")
    return 1.0


def _close(name: str, triangles: Floats) -> tuple[Solid, list[str]]:
    """A closed solid of the triangles, and what it took."""
    repairs: list[str] = []
    mesh: Any = trimesh.Trimesh(
        triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False
    )
    mesh.merge_vertices(digits_vertex=None)
    f = mesh.faces  # triangles without area but with three corners stay: they may hold the surface together
    mesh.update_faces(
        (f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0]) & mesh.unique_faces()
    )
    mesh.remove_unreferenced_vertices()
    dropped = len(triangles) - len(mesh.faces)
    if dropped:
        repairs.append(f"Dropped {dropped} triangles that had collapsed or were given twice.")
    if mesh.is_watertight:
        return _oriented(name, mesh, repairs), repairs
    edges = np.sort(mesh.edges, axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    open_edges, odd_edges = int((counts == 1).sum()), int((counts > 2).sum())
    fixed = _mesh_fix(name, mesh)
    _refuse_if_changed(name, mesh, fixed)
    change = 100.0 * (fixed.area / mesh.area - 1.0)
    repairs.append(
        f"Closed an open mesh ({open_edges} open edges, {odd_edges} shared by more than two triangles): "
        f"{len(mesh.faces)} triangles became {len(fixed.faces)}, the surface changed by {change:+.2f} %."
    )
    return _oriented(name, fixed, repairs), repairs


def _mesh_fix(name: str, mesh: Any) -> Any:
    fixer = pymeshfix.MeshFix(np.array(mesh.vertices), np.array(mesh.faces))
    try:
        fixer.repair(joincomp=True, remove_smallest_components=False)
    except Exception as error:
        raise ModelNotSolid(f"{name}: not closed, and repair failed ({error}); repair it by hand") from error
    fixed = trimesh.Trimesh(fixer.points, fixer.faces, process=False)
    if not len(fixed.faces) or not fixed.is_watertight:
        raise ModelNotSolid(
            f"{name}: loose triangles, no solid: repair leaves nothing closed; export a solid"
        )
    return fixed


def _refuse_if_changed(name: str, before: Any, after: Any) -> None:
    """A repair that changes much has invented a model; half a model and loose triangles are caught here."""
    kept = after.area / before.area
    if abs(kept - 1.0) > REPAIR_SHARE:
        raise ModelNotSolid(
            f"{name}: not closed, and closing it would change its surface by {100 * (kept - 1):+.0f} % "
            f"(limit {100 * REPAIR_SHARE:.0f} %): half a model or loose triangles; repair it by hand"
        )
    shrink = np.abs(after.extents - before.extents).max() / before.extents.max()
    if shrink > REPAIR_SHARE / 2:
        raise ModelNotSolid(
            f"{name}: not closed, and closing it would change its size by {100 * shrink:.0f} %; "
            "repair it by hand"
        )


def _oriented(name: str, mesh: Any, repairs: list[str]) -> Solid:
    """Each body outward, then all as one solid."""
    bodies = mesh.split(only_watertight=False) if mesh.body_count > 1 else [mesh]
    if not mesh.is_winding_consistent:
        for body in bodies:
            trimesh.repair.fix_winding(body)  # type: ignore[no-untyped-call]
        repairs.append("Turned triangles that faced the wrong way.")
    # A body inside another is a cavity where the two face opposite ways; so only all together are turned.
    vertices = np.concatenate([b.vertices for b in bodies])
    starts = np.cumsum([0] + [len(b.vertices) for b in bodies[:-1]])
    faces = np.concatenate([b.faces + start for b, start in zip(bodies, starts, strict=True)])
    whole = trimesh.Trimesh(vertices, faces, process=False)
    if whole.volume < 0.0:
        whole.invert()
        repairs.append("Turned the model inside out: its triangles faced inwards.")
    solid = Solid.from_arrays(whole.vertices, whole.faces)
    if solid.is_empty or solid.volume_mm3 <= 0.0:
        raise ModelNotSolid(f"{name}: its triangles enclose no volume; export a solid")
    if len(bodies) > 1:
        solid = Solid.union(_nested(solid))
        repairs.append(f"Took {len(bodies)} bodies as one solid of {solid.volume_mm3 / 1000.0:.1f} cm3.")
    return solid


def _nested(solid: Solid) -> list[Solid]:
    """The solid's bodies, each with its cavities, so that overlapping ones can be joined."""
    pieces = solid.pieces()
    outer = [p for p in pieces if p.volume_mm3 > 0.0]
    return outer if len(outer) == len(pieces) else [solid]
