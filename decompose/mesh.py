"""Reading a model: any file that claims to be a mesh -> a closed solid in mm, or a reason why not."""

from __future__ import annotations

import io
import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pymeshfix
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from decompose.errors import (
    BadSize,
    ModelEmpty,
    ModelFlat,
    ModelHuge,
    ModelNotFinite,
    ModelNotSolid,
    ModelTiny,
    ModelUnreadable,
)
from decompose.solid import Solid
from decompose.stl import faces_present, faces_promised, is_binary_stl

SUFFIXES = (".stl", ".obj", ".ply", ".off")
TINY_MM = 5.0  # under this longest side the unit is doubted
SMALLEST_MM = 0.1  # less than any nozzle draws
LARGEST_MM = 1e6  # further from the origin double precision falls short of the tolerances that cuts need
FLAT_RATIO = 1e-6  # of the longest side
AREA_SHARE = 0.20  # more change of the surface than this is no repair
EXTENT_SHARE = 0.05  # nor more change of the size than this
# Each body is closed and joined by itself. Real models have hundreds of them at most; loose triangles are one
# body each, no solid, and a large file of them would take hours.
MAX_BODIES = 1000
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


def load_model(
    path: Path,
    *,
    scale: float | None = None,
    longest_side_mm: float | None = None,
    name: str | None = None,
) -> Model:
    """Read a model file, scale it, and close it where it is open.

    Parameters
    ----------
    path
        STL (ASCII or binary), OBJ, PLY or OFF.
    scale
        Factor from the file's numbers to mm; 1 by default.
    longest_side_mm
        Instead of `scale`: the longest side that the model shall have.
    name
        What a person calls the file, where that is not the path's own name. Messages use it, and its suffix
        tells the kind of file.

    Raises
    ------
    ModelUnreadable, ModelEmpty, ModelNotFinite, ModelFlat, ModelTiny, ModelHuge, ModelNotSolid
        About in the order in which they are looked for.
    """
    where = _one_line(str(path) if name is None else name)
    suffix = Path(path.name if name is None else name).suffix.lower()
    name = _one_line(path.name if name is None else name)
    for flag, value in (("--scale", scale), ("--longest-side", longest_side_mm)):
        if value is not None and not 0.0 < value <= sys.float_info.max:
            raise BadSize(f"{flag} {value}: give a number above 0")
    if scale is not None and longest_side_mm is not None:
        raise BadSize("--scale and --longest-side exclude each other: give one of them")
    triangles = _read(path, where, name, suffix)
    if not np.isfinite(triangles).all():
        bad = int((~np.isfinite(triangles)).any(axis=(1, 2)).sum())
        raise ModelNotFinite(
            f"{name}: {bad} of {len(triangles)} triangles have a coordinate that is no number"
        )
    reach = float(np.abs(triangles).max())
    unit = triangles / (reach or 1.0)  # its squares neither overflow nor vanish
    cross = np.cross(unit[:, 1] - unit[:, 0], unit[:, 2] - unit[:, 0])
    if not cross.any():
        raise ModelEmpty(f"{name}: holds no triangle with an area; export the model again")
    size = unit.max(axis=(0, 1)) - unit.min(axis=(0, 1))
    if size.min() <= FLAT_RATIO * size.max():
        axis = "xyz"[int(size.argmin())]
        raise ModelFlat(f"{name}: is flat, without thickness along {axis}; a print needs a solid")
    factor = _factor(name, float(size.max()) * reach, scale, longest_side_mm)
    if float(size.max()) * reach * factor < SMALLEST_MM:
        raise ModelTiny(f"{name}: would be less than {SMALLEST_MM:g} mm long; give a larger --longest-side")
    if not reach * factor <= LARGEST_MM:
        raise ModelHuge(
            f"{name}: would reach {reach * factor:.3g} mm from its origin (limit {LARGEST_MM:g} mm): "
            "give a smaller --longest-side, or move the model to its origin"
        )
    solid, repairs = _close(name, triangles * factor)
    return Model(solid, tuple(repairs), factor)


def _one_line(text: str) -> str:
    """Without what would break a line or cannot be printed; file names may hold anything."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _read(path: Path, where: str, name: str, suffix: str) -> Floats:
    """The file's triangles (m, 3, 3)."""
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:  # a path with a zero byte is a ValueError
        why = getattr(error, "strerror", None) or error
        raise ModelUnreadable(f"{where}: cannot be read ({why}); check the path") from error
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
    if suffix == ".stl" and not is_binary_stl(data) and b"endsolid" not in data[-1000:].lower():
        raise ModelUnreadable(f"{name}: breaks off before its end; copy or export it again")
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # its errors come back as ours
    try:
        loaded: Any = trimesh.load(io.BytesIO(data), file_type=suffix[1:], process=False, force="mesh")
        triangles = np.array(loaded.triangles, dtype=np.float64)
    except Exception as error:  # readers of hostile bytes raise anything
        why = _one_line(str(error).strip().splitlines()[0][:80]) if str(error).strip() else "no reason given"
        if isinstance(error, ImportError):  # the reader looks for a package that guesses encodings
            why = "its text is not UTF-8"
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
    """A closed solid of the triangles, and what it took.

    Bodies that do not touch are closed one by one: repair of all at once would drop all but the largest.
    """
    repairs: list[str] = []
    soup = np.arange(3 * len(triangles)).reshape(-1, 3)
    mesh: Any = trimesh.Trimesh(triangles.reshape(-1, 3), soup, process=False)
    mesh.merge_vertices(digits_vertex=None)
    f = mesh.faces  # triangles without area but with three corners stay: they may hold the surface together
    whole = (f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])
    mesh.update_faces(whole & mesh.unique_faces())
    dropped = len(triangles) - len(mesh.faces)
    if dropped:
        repairs.append(f"Dropped {dropped} triangles that had collapsed or were given twice.")
    before = _bodies(name, mesh)
    after = [b if b.is_watertight and b.is_winding_consistent else _mesh_fix(b) for b in before]
    _refuse_if_changed(name, before, after)
    broken = [b for b in before if not b.is_watertight]
    if broken:
        edges = np.concatenate([np.sort(b.edges, axis=1) + 10**9 * i for i, b in enumerate(broken)])
        _, counts = np.unique(edges, axis=0, return_counts=True)
        change = 100.0 * (_area(after) / _area(before) - 1.0)
        repairs.append(
            f"Closed an open mesh ({int((counts == 1).sum())} open edges, {int((counts > 2).sum())} shared "
            f"by more than two triangles): {sum(len(b.faces) for b in before)} triangles became "
            f"{sum(len(b.faces) for b in after if b is not None)}, the surface changed by {change:+.2f} %."
        )
    if any(b.is_watertight and not b.is_winding_consistent for b in before):
        repairs.append("Turned triangles that faced the wrong way.")
    return _join(name, [b for b in after if b is not None], repairs), repairs


