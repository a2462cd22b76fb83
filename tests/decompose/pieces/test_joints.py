"""Joints: area and width of the glue, and pieces that are hard to glue."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.arrays import Floats
from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.geometry import Model, Solid
from decompose.options import BestOptions, Engine, Options
from decompose.pieces import JointFace, Piece, cut_box, find_cut_faces, find_faults, find_joints
from decompose.pieces.joints import _unite_triangles
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter

LIMIT_MM = 1e3


def make_block(lo: tuple[float, ...], hi: tuple[float, ...]) -> Solid:
    return Solid.box(lo, hi)


def cut_by_planes(
    solid: Solid, x: tuple[float, ...] = (), y: tuple[float, ...] = (), z: tuple[float, ...] = ()
) -> list[Piece]:
    """Cut a solid by unbounded planes, and return the pieces."""
    spans = [list(pairwise([-LIMIT_MM, *sorted(cuts_mm), LIMIT_MM])) for cuts_mm in (x, y, z)]
    return [
        piece
        for (x0, x1), (y0, y1), (z0, z1) in product(*spans)
        for piece in cut_box(solid, (x0, y0, z0), (x1, y1, z1))
    ]


def test_two_halves_have_one_joint() -> None:
    (joint,) = find_joints(cut_by_planes(make_block((0, 0, 0), (60, 40, 30)), x=(25.0,)))
    assert (joint.a, joint.b) == (0, 1)
    assert joint.area_mm2 == pytest.approx(1200.0)
    assert joint.width_mm == pytest.approx(30.0, rel=0.02)


def test_duplicate_plane_counts_once() -> None:
    piece, other_piece = cut_by_planes(make_block((0, 0, 0), (60, 40, 30)), x=(25.0,))
    doubled_piece = Piece(piece.solid, np.concatenate([piece.planes, -piece.planes]), piece.boxes_mm)
    (joint,) = find_joints([doubled_piece, other_piece])
    assert joint.area_mm2 == pytest.approx(1200.0)


def test_width_of_a_frame_is_that_of_its_rim() -> None:
    frame = make_block((0, 0, 0), (60, 60, 30)).subtract(make_block((4, 4, -1), (56, 56, 31)))
    pieces = cut_by_planes(frame, z=(15.0,))
    (joint,) = find_joints(pieces)
    assert joint.area_mm2 == pytest.approx(60.0**2 - 52.0**2)
    # The width is measured in a corner.
    assert joint.width_mm == pytest.approx(4.0 * 2.0 / (1.0 + np.sqrt(0.5)), rel=0.05)


# Coordinates are rounded because shapely divides by them, and the inverse of a denormal is infinite.
lengths_mm = st.floats(0.0, 20.0).map(lambda v: round(v, 3))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(*[lengths_mm] * 4), min_size=1, max_size=4), st.floats(0.3, 12.0))
def test_a_face_has_the_widths_up_to_that_of_its_largest_circle(
    bars: list[tuple[float, ...]], min_width_mm: float
) -> None:
    outline = shapely.union_all([shapely.box(x, y, x + 0.5 + w, y + 0.5 + d) for x, y, w, d in bars])
    face = JointFace(np.array([0.0, 0.0, 1.0]), 0.0, np.eye(3)[:2], outline)
    width_mm = face.measure_width_mm()
    if abs(width_mm - min_width_mm) > 0.01 * width_mm:
        assert face.has_width(min_width_mm) == (width_mm > min_width_mm)


def test_a_piece_with_other_planes_is_inspected_again() -> None:
    pieces = cut_by_planes(make_block((0, 0, 0), (60, 40, 30)), x=(25.0,))
    assert len(find_joints(pieces)) == 1
    moved = [replace(piece, planes=piece.planes + np.array([0.0, 0.0, 0.0, 1.0])) for piece in pieces]
    assert find_joints(moved) == []


def test_pieces_that_meet_in_an_edge_have_no_joint() -> None:
    pieces = cut_by_planes(make_block((0, 0, 0), (60, 40, 30)), x=(25.0,), y=(20.0,))
    assert [(j.a, j.b) for j in find_joints(pieces)] == [(0, 1), (0, 2), (1, 3), (2, 3)]


# No plane lies in a face of the model, which would count as a cut face without a piece on the other side.
offsets_mm = st.floats(-35.0, 70.0).map(lambda v: round(v, 2) + 0.003)


@settings(max_examples=15, deadline=None)
@given(*[st.lists(offsets_mm, max_size=2, unique=True)] * 3)
def test_each_cut_face_is_glued_on_both_sides(
    ring_with_bar: Solid, x: list[float], y: list[float], z: list[float]
) -> None:
    pieces = cut_by_planes(ring_with_bar, tuple(x), tuple(y), tuple(z))
    cut_mm2 = 0.0
    for piece in pieces:
        vertices, faces = piece.solid.arrays()
        t = vertices[faces[find_cut_faces(vertices, faces, piece.planes)]]
        cut_mm2 += float(np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() / 2.0)
    results = find_joints(pieces)
    assert 2.0 * sum(j.area_mm2 for j in results) == pytest.approx(cut_mm2, rel=1e-6, abs=1e-3)
    assert all(0.0 < j.width_mm <= 2.0 * np.sqrt(j.area_mm2 / np.pi) + 1e-6 for j in results)


def test_joints_on_oblique_planes_are_found() -> None:
    solid = make_block((0, 0, 0), (40, 40, 40))
    normal = np.array([0.6, 0.0, 0.8])
    plane = np.array([*normal, 28.0])[None]
    below, above = solid.manifold.split_by_plane(tuple(normal), 28.0)[::-1]
    no_seams = np.zeros((0, 2, 3))
    (joint,) = find_joints([Piece(Solid(below), plane, no_seams), Piece(Solid(above), -plane, no_seams)])
    assert joint.area_mm2 == pytest.approx(40.0 * 40.0 / 0.8)


def test_thin_slice_is_a_sliver_but_not_a_thin_model() -> None:
    slab = make_block((0, 0, 0), (100, 60, 4))
    assert find_faults(cut_by_planes(slab, x=(50.0,))) == []
    (fault,) = find_faults(cut_by_planes(slab, x=(94.0,)))
    assert fault.piece_number == 1
    assert fault.reason.startswith("is 6.0 mm thick")


def test_film_with_a_rib_is_a_flake() -> None:
    model = Solid.union([make_block((0, 0, 0), (60, 60, 30.5)), make_block((0, 30, 0), (60, 30.6, 40))])
    (fault,) = find_faults(cut_by_planes(model, z=(30.0,)))
    assert fault.piece_number == 1
    assert "flake" in fault.reason


def make_dumbbell(bar_mm: float) -> Solid:
    bar_span_mm = 20.0 - bar_mm / 2.0, 20.0 + bar_mm / 2.0
    return Solid.union(
        [
            make_block((0, 0, 0), (40, 40, 40)),
            make_block((80, 0, 0), (130, 40, 40)),
            make_block((20, bar_span_mm[0], bar_span_mm[0]), (100, bar_span_mm[1], bar_span_mm[1])),
        ]
    )


def test_piece_on_a_thin_connection_is_loose() -> None:
    pieces = cut_by_planes(make_dumbbell(4.0), x=(60.0,))
    (fault,) = find_faults(pieces)
    assert fault.piece_number == 0  # the lighter piece
    assert "16.0 mm2 of glue, less than 25 mm2" in fault.reason
    assert find_faults(pieces, min_glue_mm2=15.0) == []
    assert find_faults(cut_by_planes(make_dumbbell(6.0), x=(60.0,))) == []


def test_weak_joint_beside_a_strong_one_does_not_hold() -> None:
    """Use three boxes in a T: two touch each other along a strip, and the third holds both."""
    solids = [
        make_block((0, 0, 0), (60, 30, 30)),
        make_block((0, 30, 0), (30, 60, 30)),
        make_block((30, 30, 0), (60, 60, 30)),
    ]
    pieces = [
        Piece(s, np.array([[0.0, 1.0, 0.0, 30.0], [1.0, 0.0, 0.0, 30.0]]), np.zeros((0, 2, 3)))
        for s in solids
    ]
    assert [round(j.area_mm2) for j in find_joints(pieces)] == [900, 900, 900]
    assert find_faults(pieces) == []
    thin_solid = make_block((30, 30, 0), (60, 60, 0.5))
    pieces[2] = Piece(thin_solid, pieces[2].planes, pieces[2].boxes_mm)
    weak_joint = min(find_joints(pieces), key=lambda j: j.area_mm2)
    assert weak_joint.area_mm2 == pytest.approx(15.0)
    assert [f.piece_number for f in find_faults(pieces)] == [2]


def make_finned_blocks() -> Solid:
    """Make two blocks that a fin of 0.5 mm joins over 400 mm."""
    return Solid.union(
        [
            make_block((0, 0, 0), (400, 60, 60)),
            make_block((0, 100, 0), (400, 170, 60)),
            make_block((0, 50, 30), (400, 110, 30.5)),
        ]
    )


def test_long_thin_joint_does_not_hold() -> None:
    pieces = cut_by_planes(make_finned_blocks(), y=(80.0,))
    (joint,) = find_joints(pieces)
    assert joint.area_mm2 == pytest.approx(200.0)
    assert joint.width_mm == pytest.approx(0.5, rel=0.02)
    (fault,) = find_faults(pieces)
    assert fault.reason == "is held by a joint 0.5 mm wide, less than 0.8 mm"
    assert find_faults(pieces, min_glue_mm2=0.0) == []
    assert not joint.holds(25.0) and joint.holds(0.0)


def test_partition_with_a_thin_joint_is_rejected(cost: CostModel) -> None:
    """Use a model whose cheapest cut is between the two blocks."""
    printers = [TargetPrinter(f"um-{i}", ((420.0, 420.0, 100.0),)) for i in range(2)]
    options = Options(Engine.GUILLOTINE, 6, min_glue_mm2=0.0, prove=False)
    weak_result = decompose_model(Model(make_finned_blocks(), (), 1.0), printers, options, cost)
    assert min(j.width_mm for j in weak_result.joints) < 1.0
    result = decompose_model(
        Model(make_finned_blocks(), (), 1.0), printers, replace(options, min_glue_mm2=25.0), cost
    )
    assert result.faults == ()
    assert all(j.holds(25.0) for j in result.joints)
    assert len(result.parts) == 2


def test_bodies_that_touch_nothing_are_not_loose() -> None:
    assert (
        find_faults(
            [
                *cut_by_planes(make_block((0, 0, 0), (40, 40, 40))),
                *cut_by_planes(make_block((50, 0, 0), (60, 10, 10))),
            ]
        )
        == []
    )


@pytest.mark.parametrize(("min_glue_mm2", "held_mm2"), [(25.0, 25.0), (0.0, 0.0)])
def test_partition_with_a_weak_joint_is_rejected(
    cost: CostModel, min_glue_mm2: float, held_mm2: float
) -> None:
    """Use two blocks joined by a thin bar: a cut into halves of equal volume goes through the bar."""
    solid = Solid.union(
        [
            make_block((0, 0, 0), (120, 120, 120)),
            make_block((200, 0, 0), (320, 120, 120)),
            make_block((100, 58, 58), (220, 62, 62)),
        ]
    )
    printers = [TargetPrinter(f"um-{i}", ((200.0, 200.0, 200.0),)) for i in range(4)]
    options = Options(Engine.GUILLOTINE, "vcoarse", min_glue_mm2=min_glue_mm2, prove=False)
    result = decompose_model(Model(solid, (), 1.0), printers, options, cost)
    assert result.faults == ()
    # A contact beside a strong joint may be smaller, because it is not glued and holds no part.
    glued_mm2 = [joint.area_mm2 for joint in result.joints if joint.area_mm2 >= min_glue_mm2]
    min_mm2 = min(glued_mm2)
    assert min_mm2 >= held_mm2  # the joint of the bar, or of a block that is cut instead
    assert (min_mm2 < 25.0) == (min_glue_mm2 == 0.0)
    joint_records = result.as_dict()["joints"]
    assert all(j["glued"] == (j["area_mm2"] >= min_glue_mm2) for j in joint_records)
    assert {j["a"] for j in joint_records} <= {p.id for p in result.parts}


@pytest.mark.parametrize("engine", [Engine.GUILLOTINE, Engine.PARALLELOBOX, Engine.BEST])
def test_piece_on_a_thin_joint_is_refused(engine: Engine, cost: CostModel) -> None:
    rod = Model(make_block((0, 0, 0), (500, 4, 4)), (), 1.0)
    printers = [TargetPrinter(f"um-{i}", ((200.0, 200.0, 200.0),)) for i in range(4)]
    options = Options(engine, best=BestOptions(0.0), prove=False)
    with pytest.raises(NoFit, match=r"is held by 16.0 mm2 of glue.*--min-glue"):
        decompose_model(rod, printers, options, cost)
    assert len(decompose_model(rod, printers, Options(Engine.GUILLOTINE, min_glue_mm2=15.0), cost).parts) == 4


def list_corners(face: JointFace) -> Floats:
    """Return the corners (n, 3) of a face's outline in mm."""
    return np.array(face.outline.exterior.coords) @ face.axes + face.offset_mm * face.normal


