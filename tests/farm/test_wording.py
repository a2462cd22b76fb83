"""Formatting of durations and times."""

import pytest

from farm.model import PlanProgress, PlanStep
from farm.text import format_duration
from farm.wording import describe_material, format_filament, format_planning, format_time


@pytest.mark.parametrize(
    ("duration_s", "expected_text"),
    [
        (None, "-"),
        (0.4, "0 s"),
        (119.4, "119 s"),
        (120, "2 min"),
        (3599, "1h00"),
        (27420, "7h37"),
        (360000, "100h00"),
    ],
)
def test_durations_are_formatted_in_hours_minutes_or_seconds(duration_s, expected_text):
    assert format_duration(duration_s) == expected_text


def test_filament_is_shown_with_its_price_if_known():
    assert format_filament(123.6, 15640.0) == "124 g, 15.6 m"
    assert format_filament(123.6, 15640.0, 3.5226) == "124 g, 15.6 m, price 3.52"
    assert format_filament(0.081, 12.0) == "0.08 g, 0.01 m"
    assert format_filament(123.6, 15640.0, 0.0, "EUR") == "124 g, 15.6 m, 0.00 EUR"


def test_times_are_formatted_with_weekday_or_date():
    now = "2026-11-22T07:00:00+00:00"
    assert format_time(None, now) == "-"
    assert format_time("2026-11-21T07:05:09+00:00", now) == "Sat 07:05"


def test_progress_of_a_plan_is_formatted():
    assert format_planning(PlanProgress(step=PlanStep.DECOMPOSING)) == "decomposing"
    progress = PlanProgress(step=PlanStep.DECOMPOSING, share=0.42, remaining_s=95.0)
    assert format_planning(progress) == "decomposing 42 %, up to about 95 s left"
    assert format_planning(PlanProgress(step=PlanStep.WAITING)) == "waiting for a worker"
    assert (
        format_planning(PlanProgress(step=PlanStep.REBALANCING))
        == "balancing the parts by their sliced times"
    )
    slicing_progress = PlanProgress(step=PlanStep.SLICING, done=3, of=8)
    assert format_planning(slicing_progress) == "slicing 3 of 8"
    assert (
        format_planning(slicing_progress.model_copy(update={"cached": 1}))
        == "slicing 3 of 8 (1 plate from the cache)"
    )


@pytest.mark.parametrize(
    ("material", "kind", "name"),
    [("generic_tpu", "TPU 95A", "TPU 95A"), ("generic_pla", None, "PLA"), ("white_petg", "", "white_petg")],
)
def test_materials_are_named_by_their_kind(material, kind, name):
    assert describe_material(material, kind) == name
