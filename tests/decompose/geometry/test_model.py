"""Reading of model files, which are repaired with a report, or refused in one line."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from decompose.errors import (
    DecomposeError,
    ModelEmpty,
    ModelFlat,
    ModelNotFinite,
    ModelNotSolid,
    ModelTiny,
    ModelUnreadable,
)
from decompose.geometry import Solid, load_model, write_stl
from decompose.geometry.repair import MAX_BODIES

MODELS = Path(os.environ.get("FARM_MODELS", Path(__file__).parents[3] / "shared" / "models"))


def make_block(lo: tuple[float, float, float], hi: tuple[float, float, float]) -> np.ndarray:
    vertices, faces = Solid.box(lo, hi).arrays()
    return vertices[faces]


def make_ball(radius_mm: float = 20.0) -> np.ndarray:
    return np.array(trimesh.creation.icosphere(3, radius_mm).triangles)


def save_stl(path: Path, triangles: np.ndarray) -> Path:
    with np.errstate(invalid="ignore"):  # some files contain values that are not numbers
        write_stl(path, triangles.astype(np.float32))
    return path


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".off"])
def test_every_format_is_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"ball{suffix}"
    trimesh.creation.icosphere(2, 30.0).export(path)
    model = load_model(path)
    assert model.solid.volume_mm3 == pytest.approx(trimesh.creation.icosphere(2, 30.0).volume, rel=1e-4)
    assert model.repairs == ()
    assert model.scale == 1.0
    assert model.mesh.is_watertight


def test_ascii_stl_is_read_and_a_truncated_one_is_refused(tmp_path: Path) -> None:
    text = trimesh.exchange.stl.export_stl_ascii(trimesh.creation.box((10.0, 20.0, 30.0)))
    path = tmp_path / "a.stl"
    path.write_text(text)
    assert load_model(path).solid.volume_mm3 == pytest.approx(6000.0)
    path.write_text(text[: len(text) // 2])
    with pytest.raises(ModelUnreadable, match="ends too early"):
        load_model(path)


def test_scale_and_longest_side_set_the_size(tmp_path: Path) -> None:
    path = save_stl(tmp_path / "b.stl", make_block((0, 0, 0), (10, 20, 40)))
    assert load_model(path, longest_side_mm=260.0).extents_mm == pytest.approx([65.0, 130.0, 260.0])
    model = load_model(path, scale=25.4)
    assert model.scale == 25.4
    assert model.extents_mm == pytest.approx([254.0, 508.0, 1016.0])
    with pytest.raises(ModelUnreadable, match="exclude each other"):
        load_model(path, scale=2.0, longest_side_mm=3.0)
    for scale in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ModelUnreadable, match="--scale"):
            load_model(path, scale=scale)


def test_model_in_metres_needs_a_scale(tmp_path: Path) -> None:
    path = save_stl(tmp_path / "metres.stl", make_block((0, 0, 0), (0.1, 0.2, 0.26)))
    with pytest.raises(ModelTiny, match=r"--longest-side MM, or --scale 1000 if it is in metres") as error:
        load_model(path)
    assert "\n" not in str(error.value)
    assert load_model(path, scale=1000.0).extents_mm.max() == pytest.approx(260.0)


def damage_file(path: Path, change: Callable[[bytes], bytes]) -> Path:
    save_stl(path, make_ball())
    path.write_bytes(change(path.read_bytes()))
    return path


def test_unreadable_and_empty_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelUnreadable, match="cannot be read"):
        load_model(tmp_path / "nowhere.stl")
    with pytest.raises(ModelUnreadable, match="cannot be read"):
        load_model(tmp_path)
    (tmp_path / "a.doc").write_text("a")
    with pytest.raises(ModelUnreadable, match="not a known kind"):
        load_model(tmp_path / "a.doc")
    (tmp_path / "e.stl").touch()
    with pytest.raises(ModelEmpty):
        load_model(tmp_path / "e.stl")
    save_stl(tmp_path / "none.stl", np.zeros((0, 3, 3)))
    with pytest.raises(ModelEmpty):
        load_model(tmp_path / "none.stl")
    save_stl(tmp_path / "points.stl", np.zeros((7, 3, 3)))
    with pytest.raises(ModelEmpty):
        load_model(tmp_path / "points.stl")
    with pytest.raises(ModelUnreadable, match="header states 1280 triangles, the file holds 6"):
        load_model(damage_file(tmp_path / "half.stl", lambda b: b[: len(b) // 2]))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=600), suffix=st.sampled_from([".stl", ".obj", ".ply", ".off"]))
def test_random_bytes_are_refused_in_one_line(tmp_path: Path, data: bytes, suffix: str) -> None:
    path = tmp_path / f"random{suffix}"
    path.write_bytes(data)
    with pytest.raises(DecomposeError) as error:
        load_model(path)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("random")


def test_coordinates_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    for coordinate in (np.nan, np.inf):
        triangles = make_ball()
        triangles[5, 1, 2] = coordinate
        with pytest.raises(ModelNotFinite, match="1 of 1280"):
            load_model(save_stl(tmp_path / "nan.stl", triangles))


def test_flat_model_is_refused(tmp_path: Path) -> None:
    sheet = make_block((0, 0, 0), (50, 50, 1))
    sheet[..., 2] = 3.0
    with pytest.raises(ModelFlat, match="along z"):
        load_model(save_stl(tmp_path / "flat.stl", sheet))


def test_loose_triangles_are_refused(tmp_path: Path) -> None:
    soup = np.random.default_rng(3).uniform(0.0, 100.0, (80, 3, 3))
    with pytest.raises(ModelNotSolid, match="loose"):
        load_model(save_stl(tmp_path / "soup.stl", soup))


def test_many_loose_triangles_are_refused_before_the_repair(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse_call(body: object) -> None:
        raise AssertionError("bodies were closed one by one")

    monkeypatch.setattr("decompose.geometry.repair._run_mesh_fix", refuse_call)
    soup = np.random.default_rng(3).uniform(0.0, 100.0, (12_000, 3, 3))
    with pytest.raises(ModelNotSolid, match="12000 loose surfaces") as error:
        load_model(save_stl(tmp_path / "soup.stl", soup))
    assert str(MAX_BODIES) in str(error.value)
    assert "\n" not in str(error.value)


def test_hundreds_of_bodies_become_one_solid(tmp_path: Path) -> None:
    cubes = [
        make_block((x, y, z), (x + 6.0, y + 6.0, z + 6.0))
        for x in range(0, 70, 10) for y in range(0, 70, 10) for z in range(0, 140, 10)
    ]  # fmt: skip
    cubes[5] = cubes[5][1:]  # one of them is open
    model = load_model(save_stl(tmp_path / "many.stl", np.concatenate(cubes)))
    assert model.solid.volume_mm3 == pytest.approx(len(cubes) * 216.0)
    assert any(f"{len(cubes)} bodies" in r for r in model.repairs)
    assert any("3 open edges" in r for r in model.repairs)


def test_half_a_model_is_refused(tmp_path: Path) -> None:
    triangles = make_ball()
    half_ball = triangles[triangles[:, :, 2].mean(axis=1) > 0.0]
    with pytest.raises(ModelNotSolid, match="half a model"):
        load_model(save_stl(tmp_path / "half.stl", half_ball))


def test_small_holes_are_closed(tmp_path: Path) -> None:
    triangles = np.delete(make_ball(), [10, 500, 900], axis=0)
    model = load_model(save_stl(tmp_path / "holes.stl", triangles))
    (message,) = model.repairs
    assert "9 open edges" in message
    assert model.mesh.is_watertight
    assert model.solid.volume_mm3 == pytest.approx(trimesh.creation.icosphere(3, 20.0).volume, rel=1e-3)


def test_inverted_model_is_turned_outwards(tmp_path: Path) -> None:
    model = load_model(save_stl(tmp_path / "inverted.stl", make_ball()[:, ::-1]))
    assert model.solid.volume_mm3 > 0.0
    assert model.repairs == ("Turned the model inside out: its triangles faced inwards.",)


def test_inverted_triangles_are_reversed(tmp_path: Path) -> None:
    triangles = make_ball()
    triangles[40:60] = triangles[40:60, ::-1]
    model = load_model(save_stl(tmp_path / "mixed.stl", triangles))
    assert model.solid.volume_mm3 == pytest.approx(trimesh.creation.icosphere(3, 20.0).volume, rel=1e-3)
    assert any("wrong way" in r for r in model.repairs)


def test_repeated_triangles_are_dropped(tmp_path: Path) -> None:
    triangles = np.concatenate([make_ball(), make_ball()[:5], np.zeros((2, 3, 3))])
    model = load_model(save_stl(tmp_path / "twice.stl", triangles))
    assert model.repairs == ("Dropped 7 triangles that had collapsed or were given twice.",)


def test_bodies_are_joined_and_cavities_are_kept(tmp_path: Path) -> None:
    separate_blocks = [
        make_block((0, 0, 0), (10, 10, 10)),
        make_block((5, 5, 5), (15, 15, 15)),
        make_block((30, 0, 0), (40, 10, 10)),
    ]
    model = load_model(save_stl(tmp_path / "three.stl", np.concatenate(separate_blocks)))
    assert model.solid.volume_mm3 == pytest.approx(2000.0 - 125.0 + 1000.0)
    assert any("3 bodies" in r for r in model.repairs)
    nested_blocks = [
        make_block((0, 0, 0), (40, 40, 40)),
        make_block((5, 5, 5), (35, 35, 35))[:, ::-1],
        make_block((15, 15, 15), (25, 25, 25)),
    ]
    model = load_model(save_stl(tmp_path / "nested.stl", np.concatenate(nested_blocks)))
    assert model.solid.volume_mm3 == pytest.approx(64_000.0 - 27_000.0 + 1000.0)
    triangles = [make_block((0, 0, 0), (20, 20, 20)), make_block((30, 0, 0), (40, 10, 10))[:, ::-1]]
    model = load_model(save_stl(tmp_path / "turned.stl", np.concatenate(triangles)))
    assert model.solid.volume_mm3 == pytest.approx(9000.0)
    assert any("1 of 2 bodies" in r for r in model.repairs)


def test_messages_use_the_given_name_of_a_file(tmp_path: Path) -> None:
    path = save_stl(tmp_path / "3fa9c1", make_ball())
    assert load_model(path, name="My Ball.STL").repairs == ()
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ModelUnreadable, match=r"^My Ball\.STL: its header states"):
        load_model(path, name="My Ball.STL")
    # If a package that guesses encodings is installed, these bytes are read as text without triangles.
    with pytest.raises((ModelUnreadable, ModelEmpty), match=r"^ball\.obj: "):
        load_model(path, name="ball.obj")
    with pytest.raises(ModelUnreadable, match=r"^notes\.txt: not a known kind"):
        load_model(path, name="notes.txt")
    with pytest.raises(ModelUnreadable, match=r"^3fa9c1: not a known kind"):
        load_model(path)
    with pytest.raises(ModelUnreadable, match=r"^gone\.stl: cannot be read"):
        load_model(tmp_path / "nowhere", name="gone.stl")
    with pytest.raises(ModelUnreadable, match=r"^two\?lines\.stl: ") as error:
        load_model(path, name="two\nlines.stl")
    assert "\n" not in str(error.value)
    with pytest.raises(ModelUnreadable, match="cannot be read"):
        load_model(Path("nul\0byte.stl"))


@pytest.mark.skipif(not MODELS.is_dir(), reason="the real model files are not available")
@pytest.mark.parametrize(
    ("name", "side_mm", "message"),
    [
        ("stanford-bunny.stl", 260.0, "223 open edges"),
        ("3DBenchy.stl", None, "Dropped"),
        ("multibody.stl", 100.0, "2 bodies"),
        ("thingi10k-41084.stl", 200.0, "Dropped"),
        ("fandisk.stl", 100.0, None),
    ],
)
def test_real_models_are_read(name: str, side_mm: float | None, message: str | None) -> None:
    model = load_model(MODELS / name, longest_side_mm=side_mm)
    assert model.mesh.is_watertight
    if side_mm:
        assert model.extents_mm.max() == pytest.approx(side_mm, rel=0.02)
    assert any(message in r for r in model.repairs) if message else model.repairs == ()


@pytest.mark.skipif(not MODELS.is_dir(), reason="the real model files are not available")
def test_unusable_real_models_are_refused() -> None:
    with pytest.raises(ModelTiny, match="metres"):
        load_model(MODELS / "stanford-bunny.stl")
    with pytest.raises(ModelNotSolid, match="loose"):
        load_model(MODELS / "soup.stl", longest_side_mm=100.0)
