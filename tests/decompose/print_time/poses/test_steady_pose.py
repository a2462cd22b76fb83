"""Parts with spare time, which stand on a larger foot than in their fastest pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decompose.decompose import decompose_model
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.print_time import (
    POSE_ROTATIONS,
    CostModel,
    PartMesh,
    Pose,
    compute_steady_limit_s,
    find_best_pose,
    find_steady_pose,
    measure_pose,
)
from decompose.printers import TargetPrinter

PRINTER = TargetPrinter("p", ((200.0, 190.0, 200.0),))
POST = Solid.box((0.0, 0.0, 0.0), (12.0, 12.0, 120.0))


def get_mesh(solid: Solid) -> PartMesh:
    vertices, faces = solid.arrays()
    return PartMesh(vertices, faces, np.zeros(len(faces), np.bool_))


def measure_upright_pose(solid: Solid, cost: CostModel) -> Pose:
    mesh = get_mesh(solid)
    return measure_pose(mesh.vertices, mesh.faces, mesh.is_cut, POSE_ROTATIONS[4], cost)


def test_part_on_a_small_foot_lies_down_within_its_time(cost: CostModel) -> None:
    standing_pose = measure_upright_pose(POST, cost)
    assert standing_pose.has_small_foot
    lying_pose = find_steady_pose(get_mesh(POST), [PRINTER], cost, standing_pose, 1.5 * standing_pose.price_s)
    assert lying_pose.size_mm[2] == pytest.approx(12.0)
    assert lying_pose.footing.contact_mm2 == pytest.approx(1440.0)
    assert not lying_pose.has_small_foot
    assert (
        find_steady_pose(get_mesh(POST), [PRINTER], cost, standing_pose, 0.5 * lying_pose.price_s)
        is standing_pose
    )


def test_steady_pose_fits_its_printer_and_keeps_supports_off_cuts(cost: CostModel) -> None:
    standing_pose = measure_upright_pose(POST, cost)
    narrow_printer = TargetPrinter("narrow", ((50.0, 50.0, 200.0),))
    assert (
        find_steady_pose(get_mesh(POST), [narrow_printer], cost, standing_pose, 9.0 * standing_pose.price_s)
        is standing_pose
    )
    tee = Solid.union([Solid.box((-5, -5, 0), (5, 5, 40)), Solid.box((-30, -5, 40), (30, 5, 100))])
    vertices, faces = tee.arrays()
    # The cut face is one of the flat sides on which the part could lie.
    is_cut = (np.abs(vertices[faces][:, :, 1] + 5.0) < 1e-9).all(axis=1)
    mesh = PartMesh(vertices, faces, is_cut)
    best_pose = find_best_pose(vertices, faces, is_cut, [PRINTER], cost)
    assert best_pose is not None
    steady_pose = find_steady_pose(mesh, [PRINTER], cost, best_pose, 9.0 * best_pose.price_s)
    assert steady_pose.touched_mm2 <= best_pose.touched_mm2


def test_only_a_part_on_a_small_foot_spends_its_spare_time(cost: CostModel) -> None:
    small_pose = measure_upright_pose(POST, cost)
    large_pose = measure_upright_pose(Solid.box((0, 0, 0), (60, 60, 150)), cost)
    assert small_pose.has_small_foot and not large_pose.has_small_foot
    assert compute_steady_limit_s(small_pose, 2.0 * small_pose.price_s) == 2.0 * small_pose.price_s
    assert compute_steady_limit_s(small_pose, 0.0) == pytest.approx(1.02 * small_pose.price_s)
    assert compute_steady_limit_s(large_pose, 2.0 * large_pose.price_s) == pytest.approx(
        1.02 * large_pose.price_s
    )
    assert compute_steady_limit_s(large_pose, 0.0) == 0.0


@pytest.mark.parametrize("time_factor", [1.0, 1.5])
def test_makespan_does_not_grow_with_steadier_poses(cost: CostModel, time_factor: float) -> None:
    """Use a block that takes far longer than the post, which may therefore be printed lying down."""
    solid = Solid.union([Solid.box((0, 0, 0), (90, 90, 90)), Solid.box((200, 0, 0), (212, 12, 120))])
    printers = [replace(PRINTER, name=name, time_factor=time_factor) for name in "ab"]
    options = Options(Engine.GUILLOTINE, 4, prove=False)
    result = decompose_model(Model(solid, (), 1.0), printers, options, cost)
    slowest_part = max(result.parts, key=lambda part: part.price_s)
    assert result.makespan_s == slowest_part.price_s * time_factor
    post = min(result.parts, key=lambda part: part.price_s)
    assert post.small_foot_mm2 is None
    assert np.ptp(post.build_printing_mesh()[0][:, 2]) == pytest.approx(12.0, abs=1e-3)
    assert result.describe_small_feet() == ""


def test_small_foot_is_described(cost: CostModel) -> None:
    narrow_printer = TargetPrinter("narrow", ((50.0, 50.0, 200.0),))
    result = decompose_model(
        Model(POST, (), 1.0), [narrow_printer], Options(Engine.GUILLOTINE, 4, prove=False), cost
    )
    assert result.parts[0].small_foot_mm2 == pytest.approx(144.0, abs=1.0)
    assert "p01 on 144 mm2" in result.describe_small_feet()
    assert result.as_dict()["small_feet"] == result.describe_small_feet()
