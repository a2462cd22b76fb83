"""Parts as they are drawn: detailed ones are simplified, within a small tolerance."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from decompose.export.drawn_parts import MAX_DRAWN_FACES, simplify_parts
from decompose.geometry import Solid
from decompose.results import Part


def test_only_detailed_parts_are_simplified() -> None:
    ball = trimesh.creation.icosphere(7, 100.0)
    detailed_part = Part("p01", Solid.from_arrays(ball.vertices, ball.faces), np.eye(4), 60.0, "um")
    plain_part = Part("p02", Solid.box((0, 0, 110), (9, 9, 120)), np.eye(4), 60.0, "um")
    assert detailed_part.solid.face_count > MAX_DRAWN_FACES
    drawn_part, same_part = simplify_parts([detailed_part, plain_part])
    assert same_part is plain_part
    assert drawn_part.solid.face_count < 0.1 * detailed_part.solid.face_count
    assert abs(drawn_part.solid.volume_mm3 / detailed_part.solid.volume_mm3 - 1.0) < 2e-3
    drawn_vertices, _ = drawn_part.solid.arrays()
    assert np.abs(np.linalg.norm(drawn_vertices, axis=1) - 100.0).max() < 0.04


def test_part_of_which_nothing_would_remain_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("decompose.export.drawn_parts.MAX_DRAWN_FACES", 0)
    tiny_part = Part("p01", Solid.box((0, 0, 0), (0.01, 0.01, 0.01)), np.eye(4), 60.0, "um")
    assert tiny_part.solid.simplify(0.1).face_count == 0
    large_part = Part("p02", Solid.box((0, 0, 1), (1000, 1000, 900)), np.eye(4), 60.0, "um")
    drawn_parts = simplify_parts([tiny_part, large_part])
    assert [part.solid.face_count for part in drawn_parts] == [12, 12]
