"""Cuts that are moved by the times of slices."""

import json
from dataclasses import replace

import pytest

from decompose_tasks import decompose_task, slice_late
from farm.planning.parts.decompose_job import decompose_job
from farm.planning.parts.relevel_parts import relevel_parts
from farm.planning.plan import RELEVEL_LATE_S

pytestmark = pytest.mark.usefixtures("without_pictures")


def test_part_with_a_slow_slice_is_cut_smaller(bar, files, tmp_path):
    work = decompose_task(bar, files, tmp_path)
    cut = decompose_job(work)
    slow = slice_late(work, cut, late_s=RELEVEL_LATE_S * 3)
    assert slow.makespan_s() == slow.parts[1].expected_s() == slow.busy_s()[cut.parts[1].printer]
    assert slow.should_relevel()
    after = relevel_parts(slow, tmp_path / "levelled")
    assert after.parts[1].geometry.volume_mm3 < cut.parts[1].geometry.volume_mm3
    assert sum(part.geometry.volume_mm3 for part in after.parts) == pytest.approx(260 * 14 * 12)
    assert {part.printer for part in after.parts} == {"p0", "p1"}
    assert all(part.stl.is_file() and part.stl.parent == tmp_path / "levelled" for part in after.parts)
    report = json.loads((tmp_path / "levelled" / "decomposition.json").read_text())
    assert [part["volume_mm3"] for part in report["parts"]] == [
        part.geometry.volume_mm3 for part in after.parts
    ]


def test_balanced_parts_are_not_relevelled(bar, files, tmp_path):
    work = decompose_task(bar, files, tmp_path)
    cut = decompose_job(work)
    assert not slice_late(work, cut, late_s=RELEVEL_LATE_S).should_relevel()  # in the mean half of that later
    assert not replace(slice_late(work, cut, 1e4), decomposed=replace(cut, cut_record=None)).should_relevel()
    level = slice_late(work, cut, late_s=0.0)
    assert relevel_parts(level, tmp_path / "levelled") is None


def test_slow_printer_is_busy_longer(bar, files, tmp_path):
    work = replace(decompose_task(bar, files, tmp_path), time_factors={"p0": 1.5})
    cut = decompose_job(work)
    level = slice_late(work, cut, late_s=0.0)
    printed_s = level.parts[0].result.sliced_s
    assert level.busy_s()["p0"] == pytest.approx(
        level.busy_s()["p1"] + 0.5 * printed_s
    )  # of the layers alone


def test_several_parts_per_printer_are_not_relevelled(bar, files, tmp_path):
    work = decompose_task(bar, files, tmp_path)
    cut = decompose_job(work)
    assert slice_late(work, cut, late_s=1e4).should_relevel()
    both = replace(cut, parts=tuple(replace(part, printer="p0") for part in cut.parts))
    assert not slice_late(work, both, late_s=1e4).should_relevel()
