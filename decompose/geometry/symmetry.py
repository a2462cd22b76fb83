"""Planes of symmetry, as symmetry-based decomposition (SBD) finds them; Parallelobox cuts at the best one.

According to Hatton et al. (2023), planes pass through the mean of the vertices, and their normals are drawn
from the sphere. The score of a plane is the mean distance from the vertices' mirror images to the nearest
vertices. Two steps of the method have no effect in the authors' program, by mistake: the refinement of the
best normals, and the tolerance of the score. This module does both, except in `sample_mirrors`; the tolerance
is a share of the model's size. Only the second of the program's three draws of normals has an effect, so
there is one draw here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from decompose.arrays import Floats

SAMPLES_PER_ROUND = 100  # number of normals in a round
# Spread of the random normals around the best one, in the rounds after the first.
CONES_RAD = (0.3, 0.1, 0.03, 0.01)
MAX_MIRRORED_VERTICES = 1000  # maximum number of vertices whose mirror images are measured, for a whole model
MAX_MIRRORED_VERTICES_OF_PART = 300  # the same for a part
TOLERANCE = 0.01  # maximum mean distance of mirror images, as a share of the bounding box's diagonal
SAME_AXIS_RAD = 0.01  # a normal within this angle of an axis is replaced by it if it is nearly as good
MIN_ANGLE_RAD = 0.5  # minimum angle between the normals of two planes of one part


@dataclass(frozen=True, slots=True)
class Mirror:
    """A plane of symmetry, ``normal @ x == offset_mm``.

    Attributes
    ----------
    normal
        (3,) unit vector.
    offset_mm
        Offset along the normal.
    error_mm
        Mean distance from mirror images to the nearest vertices.
    """

    normal: Floats
    offset_mm: float
    error_mm: float


class _VertexCloud:
    """Vertices (n, 3) in mm, some of which are mirrored to measure the errors of planes."""

    def __init__(
        self, vertices: Floats, rng: np.random.Generator, max_count: int = MAX_MIRRORED_VERTICES
    ) -> None:
        self.centre = vertices.mean(axis=0)
        self.rng = rng
        self._tree = KDTree(vertices)
        if len(vertices) > max_count:
            vertices = vertices[rng.choice(len(vertices), max_count, replace=False)]
        self.centred_vertices = vertices - self.centre

    def measure_error_mm(self, normal: Floats) -> float:
        """Measure the mean distance of mirror images for a normal (3,)."""
        images = self.centred_vertices - 2.0 * np.outer(self.centred_vertices @ normal, normal) + self.centre
        return float(self._tree.query(images)[0].mean())

    def draw_normals(self) -> Floats:
        """Draw normals (SAMPLES_PER_ROUND, 3) uniformly from all directions."""
        return _normalise_rows(self.rng.standard_normal((SAMPLES_PER_ROUND, 3)))

    def refine_normal(
        self, normal: Floats, error_mm: float, sample_count: int = SAMPLES_PER_ROUND
    ) -> tuple[Floats, float]:
        """Find the best normal near a given normal, and its error in mm."""
        best_error_mm = error_mm
        for cone_rad in CONES_RAD:
            candidates = _normalise_rows(normal + cone_rad * self.rng.standard_normal((sample_count, 3)))
            errors_mm = [self.measure_error_mm(candidate) for candidate in candidates]
            if min(errors_mm) < best_error_mm:
                normal, best_error_mm = candidates[int(np.argmin(errors_mm))], min(errors_mm)
        axis = np.eye(3)[int(np.abs(normal).argmax())]
        if (
            abs(normal @ axis) > np.cos(SAME_AXIS_RAD)
            and self.measure_error_mm(axis) <= 1.05 * best_error_mm + 1e-6
        ):
            normal, best_error_mm = axis, self.measure_error_mm(axis)
        return normal, best_error_mm

    def list_main_directions(self) -> Floats:
        """List normals (6, 3) that are tried besides the drawn ones: the axes, then principal directions."""
        _, principal = np.linalg.eigh(np.cov(self.centred_vertices.T))
        return np.vstack([np.eye(3), principal.T])

    def make_mirror(self, normal: Floats, error_mm: float) -> Mirror:
        """Make the plane through the mean of the vertices that has a given normal."""
        return Mirror(normal, float(normal @ self.centre), error_mm)


def find_mirror(vertices: Floats, rng: np.random.Generator, tolerance: float = TOLERANCE) -> Mirror | None:
    """Find the best plane of symmetry of vertices; None if it is not good enough.

    Parameters
    ----------
    vertices
        (n, 3) in mm.
    rng
        Generator of the random normals.
    tolerance
        Maximum mean distance of mirror images, as a share of the diagonal of the vertices' bounding box.
    """
    cloud = _VertexCloud(vertices, rng)
    normals = np.vstack([cloud.list_main_directions(), cloud.draw_normals()])
    errors_mm = [cloud.measure_error_mm(normal) for normal in normals]
    best = int(np.argmin(np.round(errors_mm, 9)))
    normal, best_error_mm = cloud.refine_normal(normals[best], errors_mm[best])
    return (
        cloud.make_mirror(normal, best_error_mm)
        if best_error_mm <= tolerance * _measure_diagonal_mm(vertices)
        else None
    )


def sample_mirrors(vertices: Floats, rng: np.random.Generator, max_count: int) -> list[Mirror]:
    """Find the best planes of one draw of normals, without a tolerance, as the authors' program does.

    Parameters
    ----------
    vertices, rng
        As in `find_mirror`.
    max_count
        Maximum number of planes; their normals differ from each other.
    """
    cloud = _VertexCloud(vertices, rng, MAX_MIRRORED_VERTICES_OF_PART)
    ranked_normals = sorted((cloud.measure_error_mm(n), tuple(n)) for n in cloud.draw_normals())
    return [
        cloud.make_mirror(np.array(normal), error_mm)
        for error_mm, normal in _select_distinct_normals(ranked_normals, max_count)
    ]


def find_good_mirrors(
    vertices: Floats,
    rng: np.random.Generator,
    max_count: int,
    sample_count: int,
    tolerance: float = TOLERANCE,
) -> list[Mirror]:
    """Find refined planes of symmetry that are good enough, the best first.

    Parameters
    ----------
    vertices, rng, tolerance
        As in `find_mirror`.
    max_count
        Maximum number of planes; their normals differ from each other.
    sample_count
        Number of normals in a round.
    """
    cloud = _VertexCloud(vertices, rng, MAX_MIRRORED_VERTICES_OF_PART)
    normals = np.vstack([cloud.list_main_directions(), cloud.draw_normals()])
    ranked_normals = sorted((cloud.measure_error_mm(n), tuple(n)) for n in normals)
    mirrors = [
        cloud.refine_normal(np.array(n), error_mm, sample_count)
        for error_mm, n in _select_distinct_normals(ranked_normals, max_count)
    ]
    refined_normals = _select_distinct_normals(
        sorted((error_mm, tuple(normal)) for normal, error_mm in mirrors), max_count
    )
    max_error_mm = tolerance * _measure_diagonal_mm(vertices)
    return [
        cloud.make_mirror(np.array(normal), error_mm)
        for error_mm, normal in refined_normals
        if error_mm <= max_error_mm
    ]


ScoredNormal = tuple[float, tuple[float, ...]]  # the error in mm, and the normal


def _select_distinct_normals(ranked_normals: list[ScoredNormal], max_count: int) -> list[ScoredNormal]:
    """Select the first normals that differ from each other and from the opposites of the others."""
    distinct_normals: list[ScoredNormal] = []
    for error_mm, normal in ranked_normals:
        if len(distinct_normals) < max_count and all(
            abs(np.dot(normal, n)) < np.cos(MIN_ANGLE_RAD) for _, n in distinct_normals
        ):
            distinct_normals.append((error_mm, normal))
    return distinct_normals


def _measure_diagonal_mm(vertices: Floats) -> float:
    """Measure the diagonal of the bounding box of vertices (n, 3)."""
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def find_rotation_to_axis(normal: Floats) -> tuple[Floats, int]:
    """Find the smallest rotation that aligns a normal with an axis, and the axis.

    Parameters
    ----------
    normal
        (3,) unit vector.

    Returns
    -------
    tuple
        (3, 3) rotation, ``v_new = rotation @ v``, and the axis from 0 to 2 that is nearest to the normal.
    """
    axis = int(np.abs(normal).argmax())
    return find_smallest_rotation(normal, np.eye(3)[axis] * np.sign(normal[axis])), axis


def find_smallest_rotation(direction: Floats, target: Floats) -> Floats:
    """Find the smallest rotation from a direction to another one.

    Parameters
    ----------
    direction
        (3,) unit vector.
    target
        (3,) unit vector, not the opposite of the direction.

    Returns
    -------
    ndarray
        (3, 3) rotation, ``v_new = rotation @ v``.
    """
    cross, cosine = np.cross(direction, target), float(direction @ target)
    skew = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    rotation: Floats = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
    return rotation


def _normalise_rows(vectors: Floats) -> Floats:
    """Scale vectors (n, 3) to unit length."""
    unit: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit
