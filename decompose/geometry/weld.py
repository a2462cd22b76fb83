"""Conversion of separate triangles to a surface whose triangles share vertices.

Models have millions of triangles, so each array takes a lot of memory. Therefore equal corners are found with
a hash table, and each edge is encoded as one whole number before edges are sorted and compared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from decompose.arrays import Floats, Ints
from decompose.geometry.shells import label_components
from decompose.jit import jit

SAME_VERTEX_MM = 1e-8  # vertices whose coordinates round to the same multiples of this are the same vertex
WELD_SHARES = (1e-7, 1e-6, 1e-5)  # distances for joining corners, tried in turn; shares of the longest side


@dataclass(frozen=True, slots=True)
class Surface:
    """Vertices (n, 3) in mm, faces (m, 3), and sentences on the changes that joined the triangles."""

    vertices: Floats
    faces: Ints
    repairs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class EdgeUses:
    """Numbers of edges by the number of faces that use them.

    Attributes
    ----------
    single_count
        Number of edges that only one face uses: the surface is open there.
    nonmanifold_count
        Number of edges that more than two faces use.
    repeated_count
        Number of directed edges that two faces use: these faces are oriented inconsistently.
    """

    single_count: int
    nonmanifold_count: int
    repeated_count: int

    @property
    def is_closed(self) -> bool:
        """True if each edge has two faces."""
        return self.single_count == self.nonmanifold_count == 0


def weld_triangles(triangles: Floats) -> Surface:
    """Join the equal corners of triangles (m, 3, 3) in mm, and drop collapsed and repeated triangles.

    If edges stay open, corners that are close to each other are joined too, provided that this closes most of
    these edges.
    """
    corners = triangles.reshape(-1, 3)
    index, first = number_rows(corners, 1.0 / SAME_VERTEX_MM)
    vertices, triangle_vertices = corners[first], index.reshape(-1, 3)
    faces = select_distinct_faces(triangle_vertices)
    repairs = []
    if len(faces) < len(triangles):
        dropped_count = len(triangles) - len(faces)
        repairs.append(f"Dropped {dropped_count} triangles that had collapsed or were given twice.")
    open_edge_count = count_edge_uses(faces).single_count
    if open_edge_count:
        tree = cKDTree(vertices)
        size_mm = float(np.ptp(vertices, axis=0).max())
        for share in WELD_SHARES:
            pairs = tree.query_pairs(share * size_mm, output_type="ndarray")
            group = label_components(len(vertices), pairs[:, 0], pairs[:, 1])
            first_of_group = np.unique(group, return_index=True)[1][group]
            welded_faces = select_distinct_faces(first_of_group[triangle_vertices])
            if count_edge_uses(welded_faces).single_count < open_edge_count / 2:
                faces = welded_faces
                repairs.append(f"Joined vertices within {share * size_mm:.1g} mm of each other.")
                break
    return Surface(vertices, faces, tuple(repairs))


def is_watertight(triangles: Floats) -> bool:
    """Check whether each edge of triangles (m, 3, 3) in mm, with equal corners joined, has two of them."""
    numbers, _ = number_rows(np.ascontiguousarray(triangles.reshape(-1, 3)), 1.0 / SAME_VERTEX_MM)
    return len(triangles) > 0 and count_edge_uses(numbers.reshape(-1, 3)).is_closed


def select_distinct_faces(faces: Ints) -> Ints:
    """Select the faces (m, 3) with three different corners, each once; a reversed face counts as distinct."""
    f = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    distinct_faces: Ints = f[number_rows(_rotate_corners(f), 1.0)[1]]
    return distinct_faces


@jit
def _rotate_corners(faces: Ints) -> Ints:
    """Rotate the corners of faces (m, 3) int64, so that the vertex with the lowest number is the first."""
    rotated_faces = np.empty_like(faces)
    for i in range(len(faces)):
        first = 0
        for k in range(1, 3):
            if faces[i, k] < faces[i, first]:
                first = k
        for k in range(3):
            rotated_faces[i, k] = faces[i, (first + k) % 3]
    return rotated_faces


def count_edge_uses(faces: Ints) -> EdgeUses:
    """Count the edges of faces (m, 3) by the number of faces that use them."""
    if not len(faces):
        return EdgeUses(0, 0, 0)
    directed_edges = _encode_edges(np.ascontiguousarray(faces, np.int64))
    directed_edges.sort()
    repeated_count = int((directed_edges[1:] == directed_edges[:-1]).sum())
    edges = directed_edges >> 1
    is_same = np.concatenate([[False], edges[1:] == edges[:-1], [False]])
    return EdgeUses(
        single_count=int((~is_same[:-1] & ~is_same[1:]).sum()),
        nonmanifold_count=int((~is_same[:-2] & is_same[1:-1] & is_same[2:]).sum()),
        repeated_count=repeated_count,
    )


@jit
def _encode_edges(faces: Ints) -> Ints:
    """Encode each edge as one number, made of its two vertices, and of its direction as the last bit.

    Parameters
    ----------
    faces
        (m, 3) int64.

    Returns
    -------
    ndarray
        (3 m,) int64.
    """
    count = faces.max() + 1
    edges = np.empty(3 * len(faces), np.int64)
    for i in range(len(faces)):
        for k in range(3):
            tail, head = faces[i, k], faces[i, (k + 1) % 3]
            edges[3 * i + k] = 2 * (min(tail, head) * count + max(tail, head)) + (tail > head)
    return edges


@jit
def number_rows(rows: npt.NDArray[np.generic], scale: float) -> tuple[Ints, Ints]:
    """Number rows in the order in which they occur first; equal rows have the same number.

    Parameters
    ----------
    rows
        (n, 3) float64 or int64.
    scale
        Factor by which rows are multiplied before rounding; rows are equal if the rounded numbers are equal.

    Returns
    -------
    tuple
        (n,) int64 number of each row, and (k,) int64 index of the first row with each number.
    """
    n = len(rows)
    numbers, first_rows = np.empty(n, np.int64), np.empty(n, np.int64)
    table = np.full(1024, -1, np.int32)
    count = 0
    for i in range(n):
        if 2 * count >= len(table):
            table = np.full(4 * len(table), -1, np.int32)
            for number in range(count):
                table[_find_slot(rows, scale, first_rows, table, first_rows[number])] = number
        slot = _find_slot(rows, scale, first_rows, table, i)
        if table[slot] < 0:
            table[slot] = count
            first_rows[count] = i
            count += 1
        numbers[i] = table[slot]
    return numbers, first_rows[:count].copy()


@jit
def _find_slot(
    rows: npt.NDArray[np.generic], scale: float, first_rows: Ints, table: npt.NDArray[np.int32], i: int
) -> int:
    """Find the slot of a row in a hash table, or the empty slot for it.

    Parameters
    ----------
    rows, scale
        As in `number_rows`.
    first_rows
        (n,) int64 index of the first row with each number.
    table
        (slots,) int32 numbers of rows, -1 for an empty slot; the number of slots is a power of two.
    i
        Index of the row.
    """
    x, y, z = np.rint(rows[i, 0] * scale), np.rint(rows[i, 1] * scale), np.rint(rows[i, 2] * scale)
    key = (
        np.int64(x) * 0x1E3779B97F4A7C15 + np.int64(y) * 0x3F58476D1CE4E5B9 + np.int64(z) * 0x14D049BB133111EB
    )
    key = (key ^ (key >> 31)) * 0x2545F4914F6CDD1D
    slot = int((key ^ (key >> 29)) & (len(table) - 1))
    while table[slot] >= 0:
        k = first_rows[table[slot]]
        if (
            np.rint(rows[k, 0] * scale) == x
            and np.rint(rows[k, 1] * scale) == y
            and np.rint(rows[k, 2] * scale) == z
        ):
            break
        slot = (slot + 1) & (len(table) - 1)
    return slot
