"""Repair of triangles, so that they bound a closed solid; each change is described in a sentence.

A repair is judged by its effect on the surface: hardly any of the original surface may lie outside the
repaired solid and far from it, and only a little surface may be added.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pymeshfix
import trimesh
from scipy.spatial import cKDTree

from decompose.arrays import Bools, Floats, Ints
from decompose.errors import ModelNotSolid
from decompose.geometry.overlaps import resolve_overlaps
from decompose.geometry.shells import (
    cap_holes,
    find_rims,
    is_flat,
    label_components,
    orient_faces,
    split_shells,
)
from decompose.geometry.solid import Solid
from decompose.geometry.weld import EdgeUses, Surface, count_edge_uses
from decompose.jit import jit

MAX_MOVE_SHARE = 0.005  # distance by which the surface may move, as a share of the longest side
# Maximum share of the surface that lies outside the repaired solid, farther from it than this distance;
# if the share is greater, the model is refused.
MAX_LOST_SHARE = 0.02
MAX_NEW_SHARE = 0.20  # maximum share of new surface in the repaired surface; beyond it, the model is refused
MAX_EXTENT_CHANGE_SHARE = 0.05  # maximum change of a bound, as a share of the longest side
# Minimum and maximum number of samples: points on a surface, to whose triangles distances are measured.
MIN_SAMPLE_COUNT, MAX_SAMPLE_COUNT = 40_000, 2_000_000
# Expected number of samples around a point of the surface that are nearer than the distance that counts as
# far. With fewer samples, small triangles of the surface itself count as far from it.
SAMPLES_WITHIN_LIMIT = 9.0
PROBE_COUNT = 5_000  # number of points from which distances are measured
MIN_VOLUME_SHARE = 1e-9  # minimum enclosed volume, as a share of area^1.5; bodies with less are left out
NEIGHBOUR_COUNT = 6  # number of nearest samples; the exact distance to the triangle of each is computed
# A body is a connected component of the surface. Each body is closed and joined separately. Real models have
# hundreds of bodies at most. In a file of loose triangles each triangle is a body, and a large file of this
# kind would take hours.
MAX_BODIES = 1000


StepListener = Callable[[str], None]
"""Function that is called with a short name of each step when it begins."""


def close_surface(
    name: str, surface: Surface, report: StepListener = lambda _: None
) -> tuple[Solid, list[str]]:
    """Close a surface so that it bounds a solid; also return sentences on the repairs.

    Parameters
    ----------
    name
        Name of the file, for messages.
    surface
        Surface whose triangles share vertices.
    report
        Function that is called with a short name of each step when it begins.

    Raises
    ------
    ModelNotSolid
        The surface bounds no solid, or its repair would remove or add too much surface.
    """
    repairs = list(surface.repairs)
    split_bodies = _list_bodies(name, surface)
    uses = [count_edge_uses(body.faces) for body in split_bodies]
    closed_bodies, is_changed = _close_bodies(split_bodies, uses, report)
    if not closed_bodies:
        raise ModelNotSolid(
            f"{name}: {len(split_bodies)} loose surfaces, none of them a solid; export a solid"
        )
    messages: list[str] = []
    bodies_before, bodies_after = len(split_bodies), len(closed_bodies)
    if bodies_after > 1:
        report(f"joining {bodies_after} bodies")
    solid = _join_bodies(name, closed_bodies, messages)
    del split_bodies, closed_bodies  # the bodies of a large model take a gigabyte
    single_edge_count = sum(use.single_count for use in uses)
    nonmanifold_edge_count = sum(use.nonmanifold_count for use in uses)
    if is_changed:
        report("comparing the repaired surface")
        repairs.append(_describe_repair(name, surface, solid, single_edge_count, nonmanifold_edge_count))
    elif nonmanifold_edge_count:
        noun = "bodies" if bodies_after > bodies_before else "surfaces"
        repairs.append(
            f"Separated {noun} that touch or overlap "
            f"({nonmanifold_edge_count} edges shared by more than two triangles)."
        )
    if any(use.is_closed and use.repeated_count for use in uses):
        repairs.append("Turned triangles that faced the wrong way.")
    solid, excess_mm3 = resolve_overlaps(solid)
    if excess_mm3:
        messages.append(f"United bodies that intersected: {excess_mm3:.3g} mm3 were counted twice.")
    return solid, repairs + messages


def _list_bodies(name: str, surface: Surface) -> list[Any]:
    """Split a surface into its connected bodies."""
    f = surface.faces
    rows, columns = np.concatenate([f[:, 0], f[:, 1]]), np.concatenate([f[:, 1], f[:, 2]])
    vertex_label = label_components(len(surface.vertices), rows, columns)
    del rows, columns
    face_label = vertex_label[f[:, 0]]
    face_order, vertex_order = np.argsort(face_label, kind="stable"), np.argsort(vertex_label, kind="stable")
    starts = np.flatnonzero(np.diff(face_label[face_order])) + 1
    if len(starts) >= MAX_BODIES:
        raise ModelNotSolid(
            f"{name}: {len(starts) + 1} loose surfaces (limit {MAX_BODIES}): loose triangles, or a scan with "
            "noise, are not a solid; delete loose pieces and export a solid"
        )
    number = np.zeros(len(surface.vertices), dtype=np.int64)
    sorted_labels = vertex_label[vertex_order]
    bodies = []
    for faces in np.split(f[face_order], starts) if len(f) else []:
        label = vertex_label[faces[0, 0]]
        begin, end = np.searchsorted(sorted_labels, [label, label + 1])
        vertex_numbers = vertex_order[begin:end]
        number[vertex_numbers] = np.arange(len(vertex_numbers))
        bodies.append(trimesh.Trimesh(surface.vertices[vertex_numbers], number[faces], process=False))
    return bodies


def _close_bodies(
    bodies: list[Any], edge_uses: list[EdgeUses], report: StepListener
) -> tuple[list[Any], bool]:
    """Close bodies, and leave out those without volume; also return whether the surface was changed.

    Flat holes are capped. Other holes are closed by MeshFix, one body after the other, because MeshFix keeps
    only the largest of several bodies. If MeshFix removes part of a body's surface, its result is not
    used, and all holes of the body are capped.
    """
    closed_bodies: list[Any] = []
    open_bodies: list[Any] = []
    is_changed = False
    for number, (body, use) in enumerate(zip(bodies, edge_uses, strict=True), 1):
        if use.is_closed and not use.repeated_count:
            closed_bodies.append(body)
            continue
        report(f"repairing body {number} of {len(bodies)}" if len(bodies) > 1 else "repairing")
        parts = _split_shells(body)
        if parts is None or not all(
            is_flat(part.vertices[rim]) for part in parts for rim in find_rims(part.faces)
        ):
            repaired_mesh = _run_mesh_fix(body)
            if repaired_mesh is not None and (
                parts is None or not _is_far(body, repaired_mesh).mean() > MAX_LOST_SHARE
            ):
                closed_bodies.append(repaired_mesh)
                is_changed = True
                continue
            is_changed = is_changed or parts is None  # a body that cannot be closed is left out
        for part in parts or []:
            (closed_bodies if part.is_watertight else open_bodies).append(part)
    if open_bodies:
        merged_mesh: Any = trimesh.util.concatenate(open_bodies)
        faces = np.concatenate([merged_mesh.faces, cap_holes(merged_mesh.vertices, merged_mesh.faces)])
        closed_bodies += [
            trimesh.Trimesh(*shell, process=False)
            for shell in split_shells(merged_mesh.vertices, faces) or []
        ]
    thick_shells = []
    for body in closed_bodies:
        volume_mm3, area_mm2 = _measure_body(body)
        if abs(volume_mm3) > MIN_VOLUME_SHARE * area_mm2**1.5:
            thick_shells.append(body)
    return thick_shells, is_changed or bool(open_bodies) or len(thick_shells) < len(closed_bodies)


def _split_shells(body: Any) -> list[Any] | None:
    """Split a body into surfaces by `split_shells`; None if they cannot be separated."""
    faces = orient_faces(np.asarray(body.faces))
    shells = None if faces is None else split_shells(np.asarray(body.vertices), faces)
    return None if shells is None else [trimesh.Trimesh(*shell, process=False) for shell in shells]


def _run_mesh_fix(body: Any) -> Any:
    """Close a body and orient it outward by MeshFix; None if the result is not closed."""
    faces = np.array(body.faces)[body.unique_faces()]
    if len(faces) < 4:
        return None
    fixer = pymeshfix.MeshFix(np.array(body.vertices), faces)
    try:
        fixer.repair(joincomp=True, remove_smallest_components=False)
    except Exception:  # the compiled repair does not document its errors
        return None
    repaired_mesh: Any = trimesh.Trimesh(fixer.points, fixer.faces, process=False)
    return repaired_mesh if len(repaired_mesh.faces) and repaired_mesh.is_watertight else None


def _describe_repair(
    name: str, surface: Surface, solid: Solid, single_edge_count: int, nonmanifold_edge_count: int
) -> str:
    """Describe the repair of a surface in a sentence; refuse a repair that changes the model too much."""
    is_open = single_edge_count > 0
    unpaired_defect = f"no solid ({nonmanifold_edge_count} edges whose triangles do not pair up)"
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    new_share = _check_repair(name, mesh, solid, "not closed" if is_open else unpaired_defect)
    return (
        f"{'Closed an open' if is_open else 'Repaired a non-manifold'} mesh ({single_edge_count} open edges, "
        f"{nonmanifold_edge_count} shared by more than two triangles): {100.0 * new_share:.2g} % of the "
        "surface is new."
    )


def _check_repair(name: str, mesh_before: Any, solid: Solid, defect: str) -> float:
    """Measure the share of new surface; refuse a repair that changes the model too much."""
    mesh_after: Any = trimesh.Trimesh(*solid.arrays(), process=False)
    probes = _draw_probes(mesh_before, PROBE_COUNT)
    far_probes = probes[_is_far(mesh_before, mesh_after)]
    lost_share = 0.0
    if len(far_probes):
        lost_share = float((~_is_inside(far_probes, np.asarray(mesh_after.triangles))).sum()) / len(probes)
    new_share = float(_is_far(mesh_after, mesh_before).mean())
    if new_share > MAX_NEW_SHARE:
        raise ModelNotSolid(
            f"{name}: {defect}, and repairing it would add {100 * new_share:.0f} % of new surface (limit "
            f"{100 * MAX_NEW_SHARE:.0f} %): half a model or loose triangles; repair it by hand"
        )
    size_change_share = float(
        np.abs(mesh_after.bounds - mesh_before.bounds).max() / np.ptp(mesh_before.bounds, axis=0).max()
    )
    if lost_share > MAX_LOST_SHARE or size_change_share > MAX_EXTENT_CHANGE_SHARE:
        raise ModelNotSolid(
            f"{name}: {defect}, and repairing it would lose {100 * lost_share:.0f} % of its surface and "
            f"change its size by {100 * size_change_share:.0f} %; repair it by hand"
        )
    return new_share


def _draw_probes(mesh: Any, count: int) -> Floats:
    """Draw random points (count, 3) on a mesh."""
    return np.asarray(trimesh.sample.sample_surface(mesh, count, seed=0)[0])


def _is_far(mesh: Any, other: Any) -> Bools:
    """Check for each of PROBE_COUNT random points on a mesh whether it is too far from another mesh."""
    geometry: Any = trimesh.triangles  # untyped
    limit_mm = float(MAX_MOVE_SHARE * np.ptp(mesh.bounds, axis=0).max())
    dense_count = SAMPLES_WITHIN_LIMIT * other.area / (math.pi * limit_mm**2)
    count = round(min(MAX_SAMPLE_COUNT, max(MIN_SAMPLE_COUNT, dense_count)))
    samples, triangle = trimesh.sample.sample_surface(other, count, seed=0)
    probes = _draw_probes(mesh, PROBE_COUNT)
    _, nearest_samples = cKDTree(samples).query(probes, NEIGHBOUR_COUNT)
    distances_mm = np.full(len(probes), np.inf)
    for k in range(NEIGHBOUR_COUNT):
        corners = np.asarray(other.triangles)[triangle[nearest_samples[:, k]]]
        nearest_point = geometry.closest_point(corners, probes)
        distances_mm = np.minimum(distances_mm, np.linalg.norm(nearest_point - probes, axis=1))
    return np.asarray(distances_mm > limit_mm)


def _is_inside(points: Floats, triangles: Floats) -> Bools:
    """Check for each point (n, 3) whether it lies inside a closed surface (m, 3, 3).

    A ray from a point inside meets the surface an odd number of times. The ray is tilted by an irregular
    angle, to avoid the edges of boxes.
    """
    tilt = np.array([0.0123456789, 0.0345678912])
    points = np.column_stack([points[:, :2] - points[:, 2:] * tilt, points[:, 2]])
    triangles = np.concatenate([triangles[..., :2] - triangles[..., 2:] * tilt, triangles[..., 2:]], axis=2)
    return np.asarray(_count_triangles_above(points, triangles) % 2 == 1)


def _measure_body(body: Any) -> tuple[float, float]:
    """Measure the volume in mm3 and the area in mm2 of a body."""
    return measure_surface(np.ascontiguousarray(body.vertices), np.ascontiguousarray(body.faces))


@jit
def measure_surface(vertices: Floats, faces: Ints) -> tuple[float, float]:
    """Measure the volume in mm3 and the area in mm2 of a closed surface.

    Parameters
    ----------
    vertices, faces
        (n, 3) float64 in mm, and (m, 3) int64.

    Returns
    -------
    tuple
        Volume, which is below 0 if triangles face inwards, and area.
    """
    cx, cy, cz = 0.0, 0.0, 0.0  # mean of the vertices; tetrahedra with this corner have small volumes
    for i in range(len(vertices)):
        cx += vertices[i, 0] / len(vertices)
        cy += vertices[i, 1] / len(vertices)
        cz += vertices[i, 2] / len(vertices)
    volume_mm3, area_mm2 = 0.0, 0.0
    for t in range(len(faces)):
        a, b, c = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        volume_mm3 += (nx * (a[0] - cx) + ny * (a[1] - cy) + nz * (a[2] - cz)) / 6.0
        area_mm2 += np.sqrt(nx * nx + ny * ny + nz * nz) / 2.0
    return volume_mm3, area_mm2


@jit
def _count_triangles_above(points: Floats, triangles: Floats) -> Ints:
    """Count the triangles vertically above each point.

    Parameters
    ----------
    points
        (n, 3) float64 in mm.
    triangles
        (m, 3, 3) float64 in mm.

    Returns
    -------
    ndarray
        (n,) int64 counts.
    """
    counts = np.zeros(len(points), np.int64)
    for i in range(len(points)):
        x, y, z = points[i]
        for t in range(len(triangles)):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            double_area_mm2 = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            if double_area_mm2 == 0.0:
                continue
            u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / double_area_mm2
            v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / double_area_mm2
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and u * a[2] + v * b[2] + (1.0 - u - v) * c[2] > z:
                counts[i] += 1
    return counts


def _join_bodies(name: str, bodies: list[Any], repairs: list[str]) -> Solid:
    """Join bodies into one solid, the large ones first: subtract cavities, add bodies inside cavities.

    Sentences on this are appended to `repairs`.
    """
    volumes_mm3 = np.array([_measure_body(body)[0] for body in bodies])
    if volumes_mm3.sum() < 0.0:
        for body in bodies:
            body.invert()
        volumes_mm3 = -volumes_mm3
        repairs.append("Turned the model inside out: its triangles faced inwards.")
    order = np.argsort(-np.abs(volumes_mm3), kind="stable")
    bodies, volumes_mm3 = [bodies[i] for i in order], volumes_mm3[order]
    inverted_count = 0
    lo_mm, hi_mm = (np.array([b.bounds[end] for b in bodies]) for end in (0, 1))
    cavity_flags = []
    for i, body in enumerate(bodies):
        is_surrounded = ((lo_mm[:i] <= lo_mm[i]) & (hi_mm[:i] >= hi_mm[i])).all(axis=1).any()
        if volumes_mm3[i] < 0.0:
            body.invert()
            inverted_count += not is_surrounded  # otherwise it is a cavity
        cavity_flags.append(bool(volumes_mm3[i] < 0.0 and is_surrounded))
    if inverted_count:
        repairs.append(
            f"Turned {inverted_count} of {len(bodies)} bodies inside out: their triangles faced inwards."
        )
    solids = [Solid.from_arrays(b.vertices, b.faces) for b in bodies]
    solid = solids[0]
    if any(cavity_flags):
        for other, is_cavity in zip(solids[1:], cavity_flags[1:], strict=True):
            solid = solid.subtract(other) if is_cavity else Solid.union([solid, other])
    elif len(solids) > 1:
        solid = Solid.union(solids)
    if solid.is_empty or solid.volume_mm3 <= 0.0:
        raise ModelNotSolid(f"{name}: its triangles enclose no volume; export a solid")
    if len(solids) > 1:
        repairs.append(f"Joined {len(solids)} bodies into one solid of {solid.volume_mm3 / 1000.0:.1f} cm3.")
    return solid
