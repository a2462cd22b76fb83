"""STL files of surfaces that touch themselves: solids and hollows with a common edge."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from decompose.decompose import decompose_model
from decompose.export import write_parts
from decompose.geometry import Model, Solid, round_triangles, separate_touching_surfaces, write_stl
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter

GAP_MM = 1e-4


def make_touching_blocks(size_mm: float) -> Solid:
    """Make two blocks on a plate, which touch along an upright edge."""
    s = size_mm
    plate = Solid.box((0, 0, 0), (2 * s, 2 * s, s / 2))
    return Solid.union(
        [plate, Solid.box((0, 0, s / 4), (s, s, 2 * s)), Solid.box((s, s, s / 4), (2 * s, 2 * s, 2 * s))]
    )


def make_touching_hollows(size_mm: float) -> Solid:
    """Make a block with two hollows, which touch along an upright edge."""
    s = size_mm
    block = Solid.box((-s, -s, 0), (3 * s, 3 * s, 2 * s))
    hollow = Solid.box((0, 0, s / 2), (s, s, 1.5 * s))
    return block.subtract(hollow).subtract(Solid.box((s, s, s / 2), (2 * s, 2 * s, 1.5 * s)))


@pytest.mark.parametrize("make_solid", [make_touching_blocks, make_touching_hollows])
def test_touching_surfaces_are_separated(make_solid: Callable[[float], Solid], tmp_path: Path) -> None:
    solid = make_solid(10.0)
    vertices, faces = solid.arrays()
    assert round_triangles(vertices, faces) is None
    separated = separate_touching_surfaces(vertices, faces, GAP_MM)
    corners = round_triangles(separated, faces)
    assert corners is not None
    write_stl(tmp_path / "p.stl", corners)
    mesh: Any = trimesh.load(tmp_path / "p.stl", force="mesh")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(solid.volume_mm3, rel=1e-5)
    moved = np.linalg.norm(separated - vertices, axis=1)
    assert 2 <= np.count_nonzero(moved) <= 4  # ends of the common edge that two surfaces share
    assert moved[moved > 0.0] == pytest.approx(GAP_MM)
    lo_mm, hi_mm = solid.bounds_mm
    assert ((separated >= lo_mm) & (separated <= hi_mm)).all()


def test_separated_surfaces_do_not_cross() -> None:
    """Widen the gap until it can be measured: blocks become smaller, and hollows as well."""
    edge = Solid.box((9.8, 9.8, 7.0), (10.2, 10.2, 13.0))
    for make_solid, volume_sign, pieces_at_edge in (
        (make_touching_blocks, -1.0, 2),
        (make_touching_hollows, 1.0, 1),
    ):
        solid = make_solid(10.0)
        vertices, faces = solid.arrays()
        separated = Solid.from_arrays(separate_touching_surfaces(vertices, faces, 0.3), faces)
        assert volume_sign * (separated.volume_mm3 - solid.volume_mm3) > 1.0
        assert len(separated.intersect(edge).list_pieces()) == pieces_at_edge


def test_model_with_a_touching_edge_is_cut_and_written(cost: CostModel, tmp_path: Path) -> None:
    model = Model(make_touching_blocks(100.0), (), 1.0)
    printers = [TargetPrinter(f"um-{i}", ((250.0, 250.0, 220.0),)) for i in range(4)]
    result = decompose_model(model, printers, Options(Engine.GUILLOTINE, 4, prove=False), cost)
    written = write_parts(result, tmp_path)
    for part in written.parts:
        mesh: Any = trimesh.load(tmp_path / part.file, force="mesh")
        assert mesh.is_watertight
