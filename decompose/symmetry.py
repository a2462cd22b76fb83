"""The symmetry cut: the best plane of symmetry by the search of SBD, and whether it is good enough.

Hatton et al. 2023: planes through the mean of the vertices, normals drawn from the sphere; the score is the
mean distance from the vertices' mirror images to the nearest vertex. Two things differ from their program,
where they have no effect by mistake: the best normals are refined, and a plane counts only within a
tolerance, which is a share of the model's size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

Floats = npt.NDArray[np.float64]

SAMPLES = 100  # normals a round
CONES_RAD = (0.3, 0.1, 0.03, 0.01)  # of the rounds after the first, about the best so far
MOST_MIRRORED = 1000  # vertices whose mirror images are looked up
TOLERANCE = 0.01  # of the diagonal of the model's box
SAME_AXIS_RAD = 0.01  # nearer to an axis than this, a normal is the axis where that is as good


@dataclass(frozen=True, slots=True)
class Mirror:
    """A plane of symmetry: ``normal @ x == offset_mm``; `error_mm` is the mean distance of mirror images."""

    normal: Floats
    offset_mm: float
    error_mm: float


def find_mirror(vertices: Floats, rng: np.random.Generator, tolerance: float = TOLERANCE) -> Mirror | None:
    """The best plane of symmetry of vertices (n, 3) in mm, None where it is not good enough."""
    centre = vertices.mean(axis=0)
    tree = KDTree(vertices)
    if len(vertices) > MOST_MIRRORED:
        mirrored = vertices[rng.choice(len(vertices), MOST_MIRRORED, replace=False)] - centre
    else:
        mirrored = vertices - centre

    def error(normal: Floats) -> float:
        images = mirrored - 2.0 * np.outer(mirrored @ normal, normal) + centre
        return float(tree.query(images)[0].mean())

    axes = np.eye(3)
    _, principal = np.linalg.eigh(np.cov(mirrored.T))
    normals = np.vstack([axes, principal.T, _unit(rng.standard_normal((SAMPLES, 3)))])
    errors = [error(normal) for normal in normals]
    best = int(np.argmin(np.round(errors, 9)))
    normal, least = normals[best], errors[best]
    for cone in CONES_RAD:
        near = _unit(normal + cone * rng.standard_normal((SAMPLES, 3)))
        errors = [error(each) for each in near]
        if min(errors) < least:
            normal, least = near[int(np.argmin(errors))], min(errors)
    axis = axes[int(np.abs(normal).argmax())]
    if abs(normal @ axis) > np.cos(SAME_AXIS_RAD) and error(axis) <= 1.05 * least + 1e-6:
        normal, least = axis, error(axis)
    if least > tolerance * float(np.linalg.norm(np.ptp(vertices, axis=0))):
        return None
    return Mirror(normal, float(normal @ centre), least)


def rotation_to_axis(normal: Floats) -> tuple[Floats, int]:
    """The least rotation (3, 3), ``v_new = rotation @ v``, that lays a normal on an axis, and which."""
    axis = int(np.abs(normal).argmax())
    target = np.eye(3)[axis] * np.sign(normal[axis])
    cross, cosine = np.cross(normal, target), float(normal @ target)
    skew = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    rotation: Floats = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
    return rotation, axis


def _unit(vectors: Floats) -> Floats:
    unit: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit
