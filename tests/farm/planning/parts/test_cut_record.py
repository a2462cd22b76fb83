"""Cut record of a job: it is read back exactly, and damage is reported."""

from dataclasses import fields, replace

import numpy as np
import pytest

from books.decompose_tasks import make_decompose_task
from decompose.options import Engine
from decompose.results import Attempt, Cutting
from farm.errors import FarmError
from farm.planning.parts.cut_record import read_cut_record, write_cut_record
from farm.planning.parts.decompose_job import decompose_job


def test_cut_record_is_read_back_exactly(bar, files, tmp_path):
    """Check groups of boxes by their bytes, and infinite figures, for which JSON has no number."""
    decomposition = decompose_job(make_decompose_task(bar, files, tmp_path))
    first_record = read_cut_record(decomposition.cut_record)
    assert len(first_record.cutting.boxes_mm) == len(decomposition.parts) and first_record.parts == ()
    first_record = replace(
        first_record, lower_bound_s=float("inf"), attempts=(Attempt(Engine.BEST, 7, -0.0, None),)
    )
    second_record = read_cut_record(write_cut_record(first_record, tmp_path))
    assert replace(second_record, cutting=None) == replace(first_record, cutting=None)
    for field in fields(Cutting):
        old_value, new_value = (
            getattr(first_record.cutting, field.name),
            getattr(second_record.cutting, field.name),
        )
        assert (
            old_value.tobytes() == new_value.tobytes()
            if isinstance(old_value, np.ndarray)
            else old_value == new_value
        )
    assert write_cut_record(replace(first_record, cutting=None), tmp_path) is None


@pytest.mark.parametrize("content", [b"", b"{}", b'{"engine": "best"}', b"\x80\x04"])
def test_broken_cut_record_is_an_error_with_its_path(content, tmp_path):
    path = tmp_path / "cut-record.json"
    path.write_bytes(content)
    with pytest.raises(FarmError, match=r"cut-record\.json: cannot be read"):
        read_cut_record(path)
