"""Moves of cuts by the times of slices."""

import json
from dataclasses import replace

import pytest

from books.decompose_tasks import make_decompose_task, slice_with_slow_part
from farm.model import TimeFactors
from farm.planning.parts.decompose_job import decompose_job
from farm.planning.parts.rebalance_parts import rebalance_parts
from farm.planning.plan import MIN_REBALANCE_DELAY_S
from slicing.checks import FeatureTimes

pytestmark = pytest.mark.usefixtures("without_pictures")


def test_part_with_a_slow_slice_is_cut_smaller(bar, files, tmp_path):
    task = make_decompose_task(bar, files, tmp_path)
    decomposition = decompose_job(task)
    slow_job = slice_with_slow_part(task, decomposition, extra_s=MIN_REBALANCE_DELAY_S * 3)
    assert (
        slow_job.compute_makespan_s()
        == slow_job.parts[1].compute_expected_s()
        == slow_job.compute_printer_times_s()[decomposition.parts[1].printer]
    )
    assert slow_job.should_rebalance()
    new_result = rebalance_parts([slow_job], tmp_path / "rebalanced")
    assert new_result.parts[1].geometry.volume_mm3 < decomposition.parts[1].geometry.volume_mm3
    assert sum(part.geometry.volume_mm3 for part in new_result.parts) == pytest.approx(260 * 14 * 12)
    assert {part.printer for part in new_result.parts} == {"p0", "p1"}
    assert all(part.stl.is_file() and part.stl.parent == tmp_path / "rebalanced" for part in new_result.parts)
    report = json.loads((tmp_path / "rebalanced" / "decomposition.json").read_text())
    assert [part["volume_mm3"] for part in report["parts"]] == [
        part.geometry.volume_mm3 for part in new_result.parts
    ]


def test_balanced_parts_are_not_rebalanced(bar, files, tmp_path):
    task = make_decompose_task(bar, files, tmp_path)
    decomposition = decompose_job(task)
    # On average, the slices take longer by half of this time.
    assert not slice_with_slow_part(task, decomposition, extra_s=MIN_REBALANCE_DELAY_S).should_rebalance()
    assert not replace(
        slice_with_slow_part(task, decomposition, 1e4), decomposed_job=replace(decomposition, cut_record=None)
    ).should_rebalance()
    level_job = slice_with_slow_part(task, decomposition, extra_s=0.0)
    assert rebalance_parts([level_job], tmp_path / "rebalanced") is None


def test_part_whose_features_its_printer_prints_slowly_is_rebalanced(bar, files, tmp_path):
    factors = dict.fromkeys(("p0", "p1"), TimeFactors(1.0, (1.0, 1.0, 1.3, 1.0, 1.0)))
    task = replace(make_decompose_task(bar, files, tmp_path), time_factors=factors)
    level_job = slice_with_slow_part(task, decompose_job(task), extra_s=0.0)
    total_s = level_job.parts[0].result.sliced_s
    features = [FeatureTimes(0.0, 0.0, total_s, 0.0, 0.0)] + (len(level_job.parts) - 1) * [
        FeatureTimes(total_s, 0.0, 0.0, 0.0, 0.0)
    ]
    parts = [
        replace(part, result=replace(part.result, features=part_features))
        for part, part_features in zip(level_job.parts, features, strict=True)
    ]
    level_job, first_part = replace(level_job, parts=type(level_job.parts)(parts)), parts[0]
    assert level_job.compute_printer_times_s()[first_part.printer.name] == pytest.approx(
        first_part.compute_expected_s(TimeFactors(1.3))
    )
    assert rebalance_parts([level_job], tmp_path / "rebalanced") is not None


def test_slow_printer_is_busy_longer(bar, files, tmp_path):
    task = replace(make_decompose_task(bar, files, tmp_path), time_factors={"p0": TimeFactors(1.5)})
    decomposition = decompose_job(task)
    level_job = slice_with_slow_part(task, decomposition, extra_s=0.0)
    printed_s = level_job.parts[0].result.sliced_s
    # The time factor applies to the layers alone.
    assert level_job.compute_printer_times_s()["p0"] == pytest.approx(
        level_job.compute_printer_times_s()["p1"] + 0.5 * printed_s
    )


def test_several_parts_per_printer_are_not_rebalanced(bar, files, tmp_path):
    task = make_decompose_task(bar, files, tmp_path)
    decomposition = decompose_job(task)
    assert slice_with_slow_part(task, decomposition, extra_s=1e4).should_rebalance()
    two_parts = replace(
        decomposition, parts=tuple(replace(part, printer="p0") for part in decomposition.parts)
    )
    assert not slice_with_slow_part(task, two_parts, extra_s=1e4).should_rebalance()
