"""Holes and codes that are read only from the shape of a part."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from bench.connectors.part_reader import _read_codes, read_part
from decompose.connectors.marks import LETTER_DEPTH_MM, LETTER_HEIGHT_MM
from decompose.connectors.strokes import GRID_HEIGHT, draw_strokes
from decompose.connectors.tools import make_groove
from decompose.geometry import Solid

SLIT_MM = 0.004


def test_hole_that_meets_a_slit_between_triangles_is_read(tmp_path: Path) -> None:
    """Read a hole whose ring is open because rounding in the file has left a slit."""
    block = Solid.box((0, 0, 0), (40, 40, 10)).subtract(Solid.box((18.4, 18.4, 4), (21.6, 21.6, 11)))
    halves = [
        block.intersect(Solid.box((-1, -1, -1), (20.0 - SLIT_MM, 41, 11))),
        block.intersect(Solid.box((20.0, -1, -1), (41, 41, 11))),
    ]
    meshes = [trimesh.Trimesh(*half.arrays(), process=False) for half in halves]
    path = tmp_path / "p01.stl"
    trimesh.util.concatenate(meshes).export(path)
    faces = [face for face in read_part(path, "1", ["2"], 2.85) if face.normal[2] > 0.9]
    assert [hole.reach_mm for face in faces for hole in face.holes] == [pytest.approx(6.0)]


def test_groove_is_read_with_half_the_length_of_its_key(tmp_path: Path) -> None:
    depth_mm = 2.15 / np.sqrt(2.0)  # depth for a key of 1.75 mm with a fit of 0.4 mm
    half_length_mm = (8.5 - 2.0 * (depth_mm - 0.875)) / 2.0
    ends = np.array([[20.0 - half_length_mm, 20.0, 10.0], [20.0 + half_length_mm, 20.0, 10.0]])
    groove = make_groove(0, ends, np.array([0.0, 0.0, -1.0]), depth_mm)
    block = Solid.box((0, 0, 0), (40, 40, 10)).subtract(Solid.hull(groove.points_mm))
    trimesh.Trimesh(*block.arrays(), process=False).export(tmp_path / "p01.stl")
    faces = [face for face in read_part(tmp_path / "p01.stl", "1", ["2"], 2.85) if face.normal[2] > 0.9]
    [hole] = [hole for face in faces for hole in face.holes]
    assert hole.is_groove and 4.0 < hole.reach_mm < 4.1
    assert hole.position_mm == pytest.approx([20.0, 20.0, 10.0])


def test_corner_between_groove_sides_is_not_read_as_the_end_of_a_stroke() -> None:
    strokes = draw_strokes("-18") * (LETTER_HEIGHT_MM / GRID_HEIGHT)
    ends, numbers = np.unique(strokes.reshape(-1, 2), axis=0, return_inverse=True)
    faces = np.column_stack([numbers.reshape(-1, 2), numbers.reshape(-1, 2)[:, 0]])
    bottom = np.column_stack([ends, np.full(len(ends), -LETTER_DEPTH_MM)])
    corner = [*(ends[0] - [0.125, 0.0]), -LETTER_DEPTH_MM + 0.11]
    face = shapely.box(-30.0, -30.0, 30.0, 30.0)
    axes, normal = np.eye(3)[:2], np.eye(3)[2]
    vertices = np.vstack([bottom, corner])
    # An 8 has the same corners as a 2, 3, 5 or 6.
    texts = ["-12", "-13", "-15", "-16", "-18"]
    assert _read_codes(vertices, faces, face, axes, normal, 0.0, texts) == {"-18": None}
