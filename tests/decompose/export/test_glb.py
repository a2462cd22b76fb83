"""Animation of the assembly in its GLB, read according to glTF 2.0 without the library that writes it."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decompose.assembly import Assembly, plan_assembly
from decompose.export.glb import find_movements_mm, find_offsets, write_glb
from decompose.geometry import Solid
from decompose.pieces import find_joints, list_box_planes
from decompose.results import Part


@pytest.fixture(scope="module")
def parts() -> list[Part]:
    """Make four quarters of a slab."""
    spans = [((x, y, 0.0), (x + 30.0, y + 30.0, 20.0)) for x in (0.0, 30.0) for y in (0.0, 30.0)]
    return [
        Part(f"p{i + 1:02d}", Solid.box(*span), np.eye(4), 60.0, "um", planes=list_box_planes(np.array(span)))
        for i, span in enumerate(spans)
    ]


@pytest.fixture(scope="module")
def assembly(parts: list[Part]) -> Assembly:
    return plan_assembly(parts, find_joints(parts))


def read_glb(path: Path) -> tuple[dict[str, Any], bytes]:
    data = path.read_bytes()
    magic, version, length, json_length, json_type = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, json_type) == (b"glTF", 2, len(data), b"JSON")
    binary_length, binary_type = struct.unpack_from("<I4s", data, 20 + json_length)
    assert binary_type == b"BIN\0" and 28 + json_length + binary_length == length
    return json.loads(data[20 : 20 + json_length]), data[28 + json_length :]


def read_floats(tree: dict[str, Any], binary: bytes, number: int) -> np.ndarray:
    accessor = tree["accessors"][number]
    view = tree["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
    assert accessor["componentType"] == 5126 and view["byteOffset"] % 4 == 0
    assert accessor["count"] * width * 4 <= view["byteLength"]
    values = np.frombuffer(binary, "<f4", accessor["count"] * width, view["byteOffset"]).reshape(-1, width)
    assert values.min(axis=0).tolist() == accessor["min"] and values.max(axis=0).tolist() == accessor["max"]
    return values


def test_animation_ends_with_each_part_in_its_place(
    parts: list[Part], assembly: Assembly, tmp_path: Path
) -> None:
    write_glb(parts, tmp_path / "assembly.glb", assembly.steps)
    tree, binary = read_glb(tmp_path / "assembly.glb")
    [animation] = tree["animations"]
    animated_nodes = set()
    for channel in animation["channels"]:
        node = tree["nodes"][channel["target"]["node"]]
        assert channel["target"]["path"] == "translation" and "matrix" not in node
        animated_nodes.add(node["name"])
        sampler = animation["samplers"][channel["sampler"]]
        times_s = read_floats(tree, binary, sampler["input"])[:, 0]
        translations = read_floats(tree, binary, sampler["output"])
        assert times_s[0] == 0.0 and (np.diff(times_s) > 0.0).all() and len(times_s) == len(translations)
        assert np.linalg.norm(translations[0]) >= 25.0 and not translations[-1].any()
    assert animated_nodes == {parts[number].id for step in assembly.steps for number in step.moved_parts}


def test_file_without_steps_has_no_animation(parts: list[Part], tmp_path: Path) -> None:
    write_glb(parts, tmp_path / "assembly.glb")
    assert "animations" not in read_glb(tmp_path / "assembly.glb")[0]


def test_parts_of_a_body_move_together(parts: list[Part], assembly: Assembly) -> None:
    moves = find_movements_mm(parts, assembly.steps)
    offsets = find_offsets(len(parts), assembly.steps, moves)
    for k, step in enumerate(assembly.steps):
        fixed_parts = [n for n in range(len(parts)) if n not in step.moved_parts]
        assert np.array_equal(offsets[k, fixed_parts], offsets[k + 1, fixed_parts])
        assert np.ptp(offsets[k + 1][[*step.moved_parts, *step.fixed_parts]], axis=0) == pytest.approx(
            np.zeros(3)
        )
        assert offsets[k, step.moved_parts] - offsets[k + 1, step.moved_parts] == pytest.approx(
            np.tile(moves[k], (len(step.moved_parts), 1))
        )


def test_moves_grow_with_the_body(parts: list[Part], assembly: Assembly) -> None:
    large_parts = [replace(part, solid=Solid.box((0, 0, 0), (1000, 1000, 1000))) for part in parts]
    assert np.linalg.norm(find_movements_mm(large_parts, assembly.steps), axis=1) == pytest.approx(
        [300.0] * 3
    )
