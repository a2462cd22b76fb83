"""What is read out of an STL."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slicing.errors import Rule, SliceRejected
from slicing.stl import read_triangles, write_triangles


def test_it_reads_what_trimesh_writes(cube_20):
    read = read_triangles(cube_20.export(file_type="stl"))
    assert read.shape == (12, 3, 3)
    assert (read.min(), read.max()) == (-10.0, 10.0)
    assert (read_triangles(write_triangles(read)) == read).all()


@pytest.mark.parametrize("cut", [slice(0), slice(50), slice(84), slice(-25), slice(300)])
def test_files_that_are_cut_short_are_refused(cube_20, cut):
    with pytest.raises(SliceRejected) as refused:
        read_triangles(cube_20.export(file_type="stl")[cut])
    assert refused.value.rule is Rule.BROKEN_MESH


def test_not_a_number_is_refused(cube_20):
    stl = bytearray(cube_20.export(file_type="stl"))
    stl[96:100] = np.float32("nan").tobytes()
    with pytest.raises(SliceRejected, match="finite"):
        read_triangles(bytes(stl))


@given(st.binary(max_size=400))
def test_bytes_of_any_kind_end_in_triangles_or_a_refusal(content):
    try:
        assert len(read_triangles(content)) > 0
    except SliceRejected as refused:
        assert refused.rule is Rule.BROKEN_MESH
