"""Cut record of a job."""

from dataclasses import fields, replace

import numpy as np
import pytest

from decompose.options import Engine
from decompose.results import Attempt, Cutting
from decompose_tasks import decompose_task
from farm.errors import FarmError
from farm.planning.parts.cut_record import read_cut_record, write_cut_record
from farm.planning.parts.decompose_job import decompose_job


def test_cut_record_is_read_back_exactly(bar, files, tmp_path):
    """Boxes are grouped by their bytes; an infinite figure is no number of JSON."""
    cut = decompose_job(decompose_task(bar, files, tmp_path))
    first = read_cut_record(cut.cut_record)
    assert len(first.cutting.boxes_mm) == len(cut.parts) and first.parts == ()
    first = replace(first, lower_bound_s=float("inf"), attempts=(Attempt(Engine.BEST, 7, -0.0, None),))
    second = read_cut_record(write_cut_record(first, tmp_path))
    assert replace(second, cutting=None) == replace(first, cutting=None)
    for field in fields(Cutting):
        was, now = getattr(first.cutting, field.name), getattr(second.cutting, field.name)
        assert was.tobytes() == now.tobytes() if isinstance(was, np.ndarray) else was == now
    assert write_cut_record(replace(first, cutting=None), tmp_path) is None


@pytest.mark.parametrize("content", [b"", b"{}", b'{"engine": "best"}', b"\x80\x04"])
def test_broken_cut_record_is_an_error_with_its_path(content, tmp_path):
    path = tmp_path / "cut-record.json"
    path.write_bytes(content)
    with pytest.raises(FarmError, match=r"cut-record\.json: cannot be read"):
        read_cut_record(path)
