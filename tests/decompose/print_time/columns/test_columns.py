"""Supports and mass, measured in columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from decompose.geometry import Solid
from decompose.print_time import measure_columns
from decompose.print_time.columns import Columns, estimate_supports
from decompose.print_time.columns.columns import SIDE_STEP_MM
from decompose.print_time.columns.sweep import LEVEL_COUNT

OVERHANG_COS = np.sin(np.radians(45.0))


def measure_solid(solid: Solid, marked_normal_z: float | None = None) -> Columns:
    """Measure the columns of a solid; mark the faces whose normal has this Z component."""
    vertices, faces = solid.arrays()
    triangles = vertices[faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals_z = normals[:, 2] / np.linalg.norm(normals, axis=1)
    is_marked = (
        np.zeros(len(faces), bool) if marked_normal_z is None else np.isclose(normals_z, marked_normal_z)
    )
    return measure_columns(triangles, is_marked, OVERHANG_COS)


@pytest.fixture(scope="module")
def bench() -> Solid:
    """Make a foot of 20 x 20 x 5 mm, a post, and a seat of 20 x 20 x 5 mm above both foot and bed."""
    return Solid.union(
        [
            Solid.box((0, 0, 0), (20, 20, 5)),
            Solid.box((10, 0, 5), (20, 20, 25)),
            Solid.box((0, 0, 25), (40, 20, 30)),
        ]
    )


def test_supports_end_on_the_part(bench: Solid) -> None:
    """Use a seat that is 20 mm above 10 mm of the foot, and 25 mm above 20 mm of the bed."""
    result = measure_solid(bench)
    assert result.support_mm3 == pytest.approx(10 * 20 * 20 + 20 * 20 * 25, rel=0.03)
    assert result.support_side_mm2 == pytest.approx((10 + 20) * 2 * 20 + (20 + 20) * 2 * 25, rel=0.05)
    assert result.bed_support_mm2 == pytest.approx(20 * 20, rel=0.05)
    assert result.bed_support_border_mm[:, 0].min() == pytest.approx(20.0, abs=0.5)
    assert result.touched_mm2 == 0.0


def test_narrow_supports_of_a_large_model_are_measured() -> None:
    """Leave slots of 2.5 mm between walls below a roof of 450 x 300 mm."""
    starts_mm = np.arange(0.0, 450.0, 18.7).tolist()
    walls = [Solid.box((x, 0, 0), (x + 16.2, 300, 20)) for x in starts_mm]
    roof = Solid.box((0, 0, 20), (starts_mm[-1] + 16.2, 300, 25))
    result = measure_solid(Solid.union([*walls, roof]))
    slot_count = len(walls) - 1
    assert result.support_mm3 == pytest.approx(slot_count * 2.5 * 300 * 20, rel=0.1)
    assert result.support_side_mm2 == pytest.approx(slot_count * 2 * (300 + 2.5) * 20, rel=0.05)


def test_marked_faces_are_touched_from_below_and_from_above(bench: Solid) -> None:
    # Support touches the seat, but not the base of the foot.
    assert measure_solid(bench, -1.0).touched_mm2 == pytest.approx(30 * 20, rel=0.05)
    # Support touches the top of the foot, but not the top of the seat.
    assert measure_solid(bench, 1.0).touched_mm2 == pytest.approx(10 * 20, rel=0.05)
    assert measure_solid(bench, 0.5).touched_mm2 == 0.0


def test_mass_grows_with_height(bench: Solid) -> None:
    result = measure_solid(bench)
    assert result.volumes_mm3[-1] == pytest.approx(bench.volume_mm3, rel=0.02)
    assert (np.diff(result.volumes_mm3) > 0.0).all()
    expected_centre_mm = (
        np.array([10, 10, 2.5]) * 2000 + np.array([15, 10, 15]) * 4000 + np.array([20, 10, 27.5]) * 4000
    ) / 1e4
    assert result.centres_mm[-1] == pytest.approx(expected_centre_mm, abs=0.3)
    assert result.centres_mm[0] == pytest.approx([10.0, 10.0, 30.0 / LEVEL_COUNT / 2.0], abs=0.3)


def test_ball_needs_a_cone_of_support() -> None:
    """Compute the volume under a sphere's cap of 45 degrees, less the sphere, by integration."""
    mesh = trimesh.creation.icosphere(4, 20.0)
    mesh.apply_translation([0, 0, 20])
    result = measure_solid(Solid.from_arrays(mesh.vertices, mesh.faces))
    radii_mm = np.linspace(0.0, 20.0 / np.sqrt(2.0), 1000)
    heights_mm = 20.0 - np.sqrt(400.0 - radii_mm**2)
    assert result.support_mm3 == pytest.approx(
        np.trapezoid(2 * np.pi * radii_mm * heights_mm, radii_mm), rel=0.05
    )


