"""Hostile files and invalid sizes, which are refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from decompose.errors import (
    DecomposeError,
    ModelHuge,
    ModelNotSolid,
    ModelTiny,
    ModelTooDetailed,
    ModelUnreadable,
)
from decompose.geometry import load_model, write_stl


def make_ball(radius_mm: float = 20.0) -> np.ndarray:
    return np.array(trimesh.creation.icosphere(3, radius_mm).triangles)


def write_obj(path: Path, triangles: np.ndarray) -> Path:
    """Write an OBJ file, which keeps coordinates in double precision."""
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in triangles.reshape(-1, 3).tolist())
    faces = "".join(f"f {i + 1} {i + 2} {i + 3}\n" for i in range(0, 3 * len(triangles), 3))
    path.write_text(corners + faces)
    return path


@pytest.mark.parametrize("factor", [1e-300, 1e-160, 1e-30, 1e10, 1e30, 1e38, 1e160, 1e300])
def test_any_unit_is_accepted_with_a_longest_side(tmp_path: Path, factor: float) -> None:
    path = write_obj(tmp_path / "unit.obj", make_ball() * factor)
    model = load_model(path, longest_side_mm=100.0)
    assert model.extents_mm.max() == pytest.approx(100.0)
    with pytest.raises((ModelTiny, ModelHuge)) as error:
        load_model(path, scale=1.0)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("offset_mm", [1e8, 1e10, 1e12])
def test_model_far_from_the_origin_is_refused(tmp_path: Path, offset_mm: float) -> None:
    with pytest.raises(ModelHuge, match="origin"):
        load_model(write_obj(tmp_path / "far.obj", make_ball() + offset_mm))
    assert load_model(write_obj(tmp_path / "near.obj", make_ball() + 1e4)).repairs == ()


@pytest.mark.parametrize(
    ("scale", "longest_side_mm", "error"),
    [
        (1e-12, None, ModelTiny),
        (1e-300, None, ModelTiny),
        (1e300, None, ModelHuge),
        (1e308, None, ModelHuge),
        (10**400, None, ModelUnreadable),
        (None, 1e-9, ModelTiny),
        (None, 5e-324, ModelTiny),
        (None, 1e9, ModelHuge),
        (None, 1e300, ModelHuge),
    ],
)
def test_invalid_sizes_are_refused(
    tmp_path: Path, scale: float | None, longest_side_mm: float | None, error: type[DecomposeError]
) -> None:
    path = tmp_path / "ball.stl"
    write_stl(path, make_ball().astype(np.float32))
    with pytest.raises(error) as error_info:
        load_model(path, scale=scale, longest_side_mm=longest_side_mm)
    assert "\n" not in str(error_info.value)


def test_tiny_model_with_a_distant_point_is_refused(tmp_path: Path) -> None:
    """Use a model of two tiny balls that are far from each other."""
    tiny_balls = np.concatenate([make_ball(1e-10), make_ball(1e-10) + 50.0])
    with pytest.raises(ModelNotSolid):
        load_model(write_obj(tmp_path / "tiny.obj", tiny_balls))


def test_model_with_a_million_repeated_vertices_is_read(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(3, 20.0)
    copies = 1_000_000 // len(sphere.vertices) + 1
    indices = len(sphere.vertices) * np.random.default_rng(0).integers(0, copies, sphere.faces.shape)
    many_spheres = trimesh.Trimesh(
        np.tile(sphere.vertices, (copies, 1)), sphere.faces + indices, process=False
    )
    many_spheres.export(tmp_path / "copies.ply")
    model = load_model(tmp_path / "copies.ply")
    assert model.solid.volume_mm3 == pytest.approx(sphere.volume, rel=1e-4)


INVALID_FILES = {
    "missing.obj": b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 9\n",
    "before.obj": b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf -1 -2 -9\n",
    "beyond.obj": b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 99999999999999999999\n",
    "bytes.obj": b"\xff\xfe\x00" * 100 + b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n",
    "count.off": b"OFF\n999999999 3 0\n0 0 0\n",
    "index.off": b"OFF\n3 1 0\n0 0 0\n9 0 0\n0 9 0\n3 0 1 7\n",
    "line.stl": b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0\nvertex 9 0 0\nendsolid a\n",
}


@pytest.mark.parametrize("name", sorted(INVALID_FILES))
def test_files_with_invalid_content_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(INVALID_FILES[name])
    with pytest.raises(DecomposeError) as error:
        load_model(tmp_path / name)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith(name)
    assert "No module" not in str(error.value)


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
@pytest.mark.parametrize(
    ("true_count", "false_count"),
    [
        (b"vertex 642", b"vertex 999999999999"),
        (b"vertex 642", b"vertex -5"),
        (b"vertex 642", b"vertex 10"),
        (b"face 1280", b"face 3"),
        (b"face 1280", b"face x"),
        (b"float x", b"list uchar int x"),
        (b"property float z\n", b""),
    ],
)
def test_ply_with_a_false_header_is_refused(
    tmp_path: Path, encoding: str, true_count: bytes, false_count: bytes
) -> None:
    path = tmp_path / "false.ply"
    trimesh.creation.icosphere(3, 20.0).export(path, encoding=encoding)
    data = path.read_bytes()
    assert true_count in data
    path.write_bytes(data.replace(true_count, false_count, 1))
    with pytest.raises(DecomposeError, match=r"^false\.ply: ") as error:
        load_model(path)
    assert "\n" not in str(error.value)


def test_bytes_after_the_triangles_of_an_stl_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "ball.stl"
    write_stl(path, make_ball().astype(np.float32))
    reference = load_model(path)
    path.write_bytes(path.read_bytes() + b"metadata of a program")
    model = load_model(path)
    assert model.repairs == ("Left out 21 bytes after the last triangle.",)
    assert model.solid.volume_mm3 == reference.solid.volume_mm3


def test_steps_of_reading_and_repair_are_reported(tmp_path: Path) -> None:
    path, steps = tmp_path / "ball.stl", []
    write_stl(path, make_ball().astype(np.float32))
    load_model(path, report=steps.append)
    assert steps == ["reading", "checking its surface"]
    open_ball = np.delete(make_ball(), [0, 1, 5], axis=0)
    write_stl(path, np.concatenate([open_ball, make_ball() + 60.0]).astype(np.float32))
    load_model(path, report=steps.append)
    assert "repairing body 1 of 2" in steps
    assert "joining 2 bodies" in steps


def test_model_with_more_triangles_than_memory_allows_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path, steps = tmp_path / "ball.stl", []
    write_stl(path, np.tile(make_ball(), (1000, 1, 1)).astype(np.float32))  # 1,280,000 triangles
    with pytest.raises(
        ModelTooDetailed, match=r"1\.3 million triangles.*1\.0 GB.*suffice only for 0\.5 million"
    ):
        load_model(path, memory_bytes=2**30, report=steps.append)
    assert steps == ["reading"]