@given(st.floats(0.0, 6.3), st.tuples(*[st.floats(-300.0, 300.0)] * 3))
def test_moving_a_joint_moves_its_corners(angle_rad: float, offset_mm: tuple[float, float, float]) -> None:
    (joint,) = find_joints(cut_by_planes(make_block((0, 0, 0), (60, 40, 30)), x=(25.0,)))
    transform = np.eye(4)
    transform[:2, :2] = [[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]]
    transform[:3, :3] = transform[:3, :3] @ np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    transform[:3, 3] = offset_mm
    [old_face], [new_face] = joint.faces, joint.move(transform).faces
    assert list_corners(new_face) == pytest.approx(
        list_corners(old_face) @ transform[:3, :3].T + transform[:3, 3], abs=1e-9
    )
    assert new_face.area_mm2 == pytest.approx(1200.0)


def test_planes_of_faces_are_not_rounded() -> None:
    plane_mm = 20.1234567890123
    (joint,) = find_joints(cut_by_planes(make_block((0, 0, 0), (60, 40, 30)), x=(plane_mm,)))
    assert joint.faces[0].offset_mm == plane_mm


@settings(max_examples=60, deadline=None)
@given(
    corners=st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=3, max_size=12, unique=True)
)
def test_triangles_are_united_whether_they_overlap_or_meet_edge_to_edge(
    corners: list[tuple[int, int]],
) -> None:
    """Use a fan about the first corner, which overlaps itself unless the corners surround it in order."""
    points = np.array(corners, dtype=np.float64)
    fan = np.stack([np.broadcast_to(points[0], points[1:-1].shape), points[1:-1], points[2:]], axis=1)
    triangles = shapely.polygons(np.concatenate([fan, fan[:, :1]], axis=1))
    triangles = triangles[shapely.area(triangles) > 0.0]
    union = _unite_triangles(triangles)
    assert union.is_valid
    assert shapely.area(union.symmetric_difference(shapely.union_all(triangles))) < 1e-9