def test_tip_in_mid_air_needs_a_tower() -> None:
    """Use an arm, too steep for support, that begins in a tip 20 mm above the bed and joins a post."""
    corners = [(0, 0, 20), (-4, -4, 40), (4, -4, 40), (4, 4, 40), (-4, 4, 40)]
    hull = trimesh.convex.convex_hull(np.array(corners, float))
    tip = Solid.from_arrays(hull.vertices, hull.faces)
    post = [Solid.box((20, -4, 0), (30, 4, 50)), Solid.box((-4, -4, 40), (30, 4, 50))]
    assert measure_solid(Solid.union([tip, *post])).towers_mm == pytest.approx(20.0, abs=3.0)
    assert measure_solid(tip.union([tip, post[0]])).towers_mm == pytest.approx(20.0, abs=3.0)
    assert measure_solid(Solid.union(post)).towers_mm == 0.0  # support carries all of it
    cup = Solid.box((-10, -10, 0), (10, 10, 60)).subtract(tip)
    assert measure_solid(cup).towers_mm == 0.0  # a tip that points up needs no tower


def test_islands_are_separate_areas_of_a_layer() -> None:
    legs = [Solid.box((x, y, 0), (x + 8, y + 8, 30)) for x in (0, 32) for y in (0, 32)]
    table = Solid.union([*legs, Solid.box((0, 0, 30), (40, 40, 40))])
    assert measure_solid(legs[0]).islands_mm == 0.0
    assert measure_solid(Solid.union(legs)).islands_mm == pytest.approx(3 * 30.0)
    # The islands of the support between the legs count too.
    assert measure_solid(table).islands_mm == pytest.approx(4 * 30.0, abs=4 * 40.0 / 16)
    assert (
        measure_solid(Solid.union(legs)).bodies_mm
        == measure_solid(table).bodies_mm
        == pytest.approx(3 * 30.0, abs=8.0)
    )
    assert measure_solid(legs[0]).bodies_mm == 0.0


def test_paths_lead_from_island_to_nearest_island() -> None:
    posts = [Solid.box((x, y, 0), (x + 6, y + 6, 30)) for x in range(0, 60, 12) for y in (0, 12, 24, 36)]
    result = measure_solid(Solid.union(posts))
    assert result.islands_mm == pytest.approx(19 * 30.0)
    assert result.bodies_mm == pytest.approx(19 * 30.0)
    assert result.island_paths_mm2 == pytest.approx(19 * 30.0 * 12.0, rel=0.03)
    # In a large rectangle, islands in two groups are as close to each other as before.
    pairs = [Solid.box((x, y, 0), (x + 6, y + 6, 30)) for x in (0, 100) for y in (0, 12)]
    assert measure_solid(Solid.union(pairs)).island_paths_mm2 == pytest.approx(
        (12 + 100 + 12) * 30.0, rel=0.03
    )


def test_sides_are_priced_as_if_columns_were_close() -> None:
    table = Solid.union([Solid.box((0, 0, 0), (8, 40, 30)), Solid.box((0, 0, 30), (40, 40, 40))])
    result = measure_solid(table)
    coarse_result = replace(result, step_mm=16.0 * result.step_mm)
    assert coarse_result.fine_support_side_mm2 == pytest.approx(2.0 * result.fine_support_side_mm2)
    usual_result = replace(result, step_mm=SIDE_STEP_MM)
    assert usual_result.fine_support_side_mm2 == result.support_side_mm2 > 0.0


def test_holes_of_a_layer_are_counted() -> None:
    bores = [
        trimesh.creation.cylinder(4.0, segment=[(x, y, -1), (x, y, 5)]) for x in (15, 45) for y in (15, 45)
    ]
    holes = Solid.union([Solid.from_arrays(bore.vertices, bore.faces) for bore in bores])
    plate = Solid.box((0, 0, 0), (60, 60, 10)).subtract(holes)
    result = measure_solid(plate)
    assert result.holes_mm == pytest.approx(4 * 5.0, abs=4 * 10.0 / 16)  # they end at half the height
    assert measure_solid(Solid.box((0, 0, 0), (60, 60, 10))).holes_mm == 0.0


