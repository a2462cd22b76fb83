"""Solids and printers shared by the tests of decompose."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from decompose.geometry import Model, Solid
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter

PLUS_BOXES = ((206.9, 190.9, 205.0), (173.9, 197.9, 205.0), (164.9, 206.9, 205.0))
EXTENDED_BOXES = tuple((x, y, 305.0) for x, y, _ in PLUS_BOXES)


@pytest.fixture(scope="session")
def cost() -> CostModel:
    return CostModel.from_settings(PrintTimeSettings())


@pytest.fixture
def fleet() -> list[TargetPrinter]:
    return [TargetPrinter(f"plus-{i}", PLUS_BOXES) for i in range(5)] + [
        TargetPrinter(f"extended-{i}", EXTENDED_BOXES) for i in range(3)
    ]


@pytest.fixture(scope="session")
def ring_with_bar() -> Solid:
    """Make a solid of 120 mm with curved and flat faces and a hole, rotated off the axes."""
    ring = trimesh.creation.torus(40.0, 20.0, major_sections=40, minor_sections=20)
    ring.apply_transform(trimesh.transformations.rotation_matrix(0.6, [1.0, 0.5, 0.2]))
    return Solid.union(
        [Solid.from_arrays(ring.vertices, ring.faces), Solid.box((-30.0, -5.0, -25.0), (75.0, 10.0, 40.0))]
    )


@pytest.fixture(scope="session")
def ball() -> Model:
    """Make a ball of 300 mm: larger than any printer, thick enough to be hollow."""
    sphere = trimesh.creation.icosphere(3, 150.0)
    return Model(Solid.from_arrays(sphere.vertices, sphere.faces), (), 1.0)


@pytest.fixture(scope="session")
def triangles(ring_with_bar: Solid) -> np.ndarray:
    vertices, faces = ring_with_bar.arrays()
    return vertices[faces]
