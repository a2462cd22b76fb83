"""Oriented shells of triangles: separated where more than two faces meet, and with caps on their holes.

A shell is a connected surface. Here, a rim is the closed line of edges around a hole of a shell.

No function of this module moves a vertex or drops a triangle.
"""

from __future__ import annotations

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from decompose.arrays import Bools, Floats, Ints
from decompose.geometry.solid import triangulate

MAX_ANGLE_DIFFERENCE_RAD = 1e-9  # maximum difference between angles that count as equal
MAX_UNEVENNESS_SHARE = 1e-2  # maximum distance of a flat rim from its plane, as a share of its size
# Maximum distance of an inner rim from the plane of the outer rim around it, as a share of the model's size,
# if both are rims of the same hole.
MAX_PLANE_GAP_SHARE = 1e-6


def orient_faces(faces: Ints) -> Ints | None:
    """Orient faces consistently, so that the two faces of each edge have the outside on the same side.

    Each connected surface has two consistent orientations; the one that reverses fewer faces is chosen.

    Parameters
    ----------
    faces
        (m, 3) int64.

    Returns
    -------
    ndarray or None
        (m, 3) int64; None for a one-sided surface.
    """
    tail, head, face = _list_half_edges(faces)
    order, starts, counts = _sort_half_edges_by_edge(tail, head)
    first = starts[counts == 2]
    a, b = order[first], order[first + 1]
    is_opposed = tail[a] == tail[b]
    m = len(faces)
    f, g = face[a], face[b]
    rows = np.concatenate([f, f + m])
    columns = np.concatenate([np.where(is_opposed, g + m, g), np.where(is_opposed, g, g + m)])
    label = label_components(2 * m, rows, columns)  # node f is face f, and node f + m is its reverse
    if (label[:m] == label[m:]).any():
        return None
    keep_count = np.bincount(label[:m], minlength=label.max() + 1)
    is_flipped = keep_count[label[:m]] < keep_count[label[m:]]
    is_tie = (keep_count[label[:m]] == keep_count[label[m:]]) & (label[:m] > label[m:])
    reversed_faces = faces.copy()
    reversed_faces[is_flipped | is_tie] = reversed_faces[is_flipped | is_tie][:, ::-1]
    return reversed_faces


def split_shells(vertices: Floats, faces: Ints) -> list[tuple[Floats, Ints]] | None:
    """Split triangles into surfaces in which each edge has one or two faces and no rim meets itself.

    Where more than two triangles meet at an edge, they stay joined in pairs, one on each side of a solid, so
    bodies that touch are separated. If bodies overlap at such an edge, or one is inside out, there are two
    ways to choose the pairs, and the one that separates more surfaces is used.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) int64.

    Returns
    -------
    list or None
        Vertices (n, 3) and faces (m, 3) of each surface; None if, around some edge, the number of faces at
        which the solid begins is not the number of faces at which it ends.
    """
    tail, head, face = _list_half_edges(faces)
    order, starts, counts = _sort_half_edges_by_edge(tail, head)
    first = starts[counts == 2]
    a, b = order[first], order[first + 1]
    if (tail[a] == tail[b]).any():
        return None
    sorted_edges = []
    for start, count in zip(starts[counts > 2], counts[counts > 2], strict=True):
        edge_order = order[start : start + count]
        sorted_edge = _sort_half_edges_by_angle(vertices, faces, tail, head, face, edge_order)
        if sorted_edge is None:
            return None
        sorted_edges.append(sorted_edge)
    splits = []
    for pair_half_edges in (_pair_half_edges_fifo, _pair_half_edges_lifo):
        pairs = np.concatenate(
            [np.stack([a, b], axis=1), *(pair_half_edges(sorted_edge) for sorted_edge in sorted_edges)]
        )
        splits.append(_split_surfaces(vertices, faces, pairs))
    return max(splits, key=len)


def _split_surfaces(vertices: Floats, faces: Ints, pairs: Ints) -> list[tuple[Floats, Ints]]:
    """Split triangles into the surfaces that are connected by pairs (k, 2) of half-edges."""
    tail, _, face = _list_half_edges(faces)
    a, b = pairs.T
    # Corner 3 f + k is vertex k of face f; a half-edge goes from its own corner to the next one of its face.
    next_corners = np.arange(len(tail)) // 3 * 3 + (np.arange(len(tail)) % 3 + 1) % 3
    corner = label_components(
        len(tail), np.concatenate([a, next_corners[a]]), np.concatenate([next_corners[b], b])
    )
    positions = np.zeros((corner.max() + 1, 3))
    positions[corner] = vertices[tail]
    label = label_components(len(faces), face[a], face[b])
    face_corners = corner.reshape(-1, 3)
    shells = []
    for number in range(label.max() + 1):
        used_vertices, index = np.unique(face_corners[label == number], return_inverse=True)
        shells.append((positions[used_vertices], index.reshape(-1, 3).astype(np.int64)))
    return shells


