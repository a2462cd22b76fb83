"""Common vertices and edges of triangles, found in little memory."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from decompose.geometry import load_model
from decompose.geometry.weld import (
    SAME_VERTEX_MM,
    count_edge_uses,
    number_rows,
    select_distinct_faces,
    weld_triangles,
)

FACES = st.lists(st.tuples(*[st.integers(0, 5)] * 3), min_size=1, max_size=20)
PEAK_BYTES_PER_TRIANGLE = 300
"""Size of all arrays in memory at once: the file, its triangles as doubles, the numbers of their corners."""


@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 3), min_size=1, max_size=60))
def test_rows_have_one_number_for_each_value_in_order_of_first_occurrence(
    rows: list[tuple[int, int, int]],
) -> None:
    numbers, first_rows = number_rows(np.array(rows), 1.0)
    distinct_values = list(dict.fromkeys(rows))
    assert [rows[i] for i in first_rows] == distinct_values
    assert [distinct_values[number] for number in numbers] == rows


def test_more_rows_than_the_first_table_holds_are_numbered() -> None:
    rows = np.random.default_rng(1).integers(0, 40, (20_000, 3)).astype(np.float64)
    numbers, first_rows = number_rows(rows, 1.0)
    assert len(first_rows) == len(np.unique(rows, axis=0))
    np.testing.assert_array_equal(rows[first_rows][numbers], rows)


def test_vertices_that_differ_by_rounding_are_the_same() -> None:
    rows = np.array(
        [[0.0, 1.0, 2.0], [-0.0, 1.0 + 0.2 * SAME_VERTEX_MM, 2.0], [0.0, 1.0 + 2 * SAME_VERTEX_MM, 2.0]]
    )
    assert number_rows(rows, 1.0 / SAME_VERTEX_MM)[0].tolist() == [0, 0, 1]


@given(FACES)
def test_edge_uses_equal_an_edge_by_edge_count(faces: list[tuple[int, int, int]]) -> None:
    distinct_faces = select_distinct_faces(np.array(faces))
    directed_edges = [(f[k], f[(k + 1) % 3]) for f in distinct_faces.tolist() for k in range(3)]
    undirected_edges = [tuple(sorted(edge)) for edge in directed_edges]
    counts = [undirected_edges.count(edge) for edge in set(undirected_edges)]
    uses = count_edge_uses(distinct_faces)
    assert uses.single_count == counts.count(1)
    assert uses.nonmanifold_count == sum(count > 2 for count in counts)
    assert uses.repeated_count == len(directed_edges) - len(set(directed_edges))


@given(FACES)
def test_collapsed_and_repeated_faces_are_dropped(faces: list[tuple[int, int, int]]) -> None:
    distinct_values = {}
    for a, b, c in faces:
        if len({a, b, c}) == 3:
            distinct_values.setdefault(min((a, b, c), (b, c, a), (c, a, b)), (a, b, c))
    assert [tuple(f) for f in select_distinct_faces(np.array(faces)).tolist()] == list(
        distinct_values.values()
    )


def test_reversed_face_has_repeated_edges_in_a_closed_surface() -> None:
    box = trimesh.creation.box()
    faces = np.array(box.faces)
    assert count_edge_uses(faces).is_closed
    assert not count_edge_uses(faces).repeated_count
    faces[0] = faces[0][::-1]
    assert count_edge_uses(faces).is_closed
    assert count_edge_uses(faces).repeated_count == 3
    assert not count_edge_uses(faces[1:]).is_closed


def test_closed_surface_is_welded_without_a_repair() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=50.0)
    surface = weld_triangles(np.array(ball.triangles))
    assert len(surface.vertices) == len(ball.vertices)
    assert len(surface.faces) == len(ball.faces)
    assert surface.repairs == ()


def test_large_model_is_read_in_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "ball.stl"
    ball = trimesh.creation.icosphere(subdivisions=6, radius=50.0)
    ball.export(path)
    load_model(path)  # load the compiled code first
    tracemalloc.start()
    try:
        model = load_model(path)
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert model.solid.face_count == len(ball.faces)
    assert peak_bytes < PEAK_BYTES_PER_TRIANGLE * len(ball.faces)
