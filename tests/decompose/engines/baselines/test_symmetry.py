"""The engine `symmetry`: cuts at planes of symmetry, and planes in any direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.geometry import Model, Solid, find_good_mirrors, sample_mirrors
from decompose.geometry.symmetry import MIN_ANGLE_RAD
from decompose.grid import PLANE_CLEARANCE_MM
from decompose.options import Engine, Options
from decompose.pieces import Piece, find_cut_faces
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem.fitting import (
    count_blocks,
    count_parts,
    find_clear_offset_mm,
    split_connected_pieces,
)

PRINTER = TargetPrinter("plus", ((206.9, 190.9, 205.0),))
OPTIONS = Options(Engine.SYMMETRY, seed=3, fit_first_layer=False, prove=False)
FAITHFUL_OPTIONS = replace(OPTIONS, faithful=True)


@pytest.fixture(scope="module")
def rough_ball() -> Model:
    sphere = trimesh.creation.icosphere(2, 150.0)
    return Model(Solid.from_arrays(sphere.vertices, sphere.faces), (), 1.0)


directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


def make_printers(count: int) -> list[TargetPrinter]:
    return [replace(PRINTER, name=str(i)) for i in range(count)]


@settings(max_examples=30, deadline=None)
@given(direction=directions, share=st.floats(0.2, 0.8))
def test_solid_is_cut_by_an_oblique_plane(
    ring_with_bar: Solid, direction: tuple[float, float, float], share: float
) -> None:
    normal = np.array(direction) / np.linalg.norm(direction)
    distances_mm = ring_with_bar.arrays()[0] @ normal
    at_mm = float(distances_mm.min() + share * np.ptp(distances_mm))
    below, above = ring_with_bar.split_by_plane(normal, at_mm)
    assert below.volume_mm3 + above.volume_mm3 == pytest.approx(ring_with_bar.volume_mm3, rel=1e-9)
    assert (below.arrays()[0] @ normal).max() < at_mm + 1e-7
    assert (above.arrays()[0] @ normal).min() > at_mm - 1e-7
    # The faces on the plane are known to be cuts; all others are the unchanged surface.
    uncut_mm2 = 0.0
    for side in (below, above):
        vertices, faces = side.arrays()
        corners = vertices[faces[~find_cut_faces(vertices, faces, np.array([[*normal, at_mm]]))]]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        uncut_mm2 += float(np.linalg.norm(cross, axis=1).sum() / 2.0)
    assert uncut_mm2 == pytest.approx(ring_with_bar.area_mm2, rel=1e-7)


def test_number_of_parts_required_by_the_build_volume_is_computed() -> None:
    size_mm = np.array([450.0, 100.0, 300.0])
    assert count_blocks(size_mm, [PRINTER]) == (3, 1, 2)
    tall_printer = TargetPrinter("tall", ((206.9, 190.9, 305.0),))
    assert sorted(count_blocks(size_mm, [tall_printer])) == [1, 1, 3] or count_blocks(
        size_mm, [tall_printer]
    ) == (
        2,
        1,
        2,
    )
    assert count_blocks(size_mm, [PRINTER, tall_printer]) == (3, 1, 2)
    assert count_parts(Solid.box((0, 0, 0), (190.9, 205.0, 206.9)), [PRINTER]) == 1
    assert count_parts(Solid.box((0, 0, 0), (191.0, 205.1, 206.9)), [PRINTER]) == 2


def test_films_on_a_cut_are_ignored() -> None:
    separate_boxes = [Solid.box((0, 0, 0), (10, 10, 10)), Solid.box((20, 0, 0), (20 + 1e-9, 10, 10))]
    result = split_connected_pieces(Piece(Solid.union(separate_boxes), np.zeros((0, 4)), np.zeros((0, 2, 3))))
    assert [piece.solid.volume_mm3 for piece in result] == pytest.approx([1000.0])


def test_cut_plane_keeps_its_distance_from_faces() -> None:
    step = Solid.union([Solid.box((0, 0, 0), (100, 40, 40)), Solid.box((0, 0, 0), (50, 40, 90))])
    direction = np.array([1.0, 0.0, 0.0])
    assert find_clear_offset_mm(step, direction, 30.0) == 30.0
    assert abs(find_clear_offset_mm(step, direction, 50.5) - 50.0) == pytest.approx(PLANE_CLEARANCE_MM)


def test_planes_of_symmetry_differ_and_the_best_is_first() -> None:
    block = Solid.box((0, 0, 0), (50, 60, 70)).arrays()[0]
    for result in (
        sample_mirrors(block, np.random.default_rng(0), 5),
        find_good_mirrors(block, np.random.default_rng(0), 3, 25),
    ):
        assert len(result) >= 3
        errors = [mirror.error_mm for mirror in result]
        assert errors == sorted(errors)
        for i, a in enumerate(result):
            assert all(abs(a.normal @ b.normal) <= np.cos(MIN_ANGLE_RAD) for b in result[:i])
    assert find_good_mirrors(block, np.random.default_rng(0), 3, 25)[0].error_mm == pytest.approx(
        0.0, abs=1e-9
    )
    asymmetric_points = np.random.default_rng(1).uniform(0.0, 100.0, (60, 3))
    assert not find_good_mirrors(asymmetric_points, np.random.default_rng(0), 3, 5)
    # These are returned regardless of their errors.
    assert len(sample_mirrors(asymmetric_points, np.random.default_rng(0), 5)) >= 3


@pytest.mark.parametrize("options", [OPTIONS, FAITHFUL_OPTIONS])
def test_parts_add_up_to_the_model_and_are_deterministic(options: Options, cost: CostModel) -> None:
    """Use an egg, whose halves are connected wherever it is cut."""
    egg = trimesh.creation.icosphere(2, 50.0)
    model = Model(Solid.from_arrays(egg.vertices * (1.0, 1.3, 1.7), egg.faces), (), 1.0)
    result = decompose_model(model, make_printers(4), options, cost)
    assert 2 <= len(result.parts) <= 4
    assert sum(p.solid.volume_mm3 for p in result.parts) == pytest.approx(model.solid.volume_mm3, rel=1e-9)
    assert result.makespan_s < result.serial_s
    second_result = decompose_model(model, make_printers(4), options, cost)
    assert [p.solid.volume_mm3 for p in second_result.parts] == [p.solid.volume_mm3 for p in result.parts]


def test_model_larger_than_the_build_volume_is_cut(rough_ball: Model, cost: CostModel) -> None:
    result = decompose_model(rough_ball, make_printers(9), OPTIONS, cost)
    assert 8 <= len(result.parts) <= 9
    for part in result.parts:
        assert PRINTER.fits(*(np.ptp(part.build_printing_mesh()[0], axis=0) - 1e-6))


def test_parts_that_do_not_fit_are_counted_in_the_error(rough_ball: Model, cost: CostModel) -> None:
    with pytest.raises(NoFit, match=r"4 of the 4 parts that symmetry makes for 4 printers fit none"):
        decompose_model(rough_ball, make_printers(4), FAITHFUL_OPTIONS, cost)
    with pytest.raises(
        NoFit, match="needs at least 8 parts to fit the build volumes, but there are only 4 printers"
    ) as error:
        decompose_model(rough_ball, make_printers(4), OPTIONS, cost)
    assert error.value.needed_printer_count == 8


def test_one_printer_gets_an_uncut_model_that_fits(ring_with_bar: Solid, cost: CostModel) -> None:
    for options in (OPTIONS, FAITHFUL_OPTIONS):
        assert len(decompose_model(Model(ring_with_bar, (), 1.0), make_printers(1), options, cost).parts) == 1