def find_rims(faces: Ints) -> list[Ints]:
    """Find the rims of the holes of a shell.

    Parameters
    ----------
    faces
        (m, 3) int64 of shells from `split_shells`.

    Returns
    -------
    list of ndarray
        (k,) int64 vertices of each rim, in the order in which a face that fills the hole has them.
    """
    tail, head, _ = _list_half_edges(faces)
    order, starts, counts = _sort_half_edges_by_edge(tail, head)
    single_starts = order[starts[counts == 1]]
    next_vertices = dict(zip(head[single_starts].tolist(), tail[single_starts].tolist(), strict=True))
    rims = []
    while next_vertices:
        start, vertex = next_vertices.popitem()
        loop = [start]
        while vertex != start:
            loop.append(vertex)
            vertex = next_vertices.pop(vertex)
        rims.append(np.array(loop, dtype=np.int64))
    return sorted(rims, key=lambda loop: int(loop.min()))


def is_flat(rim: Floats) -> bool:
    """Check whether a rim (k, 3) is flat within a small share of its size."""
    centred_rim = rim - rim.mean(axis=0)
    normal = np.linalg.svd(centred_rim, full_matrices=False)[2][-1]
    return float(np.abs(centred_rim @ normal).max()) <= MAX_UNEVENNESS_SHARE * float(
        np.ptp(rim, axis=0).max()
    )


def cap_holes(vertices: Floats, faces: Ints) -> Ints:
    """Build faces that close all holes of shells, without a new vertex.

    A hole is filled in its plane. If two rims lie in one plane, one inside the other, and have opposite
    orientations, they are the end of a pipe, and the ring between them is filled.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) int64 of shells from `split_shells`.

    Returns
    -------
    ndarray
        (k, 3) int64 new faces.
    """
    loops = find_rims(faces)
    size_mm = float(np.ptp(vertices, axis=0).max())
    area_vectors_mm2 = [_compute_area_vector_mm2(vertices[loop]) for loop in loops]
    order = sorted(range(len(loops)), key=lambda i: -float(np.linalg.norm(area_vectors_mm2[i])))
    outers: list[tuple[list[int], shapely.Polygon, Floats]] = []
    for i in order:
        has_outer = False
        if np.linalg.norm(area_vectors_mm2[i]) > 1e-9 * size_mm * size_mm:
            for members, polygon, frame in reversed(outers):  # the smallest hole first
                has_outer = _is_hole_of(vertices[loops[i]], area_vectors_mm2[i], polygon, frame, size_mm)
                if has_outer:
                    members.append(i)
                    break
        if not has_outer:
            frame = _find_frame(vertices[loops[i]], area_vectors_mm2[i])
            flat_rim = (vertices[loops[i]] - frame[3]) @ frame[:2].T
            outers.append(([i], shapely.Polygon(flat_rim), frame))
    caps = []
    for members, _, frame in outers:
        polygons = [(vertices[loops[i]] - frame[3]) @ frame[:2].T for i in members]
        index = np.concatenate([loops[i] for i in members])
        caps.append(index[triangulate(polygons)])
    return np.concatenate(caps) if caps else np.zeros((0, 3), dtype=np.int64)


def _is_hole_of(
    rim: Floats, area_vector_mm2: Floats, polygon: shapely.Polygon, frame: Floats, size_mm: float
) -> bool:
    """Check whether a rim (k, 3) with an area vector (3,) bounds a hole in a polygon in a frame (4, 3)."""
    if area_vector_mm2 @ frame[2] > -0.99 * np.linalg.norm(area_vector_mm2):
        return False
    if np.abs((rim - frame[3]) @ frame[2]).max() > MAX_PLANE_GAP_SHARE * size_mm:
        return False
    hole = shapely.Polygon((rim - frame[3]) @ frame[:2].T)
    return bool(polygon.is_valid and hole.is_valid and polygon.contains(hole))


def _compute_area_vector_mm2(loop: Floats) -> Floats:
    """Compute the area vector (3,) of a closed loop (k, 3) by Newell's method."""
    centred_loop = loop - loop.mean(axis=0)
    return np.asarray(np.cross(centred_loop, np.roll(centred_loop, -1, axis=0)).sum(axis=0) / 2.0)


