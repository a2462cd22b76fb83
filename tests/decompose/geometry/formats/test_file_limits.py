"""Limits on files that would take too much memory or time, which are refused before they are parsed."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from decompose.errors import ModelTooDetailed, ModelUnreadable
from decompose.files.triangle_limit import (
    BYTES_PER_TRIANGLE,
    PROCESS_BYTES,
    check_head,
    compute_max_triangles,
)
from decompose.geometry.formats.file_limits import (
    MAX_CORNERS,
    MAX_PLY_HEADER_BYTES,
    check_limits,
    count_triangles,
)

SPHERE = trimesh.creation.icosphere(2, 10.0)


def make_polygon_file(corners: int, suffix: str, comment: bytes = b"") -> bytes:
    """Make a file with few vertices, and one face with many corners."""
    indices = b" ".join(b"%d" % (1 + i % 3) for i in range(corners))
    match suffix:
        case ".obj":
            return b"%sv 0 0 0\nv 1 0 0\nv 0 1 1\nf %s\nf 1 2 3\n" % (comment, indices)
        case ".off":
            return b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 1\n%d %s\n" % (corners, indices)
    return b"ply\nformat ascii 1.0\nelement face 1\nend_header\n%d %s\n" % (corners, indices)


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply"])
def test_face_of_a_million_corners_is_refused(suffix: str) -> None:
    check_limits("a", make_polygon_file(MAX_CORNERS - 1, suffix), suffix, None)
    with pytest.raises(
        ModelUnreadable, match=r"face with 100000.? corners .limit 10000.; export it with triangles"
    ):
        check_limits("a", make_polygon_file(1_000_000, suffix), suffix, None)


def test_face_on_several_lines_counts_once_and_a_comment_is_ignored() -> None:
    face = make_polygon_file(1_000_000, ".obj").replace(b" 1 2", b" \\\n1 2")
    with pytest.raises(ModelUnreadable, match="1000000 corners"):
        check_limits("a", face, ".obj", None)
    check_limits("a", make_polygon_file(4, ".obj", b"# " + b"words " * MAX_CORNERS + b"\n"), ".obj", None)


def test_binary_ply_of_few_faces_and_many_bytes_is_refused() -> None:
    head = b"ply\nformat binary_little_endian 1.0\nelement face 2\nend_header\n"
    check_limits("a", head + bytes(MAX_CORNERS), ".ply", None)
    with pytest.raises(ModelUnreadable, match="has 2 faces in 8 MB"):
        check_limits("a", head + bytes(8_000_000), ".ply", None)


@pytest.mark.parametrize("data", [b"ply", b"ply\nformat ascii 1.0\n", b"ply\n" + b"comment x\n" * 10_000])
def test_ply_whose_header_does_not_end_is_refused(data: bytes) -> None:
    with pytest.raises(ModelUnreadable, match="no end_header within 64 KiB"):
        check_limits("a", data + b" " * MAX_PLY_HEADER_BYTES + b"end_header\n", ".ply", None)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply", "off"])
def test_triangles_of_each_format_are_counted_and_limited_by_memory(kind: str) -> None:
    content = SPHERE.export(file_type=kind)
    data = content if isinstance(content, bytes) else content.encode()
    suffix = f".{kind[:3]}"
    count = len(SPHERE.faces)
    assert count_triangles(data, suffix) == count
    memory_bytes = PROCESS_BYTES + count * BYTES_PER_TRIANGLE
    check_limits("a", data, suffix, memory_bytes)
    with pytest.raises(ModelTooDetailed, match=r"suffice only for 0.0 million: simplify its mesh"):
        check_limits("a", data, suffix, memory_bytes - 1)


@pytest.mark.parametrize("kind", ["stl", "ply", "off"])
def test_first_bytes_of_a_file_suffice_to_refuse_it(kind: str) -> None:
    content = SPHERE.export(file_type=kind)
    data = content if isinstance(content, bytes) else content.encode()
    head, memory_bytes = data[:400], PROCESS_BYTES + len(SPHERE.faces) * BYTES_PER_TRIANGLE
    check_head("a", head, len(data), f".{kind}", memory_bytes)
    with pytest.raises(ModelTooDetailed, match=r"a: has 0.0 million triangles.*simplify its mesh"):
        check_head("a", head, len(data), f".{kind}", memory_bytes - 1)


@given(st.binary(max_size=200), st.integers(0, 2**40), st.sampled_from([".stl", ".ply", ".off", ".3mf", ""]))
def test_any_first_bytes_pass_or_have_too_many_triangles(head: bytes, size_bytes: int, suffix: str) -> None:
    try:
        check_head("a", head, size_bytes, suffix, PROCESS_BYTES)
    except ModelTooDetailed as error:
        assert len(str(error).splitlines()) == 1


def test_stl_with_missing_triangles_passes_the_limit_check() -> None:
    check_head("a", b"\0" * 80 + b"\xff" * 4, 134, ".stl", PROCESS_BYTES + BYTES_PER_TRIANGLE)


def test_limit_without_memory_allows_no_triangle() -> None:
    assert compute_max_triangles(0) == 0
    assert np.isclose(compute_max_triangles(4 * 2**30) / 1e6, 2.7, atol=0.05)
