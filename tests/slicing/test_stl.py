"""What is read out of an STL."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from slicing.errors import Rule, SliceRejected
from slicing.stl import Triangles, read_stl

BALL = trimesh.creation.icosphere(2, 10).triangles


@given(st.floats(-12, 12))
@settings(max_examples=60, deadline=None)
def test_the_volume_above_a_height_and_below_it_are_the_whole(z):
    turned = BALL * np.array([1.0, -1.0, -1.0])  # about X, so that what was below is above
    parts = Triangles(BALL).volume_above_mm3(z) + Triangles(turned).volume_above_mm3(-z)
    assert parts == pytest.approx(trimesh.creation.icosphere(2, 10).volume)


@pytest.mark.parametrize(
    ("z", "volume"), [(-1.0, 6000.0), (0.0, 6000.0), (7.5, 4500.0), (29.0, 200.0), (31.0, 0.0)]
)
def test_the_volume_above_a_height_of_a_box(z, volume):
    box = trimesh.creation.box((20, 10, 30))
    box.apply_translation((40, -3, 15))
    assert Triangles(box.triangles).volume_above_mm3(z) == pytest.approx(volume)


def test_it_reads_what_trimesh_writes(cube_20):
    read = read_stl(cube_20.export(file_type="stl"))
    assert (len(read.corners), read.min_z_mm, read.max_z_mm) == (12, -10.0, 10.0)


@pytest.mark.parametrize("cut", [slice(0), slice(50), slice(84), slice(-25), slice(300)])
def test_files_that_are_cut_short_are_refused(cube_20, cut):
    with pytest.raises(SliceRejected) as refused:
        read_stl(cube_20.export(file_type="stl")[cut])
    assert refused.value.rule is Rule.BROKEN_MESH


def test_not_a_number_is_refused(cube_20):
    stl = bytearray(cube_20.export(file_type="stl"))
    stl[96:100] = np.float32("nan").tobytes()
    with pytest.raises(SliceRejected, match="finite"):
        read_stl(bytes(stl))


@given(st.binary(max_size=400))
def test_bytes_of_any_kind_end_in_triangles_or_a_refusal(content):
    try:
        assert len(read_stl(content).corners) > 0
    except SliceRejected as refused:
        assert refused.rule is Rule.BROKEN_MESH
