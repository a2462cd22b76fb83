"""Horizontal sections of a closed triangle mesh: their area, length and moments at many heights at once.

A plane cuts each triangle along a directed segment with the solid on its left. Green's theorem then gives the
area of a section from its segments alone, without joining them into loops first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
_CHUNK_SEGMENTS = 400_000
"""Number of segments that are cut at a time, which takes about 100 MB of memory."""


@dataclass(frozen=True, slots=True)
class Rings:
    """Sums over the closed rings at each of k heights; the solid is on the left of each one.

    Attributes
    ----------
    area_mm2
        (k,) Enclosed area, without holes.
    length_mm
        (k,) Length of all rings.
    moment_mm3
        (k, 2) Area times centroid.
    """

    area_mm2: Floats
    length_mm: Floats
    moment_mm3: Floats


def measure_rings(segments: Iterator[tuple[npt.NDArray[np.intp], Floats, Floats]], count: int) -> Rings:
    """Sum directed segments into the area, length and moment of the rings at each height.

    Parameters
    ----------
    segments
        Chunks as `cut_sections` yields them: (m,) index of the height, (m, 2) start and (m, 2) end in mm.
    count
        Number of heights, k.
    """
    area_mm2, length_mm, moment_mm3 = np.zeros(count), np.zeros(count), np.zeros((count, 2))
    for index, start, end in segments:
        cross_mm2 = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
        area_mm2 += np.bincount(index, cross_mm2, count) / 2
        length_mm += np.bincount(index, np.hypot(*(end - start).T), count)
        for axis in range(2):
            moment_mm3[:, axis] += np.bincount(index, (start + end)[:, axis] * cross_mm2, count) / 6
    return Rings(area_mm2, length_mm, moment_mm3)


def cut_sections(corners: Floats, z_mm: Floats) -> Iterator[tuple[npt.NDArray[np.intp], Floats, Floats]]:
    """Cut a mesh by horizontal planes.

    Parameters
    ----------
    corners
        (n, 3 corners, xyz) in mm, counter-clockwise seen from outside.
    z_mm
        (k,) Heights in ascending order.

    Yields
    ------
    tuple
        Chunks of (m,) indices into `z_mm`, and (m, 2) start and end of each segment in mm. Triangles with a
        common edge give bit-equal points on it, so a closed mesh gives closed rings.
    """
    heights_mm = corners[..., 2]
    first_plane = np.searchsorted(z_mm, heights_mm.min(axis=1), "left")
    count = np.searchsorted(z_mm, heights_mm.max(axis=1), "left") - first_plane
    crossed_triangles = np.flatnonzero(count)
    ends = np.cumsum(count[crossed_triangles])
    first_row = 0
    while first_row < len(crossed_triangles):
        rows_before = ends[first_row - 1] if first_row else 0
        end_row = max(first_row + 1, int(np.searchsorted(ends, rows_before + _CHUNK_SEGMENTS)))
        triangles = crossed_triangles[first_row:end_row]
        plane_counts = count[triangles]
        triangle = np.repeat(triangles, plane_counts)
        offset = np.arange(len(triangle)) - np.repeat(np.cumsum(plane_counts) - plane_counts, plane_counts)
        plane = first_plane[triangle] + offset
        yield plane, *_cut_triangles(corners[triangle], z_mm[plane])
        first_row = end_row


def _cut_triangles(corners: Floats, z_mm: Floats) -> tuple[Floats, Floats]:
    """Cut triangles (m, 3, 3), each at a plane that crosses it: start and end (m, 2) in mm."""
    is_above = corners[..., 2] > z_mm[:, None]
    is_lone_above = is_above.sum(axis=1) == 1
    lone_corner = np.where(is_lone_above, is_above.argmax(axis=1), is_above.argmin(axis=1))
    rows = np.arange(len(corners))
    tip, next_corner, previous_corner = (corners[rows, (lone_corner + step) % 3] for step in range(3))
    left, right = _find_crossings(tip, next_corner, z_mm), _find_crossings(tip, previous_corner, z_mm)
    is_upward = is_lone_above[:, None]
    return np.where(is_upward, left, right), np.where(is_upward, right, left)


def _find_crossings(a: Floats, b: Floats, z_mm: Floats) -> Floats:
    """Find the points (m, 2) at which edges cross their planes, bit-equal for either order of the ends."""
    is_swapped = (a[:, 2] > b[:, 2])[:, None]
    low, high = np.where(is_swapped, b, a), np.where(is_swapped, a, b)
    share = (z_mm - low[:, 2]) / (high[:, 2] - low[:, 2])
    crossing: Floats = low[:, :2] + share[:, None] * (high - low)[:, :2]
    return crossing
