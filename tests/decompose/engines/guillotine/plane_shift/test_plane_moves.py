"""Groups of faces that move together, and the partitions that remain."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.engines.guillotine.pinwheel import list_pinwheel_boxes
from decompose.engines.guillotine.plane_shift.plane_moves import (
    extend_boxes,
    find_clear_position_mm,
    find_free_directions,
    find_invalid_groups,
    group_faces,
    grow_boxes,
    move_groups,
    refine_needed_cells,
)
from decompose.geometry import Model, Solid
from decompose.grid import Box, FlatFaces, NeededCells
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem

PLANES = tuple(np.arange(7) * 10.0 for _ in range(3))


def convert_to_mm(boxes: list[Box]) -> np.ndarray:
    return 10.0 * np.array(boxes, dtype=float).reshape(-1, 2, 3)


def cut_at_random(rng: np.random.Generator, box: Box, cuts: int) -> list[Box]:
    """Make random axis cuts; planes of two cuts often coincide, so that four corners meet."""
    axis = int(rng.integers(3))
    if cuts == 0 or box[axis + 3] - box[axis] < 2:
        return [box]
    near_box, far_box = list(box), list(box)
    near_box[axis + 3] = far_box[axis] = int(rng.integers(box[axis] + 1, box[axis + 3]))
    return [b for side in (near_box, far_box) for b in cut_at_random(rng, tuple(side), cuts - 1)]  # type: ignore[arg-type]


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.integers(1, 4))
def test_simultaneous_moves_of_all_groups_keep_a_complete_partition(seed: int, cuts: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = convert_to_mm(cut_at_random(rng, (0, 0, 0, 6, 6, 6), cuts))
    cells = NeededCells(PLANES, np.ones((6, 6, 6), dtype=bool))
    groups = group_faces(boxes)
    count = groups.max() + 1
    for group in range(count):
        faces = np.argwhere(groups == group)
        assert len({(axis, boxes[box, side, axis]) for box, side, axis in faces}) == 1
    assert find_free_directions(boxes, groups, cells, 1.0).all()
    assert cells.is_partition(move_groups(boxes, groups, rng.uniform(-4.9, 4.9, count)))


@pytest.mark.parametrize("is_mirrored", [0, 1])
def test_arms_of_a_pinwheel_move_alone(is_mirrored: int) -> None:
    boxes = convert_to_mm(list_pinwheel_boxes((6, 6, 6), (2, is_mirrored, 2, 4, 2, 4)))
    groups = group_faces(boxes)
    assert groups.max() == 3
    cells = NeededCells(PLANES, np.ones((6, 6, 6), dtype=bool))
    assert cells.is_partition(move_groups(boxes, groups, np.array([7.0, -6.0, 5.0, -4.0])))


@pytest.mark.parametrize(
    ("shifts_mm", "invalid_groups"),
    [
        ((25.0, 0.0, 5.0), [0]),  # the first plane passes the second one
        ((12.0, -12.0, 5.0), [1]),  # only both moves together let the two planes pass each other
        ((12.0, -5.0, -25.0), [2]),
    ],
)
def test_only_planes_that_pass_others_are_invalid(
    shifts_mm: tuple[float, ...], invalid_groups: list[int]
) -> None:
    boxes = convert_to_mm([(x, 0, 0, end, 6, 6) for x, end in pairwise((0, 1, 3, 5, 6))])
    cells = NeededCells(PLANES, np.ones((6, 6, 6), dtype=bool))
    groups = group_faces(boxes)
    moved_boxes = move_groups(boxes, groups, np.array(shifts_mm))
    assert not cells.is_partition(moved_boxes)
    assert find_invalid_groups(groups, boxes, moved_boxes, cells) == invalid_groups


def test_four_boxes_about_an_edge_share_one_of_their_planes() -> None:
    quarters = [(x, y, 0, x + 3, y + 3, 6) for x in (0, 3) for y in (0, 3)]
    groups = group_faces(convert_to_mm(quarters))
    assert groups.max() == 2  # one plane is continuous, the other consists of two halves that move separately


def test_face_moves_only_into_a_box_that_covers_it() -> None:
    """Use a lower box that is narrower, so that it cannot take needed cells from the upper one."""
    boxes = [(0, 0, 0, 3, 6, 3), (0, 0, 3, 6, 6, 6)]
    is_needed = np.ones((6, 6, 6), dtype=bool)
    is_needed[3:, :, :3] = False
    cells = NeededCells(PLANES, is_needed)
    groups = group_faces(convert_to_mm(boxes))
    assert find_free_directions(convert_to_mm(boxes), groups, cells, 1.0).tolist() == [[True, False]]
    filled_boxes = extend_boxes(convert_to_mm(boxes))
    assert filled_boxes.tolist() == convert_to_mm([(0, 0, 0, 6, 6, 3), (0, 0, 3, 6, 6, 6)]).tolist()
    assert find_free_directions(filled_boxes, group_faces(filled_boxes), cells, 1.0).tolist() == [
        [True, True]
    ]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.integers(1, 4))
def test_boxes_grow_and_remain_disjoint(seed: int, cuts: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = cut_at_random(rng, (0, 0, 0, 6, 6, 6), cuts)
    boxes_mm = convert_to_mm([box for box in boxes if rng.random() < 0.7] or boxes)
    grown_mm = extend_boxes(boxes_mm)
    assert (grown_mm[:, 0] <= boxes_mm[:, 0]).all()
    assert (grown_mm[:, 1] >= boxes_mm[:, 1]).all()
    owners = np.zeros((6, 6, 6), int)
    for (x0, y0, z0), (x1, y1, z1) in np.rint(grown_mm / 10.0).astype(int):
        owners[x0:x1, y0:y1, z0:z1] += 1
    assert owners.max() == 1


def test_free_faces_grow_and_touching_faces_stay() -> None:
    boxes_mm = convert_to_mm([(0, 0, 0, 3, 6, 3), (0, 0, 3, 6, 6, 6)])
    (low, high) = grow_boxes(boxes_mm, 0.5)
    assert low.tolist() == [[-0.5, -0.5, -0.5], [30.5, 60.5, 30.0]]
    assert high.tolist() == [[-0.5, -0.5, 30.0], [60.5, 60.5, 60.5]]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.integers(1, 4), margin_mm=st.sampled_from([0.5, 10.0, 25.0]))
def test_grown_boxes_are_disjoint(seed: int, cuts: int, margin_mm: float) -> None:
    rng = np.random.default_rng(seed)
    boxes = cut_at_random(rng, (0, 0, 0, 6, 6, 6), cuts)
    boxes_mm = convert_to_mm([box for box in boxes if rng.random() < 0.7] or boxes)
    grown_mm = grow_boxes(boxes_mm, margin_mm)
    assert (grown_mm[:, 0] <= boxes_mm[:, 0]).all()
    assert (grown_mm[:, 1] >= boxes_mm[:, 1]).all()
    overlap_mm = np.minimum(grown_mm[:, None, 1], grown_mm[None, :, 1]) - np.maximum(
        grown_mm[:, None, 0], grown_mm[None, :, 0]
    )
    has_overlap = (overlap_mm > 0.0).all(axis=2)
    assert not has_overlap[~np.eye(len(boxes_mm), dtype=bool)].any()


def test_overlapping_or_incomplete_boxes_are_not_a_partition() -> None:
    cells = NeededCells(PLANES, np.ones((6, 6, 6), dtype=bool))
    box = np.array([[[0.0, 0.0, 0.0], [60.0, 60.0, 60.0]]])
    assert cells.is_partition(box)
    assert not cells.is_partition(box - np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]]))
    assert not cells.is_partition(np.concatenate([box, box]))


@given(
    flats=st.dictionaries(st.floats(0.0, 50.0), st.sampled_from((2.0, 0.1)), max_size=6),
    old_mm=st.floats(0.0, 50.0),
    new_mm=st.floats(0.0, 50.0),
)
def test_plane_stops_before_flat_faces(flats: dict[float, float], old_mm: float, new_mm: float) -> None:
    flat_faces = FlatFaces(np.array(sorted(flats)), np.array([flats[key] for key in sorted(flats)]))
    position_mm = find_clear_position_mm(flat_faces, old_mm, new_mm)
    assert min(old_mm, new_mm) <= position_mm <= max(old_mm, new_mm)
    assert position_mm == old_mm or all(
        abs(flat_mm - position_mm) >= clearance_mm - 1e-6 for flat_mm, clearance_mm in flats.items()
    )
    if all(abs(flat_mm - new_mm) >= clearance_mm for flat_mm, clearance_mm in flats.items()):
        assert position_mm == new_mm


@pytest.mark.parametrize("printers", [2, 100])
def test_plane_is_free_beside_solid_that_ends_before_it(cost: CostModel, printers: int) -> None:
    """Check an L whose wide half ends 1 mm before the plane; only its narrow half crosses the plane."""
    wide_half = Solid.box((0.0, 0.0, 0.0), (104.0, 100.0, 40.0))
    solid = Solid.union([wide_half, Solid.box((0.0, 0.0, 0.0), (200.0, 50.0, 40.0))])
    target_printers = tuple(TargetPrinter(f"p{i}", ((220.0, 220.0, 200.0),)) for i in range(printers))
    problem = Problem(Model(solid, (), 1.0), target_printers, cost, Options(Engine.GUILLOTINE, 20))
    grid = problem.build_grid(problem.model)
    plane_mm = float(grid.planes[0][np.searchsorted(grid.planes[0], 104.5)])
    assert 104.8 < plane_mm < 105.1
    boxes_mm = np.array([[(-1, -1, -1), (plane_mm, 101, 41)], [(plane_mm, -1, -1), (201, 55, 41)]])
    cells = refine_needed_cells(problem, grid)
    is_free = find_free_directions(boxes_mm, group_faces(boxes_mm), cells, step_mm=0.4)
    assert is_free.tolist() == [[True, True]]
