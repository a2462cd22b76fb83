"""Invariants of every result, tested on random models with each engine, without the project's own checks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.geometry import Model, Solid
from decompose.options import Engine, Interior, Options, ParalleloboxOptions
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.results import Decomposition

BOX_MM = (110.0, 100.0, 120.0)
PRINTERS = [TargetPrinter(str(i), (BOX_MM,)) for i in range(16)]
ENGINES = [engine for engine in Engine if engine is not Engine.BEST]
corners_mm = st.tuples(*[st.integers(-60, 40)] * 3)
sizes_mm = st.tuples(*[st.integers(15, 90)] * 3)
turns_rad = st.tuples(*[st.floats(-1.0, 1.0)] * 3)


def make_model(
    blocks: Sequence[tuple[tuple[int, ...], tuple[int, ...]]], turns_rad: tuple[float, ...]
) -> Model:
    """Make a ball with rotated blocks through it or beside it."""
    ball = trimesh.creation.icosphere(1, 55.0)
    solids = [Solid.from_arrays(ball.vertices, ball.faces)]
    solids += [Solid.box(lo, np.add(lo, size)) for lo, size in blocks]
    matrix = trimesh.transformations.euler_matrix(*turns_rad)[:3, :3]
    return Model(Solid.union(solids).rotate(matrix), (), 1.0)


def find_points_inside(points: np.ndarray, solid: Solid) -> np.ndarray:
    """Find the points inside a solid by their winding numbers (van Oosterom and Strackee 1983).

    The cutting kernel is not used, so that its errors are found.
    """
    vertices, faces = solid.arrays()
    a, b, c = (vertices[faces[:, i]] - points[:, None] for i in range(3))
    x, y, z = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dots = [np.einsum("nmk,nmk->nm", *pair) for pair in ((a, b), (b, c), (c, a))]
    angle_rad = np.arctan2(
        np.einsum("nmk,nmk->nm", a, np.cross(b, c)), x * y * z + dots[0] * z + dots[1] * x + dots[2] * y
    )
    return np.asarray(angle_rad.sum(axis=1) > np.pi)


def check_invariants(result: Decomposition, model: Model, seed: int) -> None:
    """Assert that parts fit, are closed, connected and disjoint, and that the surface is printed once."""
    for part in result.parts:
        vertices, faces = part.solid.arrays()
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        assert mesh.is_watertight and mesh.volume > 0.0
        assert sum(shell.volume > 0.0 for shell in mesh.split(only_watertight=True)) == 1
        assert (np.sort(np.ptp(part.build_printing_mesh()[0], axis=0)) <= np.sort(BOX_MM) + 1e-6).all()
    assert len({part.printer for part in result.parts}) == len(result.parts)
    for a, b in combinations(result.parts, 2):
        assert a.solid.intersect(b.solid).volume_mm3 < 1e-3
    vertices, faces = model.solid.arrays()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet([1.0, 1.0, 1.0], 60)
    face_indices = rng.choice(len(faces), 60, p=mesh.area_faces / mesh.area)
    points = (
        np.einsum("nk,nkd->nd", weights, mesh.triangles[face_indices])
        - 1e-3 * mesh.face_normals[face_indices]
    )
    # A point at a sharp edge may lie outside, beyond the opposite side.
    is_inside = find_points_inside(points, model.solid)
    owner_counts = np.sum([find_points_inside(points, part.solid) for part in result.parts], axis=0)
    assert (owner_counts[is_inside] == 1).all()


def make_options(engine: Engine, interior: Interior, seed: int) -> Options:
    return Options(
        engine,
        5,
        interior,
        8.0,
        seed=seed,
        parallelobox=ParalleloboxOptions(tries=1),
        prove=False,
        fit_first_layer=False,
    )


@pytest.mark.parametrize("interior", Interior)
@pytest.mark.parametrize("engine", ENGINES)
def test_each_engine_cuts_a_ball(engine: Engine, interior: Interior, cost: CostModel) -> None:
    model = make_model([], (0.3, 0.2, 0.1))
    check_invariants(decompose_model(model, PRINTERS, make_options(engine, interior, 0), cost), model, 0)


@pytest.mark.parametrize("engine", ENGINES)
@settings(max_examples=1, deadline=None)
@given(
    blocks=st.lists(st.tuples(corners_mm, sizes_mm), max_size=2),
    angles_rad=turns_rad,
    seed=st.integers(0, 10**6),
    keeps_interior=st.booleans(),
)
@example(
    blocks=[((15, 15, 15), (15, 15, 15))], angles_rad=(0.0, 1.7e-197, -4e-58), seed=0, keeps_interior=False
)
@example(
    blocks=[],
    angles_rad=(0.34124882938726064, 0.2943790231485002, 0.2307702229625077),
    seed=0,
    keeps_interior=True,
)
def test_all_of_the_surface_is_printed_once_by_parts_that_fit(
    engine: Engine,
    blocks: list[tuple[tuple[int, ...], tuple[int, ...]]],
    angles_rad: tuple[float, ...],
    seed: int,
    keeps_interior: bool,
    cost: CostModel,
) -> None:
    model = make_model(blocks, angles_rad)
    interior = Interior.KEEP if keeps_interior else Interior.LEAVE
    try:
        result = decompose_model(model, PRINTERS, make_options(engine, interior, seed), cost)
    except NoFit:
        assert engine is not Engine.GUILLOTINE  # this engine always finds parts
        return
    check_invariants(result, model, seed)