def _find_frame(loop: Floats, area_vector_mm2: Floats) -> Floats:
    """Find a frame (4, 3): two directions in the plane of a loop, its normal, and its centre."""
    centre = loop.mean(axis=0)
    area_mm2 = float(np.linalg.norm(area_vector_mm2))
    is_line = area_mm2 == 0.0
    up = np.linalg.svd(loop - centre)[2][-1] if is_line else area_vector_mm2 / area_mm2
    side = np.cross(np.eye(3)[int(np.abs(up).argmin())], up)
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(up, side), up, centre])


def _list_half_edges(faces: Ints) -> tuple[Ints, Ints, Ints]:
    """List tail, head and face (3 m,) of each half-edge; number 3 f + k begins at corner k of face f."""
    return faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1), np.arange(3 * len(faces)) // 3


def _sort_half_edges_by_edge(tail: Ints, head: Ints) -> tuple[Ints, Ints, Ints]:
    """Sort half-edges by edge; return the order, and each edge's first index and number of half-edges."""
    lo, hi = np.minimum(tail, head), np.maximum(tail, head)
    order = np.lexsort((hi, lo))
    starts = np.flatnonzero(np.concatenate([[True], (np.diff(lo[order]) != 0) | (np.diff(hi[order]) != 0)]))
    return order, starts, np.diff(np.concatenate([starts, [len(tail)]]))


def label_components(count: int, rows: Ints, columns: Ints) -> Ints:
    """Number the connected components of a graph.

    Parameters
    ----------
    count
        Number of nodes.
    rows, columns
        (m,) nodes at the ends of each edge.

    Returns
    -------
    ndarray
        (count,) int64 number of the component of each node; components are numbered from 0.
    """
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _sort_half_edges_by_angle(
    vertices: Floats, faces: Ints, tail: Ints, head: Ints, face: Ints, half_edges: Ints
) -> tuple[Ints, Bools] | None:
    """Sort the half-edges (k,) of an edge by angle, and find those at which the solid begins.

    The order starts outside the solid, or where the fewest solids overlap. The result is None if the number
    of faces at which the solid begins is not the number of faces at which it ends.
    """
    start, end = min(tail[half_edges[0]], head[half_edges[0]]), max(tail[half_edges[0]], head[half_edges[0]])
    along = vertices[end] - vertices[start]
    along = along / np.linalg.norm(along)
    third_corners = vertices[faces[face[half_edges]].sum(axis=1) - start - end] - vertices[start]
    across = np.cross(np.eye(3)[int(np.abs(along).argmin())], along)
    across /= np.linalg.norm(across)
    angle_rad = np.arctan2(third_corners @ np.cross(along, across), third_corners @ across)
    angle_rad = np.round(angle_rad / MAX_ANGLE_DIFFERENCE_RAD) * MAX_ANGLE_DIFFERENCE_RAD
    angle_rad = np.where(angle_rad <= -np.pi + MAX_ANGLE_DIFFERENCE_RAD, np.pi, angle_rad)
    # The normal of a face whose half-edge runs from `start` to `end` points to greater angles, so the solid
    # of the face is at smaller angles.
    begins = tail[half_edges] != start
    order = np.lexsort((begins, angle_rad))
    depth = np.cumsum(np.where(begins[order], 1, -1))  # number of solids at each angle around the edge
    if depth[-1] != 0:
        return None
    order = np.roll(order, -1 - int(depth.argmin()))
    return half_edges[order], begins[order]


def _pair_half_edges_fifo(sorted_edge: tuple[Ints, Bools]) -> Ints:
    """Pair the half-edges (k, 2) of an edge so that the solid that begins first ends first.

    If two bodies overlap, each of them gets its own faces.
    """
    half_edges, begins = sorted_edge
    return np.stack([half_edges[begins], half_edges[~begins]], axis=1)


def _pair_half_edges_lifo(sorted_edge: tuple[Ints, Bools]) -> Ints:
    """Pair the half-edges (k, 2) of an edge so that the solid that begins last ends first.

    If one of two bodies is inside out, each of them gets its own faces.
    """
    pairs: list[tuple[int, int]] = []
    open_half_edges: list[int] = []
    for half_edge, begin in zip(*sorted_edge, strict=True):
        if begin:
            open_half_edges.append(half_edge)
        else:
            pairs.append((open_half_edges.pop(), half_edge))
    return np.array(pairs, dtype=np.int64)