def _bodies(name: str, mesh: Any) -> list[Any]:
    """The mesh's connected bodies."""
    f = mesh.faces
    links = np.concatenate([f[:, :2], f[:, 1:]])
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(mesh.vertices),) * 2)
    label = connected_components(graph, directed=False)[1][f[:, 0]]
    order = np.argsort(label, kind="stable")
    starts = np.flatnonzero(np.diff(label[order])) + 1
    if len(starts) >= MAX_BODIES:
        raise ModelNotSolid(
            f"{name}: {len(starts) + 1} loose surfaces (limit {MAX_BODIES}): loose triangles, or a scan with "
            "its dust, are no solid; delete what is loose and export a solid"
        )
    bodies = []
    for faces in np.split(f[order], starts) if len(f) else []:
        used, index = np.unique(faces, return_inverse=True)
        bodies.append(trimesh.Trimesh(mesh.vertices[used], index.reshape(-1, 3), process=False))
    return bodies


def _mesh_fix(body: Any) -> Any:
    """The body closed and turned outward by MeshFix, or None where nothing closed is left of it."""
    if len(body.faces) < 4:
        return None
    fixer = pymeshfix.MeshFix(np.array(body.vertices), np.array(body.faces))
    try:
        fixer.repair(joincomp=True, remove_smallest_components=False)
    except Exception:  # the compiled repair names no errors
        return None
    fixed: Any = trimesh.Trimesh(fixer.points, fixer.faces, process=False)
    return fixed if len(fixed.faces) and fixed.is_watertight else None


def _area(bodies: list[Any]) -> float:
    return float(sum(b.area for b in bodies if b is not None))


def _refuse_if_changed(name: str, before: list[Any], after: list[Any]) -> None:
    """A repair that changes much has invented a model; half a model and loose triangles are caught here."""
    left = [b for b in after if b is not None]
    if not left or _area(before) == 0.0:
        raise ModelNotSolid(f"{name}: {len(before)} loose surfaces, none of them a solid; export a solid")
    kept = _area(after) / _area(before)
    if abs(kept - 1.0) > AREA_SHARE:
        raise ModelNotSolid(
            f"{name}: not closed, and closing it would change its surface by {100 * (kept - 1):+.0f} % "
            f"(limit {100 * AREA_SHARE:.0f} %): half a model or loose triangles; repair it by hand"
        )
    old, new = (
        np.array([np.min(b, axis=0)[0], np.max(b, axis=0)[1]])
        for b in ([b.bounds for b in before], [b.bounds for b in left])
    )
    shrink = float(np.abs(new - old).max() / np.ptp(old, axis=0).max())
    if shrink > EXTENT_SHARE:
        raise ModelNotSolid(
            f"{name}: not closed, and closing it would change its size by {100 * shrink:.0f} %; "
            "repair it by hand"
        )


def _join(name: str, bodies: list[Any], repairs: list[str]) -> Solid:
    """All bodies as one solid: the large ones first, cavities taken out, bodies inside cavities put back."""
    if sum(b.volume for b in bodies) < 0.0:
        for body in bodies:
            body.invert()
        repairs.append("Turned the model inside out: its triangles faced inwards.")
    bodies = sorted(bodies, key=lambda b: -abs(b.volume))
    turned = 0
    lo, hi = (np.array([b.bounds[end] for b in bodies]) for end in (0, 1))
    for i, body in enumerate(bodies):
        inside = ((lo[:i] <= lo[i]) & (hi[:i] >= hi[i])).all(axis=1).any()
        if body.volume < 0.0 and not inside:  # no cavity: there is nothing around it
            body.invert()
            turned += 1
    if turned:
        repairs.append(f"Turned {turned} of {len(bodies)} bodies inside out: their triangles faced inwards.")
    cavity = [b.volume < 0.0 for b in bodies]
    for body, is_cavity in zip(bodies, cavity, strict=True):
        if is_cavity:
            body.invert()
    solids = [Solid.from_arrays(b.vertices, b.faces) for b in bodies]
    solid = solids[0]
    if any(cavity):
        for other, is_cavity in zip(solids[1:], cavity[1:], strict=True):
            solid = solid.subtract(other) if is_cavity else Solid.union([solid, other])
    elif len(solids) > 1:
        solid = Solid.union(solids)
    if solid.is_empty or solid.volume_mm3 <= 0.0:
        raise ModelNotSolid(f"{name}: its triangles enclose no volume; export a solid")
    if len(solids) > 1:
        repairs.append(f"Took {len(solids)} bodies as one solid of {solid.volume_mm3 / 1000.0:.1f} cm3.")
    return solid
