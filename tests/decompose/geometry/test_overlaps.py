"""Union of surfaces that intersect themselves."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from decompose.errors import ModelNotSolid
from decompose.geometry import Solid, load_model, overlaps, write_stl
from decompose.geometry.overlaps import find_overlaps, resolve_overlaps
from decompose.pieces import cut_box

RADIUS_MM = 12.0


def make_crossing_tube(distance_mm: float, rings: int = 60, sides: int = 12) -> Solid:
    """Build a closed tube along a figure of eight, whose two branches cross at a given distance."""
    angles_rad = np.linspace(0.0, 2.0 * np.pi, rings, endpoint=False)
    middle = np.stack(
        [90.0 * np.sin(angles_rad), 60.0 * np.sin(2.0 * angles_rad), distance_mm / 2.0 * np.cos(angles_rad)],
        axis=1,
    )
    tangents = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    side = np.cross(tangents, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1)[:, None]
    side_angles_rad = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)[None, :, None]
    ring = (
        np.cos(side_angles_rad) * side[:, None] + np.sin(side_angles_rad) * np.cross(side, tangents)[:, None]
    )
    vertices = (middle[:, None] + RADIUS_MM * ring).reshape(-1, 3)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij"))
    below, above = sides * i, sides * ((i + 1) % rings)
    next_index = (j + 1) % sides
    corners = below + j, below + next_index, above + next_index, above + j
    faces = np.concatenate(
        [np.stack([corners[k] for k in order], axis=1) for order in ((0, 1, 2), (0, 2, 3))]
    )
    tube = Solid.from_arrays(vertices, faces)
    return tube if tube.volume_mm3 > 0.0 else Solid.from_arrays(vertices, faces[:, ::-1])


def compute_shared_mm3(solid: Solid) -> float:
    """Compute the volume that pieces of a solid share in a box around the crossing."""
    pieces = cut_box(solid, (-40.0, -40.0, -40.0), (40.0, 40.0, 40.0))
    return sum(a.solid.intersect(b.solid).volume_mm3 for a, b in combinations(pieces, 2))


@pytest.mark.parametrize("distance_mm", [1.0, 6.0, 20.0])
def test_branches_that_intersect_count_once(distance_mm: float) -> None:
    tube = make_crossing_tube(distance_mm)
    overlap_mm3 = find_overlaps(tube).volume_mm3
    assert overlap_mm3 == pytest.approx(compute_shared_mm3(tube), rel=0.05)
    solid, resolved_mm3 = resolve_overlaps(tube)
    assert resolved_mm3 == pytest.approx(overlap_mm3, rel=0.05)
    assert solid.volume_mm3 == pytest.approx(tube.volume_mm3 - compute_shared_mm3(tube), rel=1e-3)
    assert compute_shared_mm3(solid) < 1e-3
    assert len(solid.list_pieces()) == 1
    assert np.allclose(solid.bounds_mm, tube.bounds_mm)


def test_whole_surface_is_cut_once_for_many_crossings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    row = Solid.union([make_crossing_tube(6.0).translate(np.array([0.0, 400.0 * n, 0.0])) for n in range(3)])
    subtract, cuts = Solid.subtract, []
    monkeypatch.setattr(Solid, "subtract", lambda self, other: cuts.append(self) or subtract(self, other))
    solid, resolved_mm3 = resolve_overlaps(row)
    assert resolved_mm3 == pytest.approx(3.0 * compute_shared_mm3(make_crossing_tube(6.0)), rel=0.1)
    assert sum(cut is row for cut in cuts) == 1
    assert len(solid.list_pieces()) == 3


def keep_last_body(self: Solid, other_solid: Solid) -> Solid:
    return max(
        (self.intersect(piece) for piece in self.list_pieces()), key=lambda piece: piece.bounds_mm[0, 0]
    )


def raise_error(self: Solid, other_solid: Solid) -> Solid:
    raise ModelNotSolid("subtracting a solid: the triangles bound no solid")


@pytest.mark.parametrize("subtract", [keep_last_body, raise_error])
def test_failed_operation_leaves_the_model_unchanged(
    monkeypatch: pytest.MonkeyPatch, subtract: Callable[[Solid, Solid], Solid]
) -> None:
    bodies = Solid.union([make_crossing_tube(6.0), Solid.box((300.0, 0.0, 0.0), (340.0, 40.0, 40.0))])
    monkeypatch.setattr(Solid, "subtract", subtract)
    assert resolve_overlaps(bodies) == (bodies, 0.0)


def test_separate_branches_stay_unchanged(ring_with_bar: Solid) -> None:
    for solid in (make_crossing_tube(40.0), ring_with_bar, Solid.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))):
        assert resolve_overlaps(solid) == (solid, 0.0)


def test_shell_with_a_cavity_does_not_overlap_itself() -> None:
    shell = Solid.box((0.0, 0.0, 0.0), (9.0, 9.0, 9.0)).subtract(Solid.box((2.0, 2.0, 2.0), (7.0, 7.0, 7.0)))
    assert find_overlaps(shell).volume_mm3 == 0.0


def test_sliver_is_searched_with_few_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    shapes = []
    search = overlaps.find_crossings
    monkeypatch.setattr(
        overlaps, "find_crossings", lambda *args: shapes.append(args[2].shape) or search(*args)
    )
    assert find_overlaps(Solid.box((0.0, 0.0, 0.0), (1e-7, 100.0, 5.0))).volume_mm3 == 0.0
    assert np.prod(shapes[0]) <= 2 * overlaps.RAY_COUNT


def test_loaded_model_reports_united_bodies(tmp_path: Path) -> None:
    vertices, faces = make_crossing_tube(6.0).arrays()
    path = tmp_path / "eight.stl"
    write_stl(path, vertices[faces].astype(np.float32))
    model = load_model(path)
    assert any(text.startswith("United bodies that intersected") for text in model.repairs)
    assert compute_shared_mm3(model.solid) < 1e-3