def test_brim_surrounds_each_foot_but_fills_no_hole() -> None:
    legs = [Solid.box((x, 0, 0), (x + 20, 20, 10)) for x in (0, 80)]
    brim_mm2 = 4 * 20.0 * 5.0 + np.pi * 5.0**2
    assert measure_solid(legs[0]).measure_brim_mm2(5.0) == pytest.approx(brim_mm2, rel=0.03)
    assert measure_solid(Solid.union(legs)).measure_brim_mm2(5.0) == pytest.approx(2 * brim_mm2, rel=0.05)
    ring = Solid.box((0, 0, 0), (20, 20, 10)).subtract(Solid.box((4, 4, -1), (16, 16, 11)))
    assert measure_solid(ring).measure_brim_mm2(5.0) == pytest.approx(brim_mm2, rel=0.03)
    assert measure_solid(ring).measure_brim_mm2(0.0) == 0.0


def test_slope_that_starts_at_a_wall_needs_no_tower() -> None:
    """Use a part that leans out by 40 degrees, whose lower edge is supported by its wall."""
    corners = np.array([(0, y, z) for y in (0, 20) for z in (0, 40)] + [(24, y, 40) for y in (0, 20)], float)
    hull = trimesh.convex.convex_hull(np.vstack([corners, corners - [5.0, 0.0, 0.0]]))
    assert measure_solid(Solid.from_arrays(hull.vertices, hull.faces)).towers_mm == 0.0


@pytest.mark.parametrize("yaw_rad", [0.0, 0.3, 0.8])
def test_thin_wall_that_leans_needs_no_tower(yaw_rad: float) -> None:
    """Use a wall thinner than the distance between columns, so that no column seems to stand on the next."""
    wall = trimesh.creation.box((200.0, 0.8, 120.0))
    wall.apply_transform(trimesh.transformations.rotation_matrix(np.radians(35.0), (1.0, 0.0, 0.0)))
    wall.apply_transform(trimesh.transformations.rotation_matrix(yaw_rad, (0.0, 0.0, 1.0)))
    wall.apply_translation((0.0, 0.0, -wall.bounds[0, 2]))
    result = measure_solid(Solid.from_arrays(wall.vertices, wall.faces))
    assert result.towers_mm < 10.0
    assert result.support_side_mm2 < 1000.0


def test_edge_in_mid_air_needs_a_strip() -> None:
    """Use a wedge at the end of a wall, too steep for support, whose edge is 30 mm above the bed."""
    corners = [(x, y, z) for y in (-1, 60) for x, z in ((0, 30), (-6, 40), (0, 40))]
    hull = trimesh.convex.convex_hull(np.array(corners, float))
    wall = Solid.box((-20, -20, 0), (0, 0, 40))
    result = measure_solid(Solid.union([Solid.from_arrays(hull.vertices, hull.faces), wall]))
    assert result.support_side_mm2 == pytest.approx(2 * 60 * 30, rel=0.1)
    assert result.towers_mm == 0.0


def test_moments_of_a_staircase_are_those_of_its_steps() -> None:
    """Use steps whose tops are inside a slab, on a level, and several slabs apart."""
    heights_mm = (3.0, 10.0, 24.0, 80.0)
    steps = [Solid.box((20.0 * i, 0, 0), (20.0 * i + 20.0, 20, z)) for i, z in enumerate(heights_mm)]
    result = measure_solid(Solid.union(steps))
    for level in range(LEVEL_COUNT):
        level_mm = 80.0 * (level + 1) / LEVEL_COUNT
        volumes_mm3 = np.array([400.0 * min(z, level_mm) for z in heights_mm])
        centres_mm = np.array(
            [(20.0 * i + 10.0, 10.0, min(z, level_mm) / 2.0) for i, z in enumerate(heights_mm)]
        )
        assert result.volumes_mm3[level] == pytest.approx(volumes_mm3.sum(), rel=0.02)
        centre_mm = (volumes_mm3[:, None] * centres_mm).sum(axis=0) / volumes_mm3.sum()
        assert result.centres_mm[level] == pytest.approx(centre_mm, abs=0.5)


def test_supports_are_estimated_from_few_columns(bench: Solid) -> None:
    vertices, faces = bench.arrays()
    result = measure_solid(bench)
    support_mm3, side_mm2, towers_mm = estimate_supports(vertices[faces], float(OVERHANG_COS), 400)
    assert support_mm3 == pytest.approx(result.support_mm3, rel=0.1)
    assert side_mm2 == pytest.approx(result.fine_support_side_mm2, rel=0.15)
    assert towers_mm == result.towers_mm == 0.0
