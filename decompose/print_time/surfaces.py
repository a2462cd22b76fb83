"""Normals, areas and centres of the faces of a mesh, on which prices depend."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.jit import jit


class Surfaces(NamedTuple):
    """Faces of a mesh, float64.

    Attributes
    ----------
    normals
        (m, 3) unit normals; 0 for a face without area.
    areas_mm2
        (m,) areas.
    centres_mm
        (m, 3) centres.
    """

    normals: Floats
    areas_mm2: Floats
    centres_mm: Floats


@jit
def measure_surfaces(vertices: Floats, faces: Ints) -> Surfaces:
    """Measure the faces of a mesh.

    Parameters
    ----------
    vertices
        (n, 3) float64 in mm.
    faces
        (m, 3) int64, outward by the right-hand rule.
    """
    normals, centres_mm = np.zeros((len(faces), 3)), np.zeros((len(faces), 3))
    areas_mm2 = np.zeros(len(faces))
    for i in range(len(faces)):
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0],
            vertices[b, 1] - vertices[a, 1],
            vertices[b, 2] - vertices[a, 2],
        )
        vx, vy, vz = (
            vertices[c, 0] - vertices[a, 0],
            vertices[c, 1] - vertices[a, 1],
            vertices[c, 2] - vertices[a, 2],
        )
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        areas_mm2[i] = length / 2.0
        if length > 0.0:
            normals[i, 0], normals[i, 1], normals[i, 2] = nx / length, ny / length, nz / length
        for axis in range(3):
            centres_mm[i, axis] = (vertices[a, axis] + vertices[b, axis] + vertices[c, axis]) / 3.0
    return Surfaces(normals, areas_mm2, centres_mm)


@jit
def sum_volume_mm3(surfaces: Surfaces) -> float:
    """Sum the volume of a closed mesh by the divergence theorem."""
    volume_mm3 = 0.0
    for i in range(len(surfaces.areas_mm2)):
        height_mm = 0.0
        for axis in range(3):
            height_mm += surfaces.normals[i, axis] * surfaces.centres_mm[i, axis]
        volume_mm3 += surfaces.areas_mm2[i] * height_mm / 3.0
    return volume_mm3
