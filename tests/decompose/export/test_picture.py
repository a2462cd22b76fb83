"""Picture and GLB file of the assembly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from decompose.export import draw_assembly, write_glb
from decompose.export.picture import make_part_colours
from decompose.geometry import Solid
from decompose.results import Part


@pytest.fixture
def parts() -> list[Part]:
    """Make three boxes in a row, and a small one hidden inside the middle one."""
    solids = [Solid.box((100.0 * i, 0, 0), (100.0 * i + 90.0, 90, 90)) for i in range(3)]
    solids.append(Solid.box((140, 40, 40), (150, 50, 50)))
    solids[1] = solids[1].subtract(solids[3])
    return [Part(f"p{i + 1:02d}", solid, np.eye(4), 60.0, "um") for i, solid in enumerate(solids)]


def test_colours_of_parts_differ() -> None:
    colours = make_part_colours(200)
    assert colours.min() >= 0.0 and colours.max() <= 1.0
    assert len(np.unique(np.round(255 * colours), axis=0)) == 200
    distances = np.linalg.norm(np.diff(colours[:100], axis=0), axis=1)
    assert distances.min() > 0.15


def test_glb_has_each_part_in_place_in_metres_with_y_up(parts: list[Part], tmp_path: Path) -> None:
    write_glb(parts, tmp_path / "assembly.glb")
    scene = trimesh.load_scene(tmp_path / "assembly.glb")
    assert sorted(scene.geometry) == ["p01", "p02", "p03", "p04"]
    assert scene.bounds == pytest.approx(np.array([[0.0, 0.0, -0.09], [0.29, 0.09, 0.0]]))
    colours = {tuple(mesh.visual.material.baseColorFactor) for mesh in scene.geometry.values()}
    assert len(colours) == 4
    mesh = scene.geometry["p02"]
    mesh.merge_vertices(merge_norm=True, merge_tex=True)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(parts[1].solid.volume_mm3, rel=1e-5)


def test_picture_shows_visible_parts(parts: list[Part], tmp_path: Path) -> None:
    draw_assembly(parts, tmp_path / "assembly.png", long_side_px=300)
    picture = np.asarray(Image.open(tmp_path / "assembly.png").convert("RGB")).astype(int)
    height_px, width_px, _ = picture.shape
    assert abs(max(height_px, width_px) - 300) <= 1
    part_colours = (255 * make_part_colours(4)).astype(int)
    for part in range(3):  # shading leaves 50 to 100 % of a face's colour
        shares = picture / np.maximum(1, part_colours[part])
        is_similar = (
            (np.ptp(shares, axis=2) < 0.03) & (shares.max(axis=2) > 0.5) & (shares.max(axis=2) < 1.01)
        )
        assert is_similar.sum() > 300
    assert (picture[: height_px // 8] == 255).all(axis=2).mean() > 0.5


def test_picture_names_hidden_parts(
    parts: list[Part], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages: list[str] = []
    monkeypatch.setattr("decompose.export.picture.fill", lambda text, width_px: messages.append(text) or text)
    draw_assembly(parts, tmp_path / "assembly.png", long_side_px=300)
    assert messages == ["behind: 4"]
