"""Usable volumes, limits and heating times of printer profiles."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.printers import (
    FIT_TOLERANCE_MM,
    PROFILES,
    SLICING_PROFILES,
    HeaterModel,
    Rect,
    list_usable_volumes,
    place_part,
)

models = st.sampled_from(sorted(SLICING_PROFILES))
lengths_mm = st.floats(1.0, 400.0)


@given(models, st.floats(0.0, 30.0))
def test_usable_volume_with_a_brim_is_on_the_bed_and_off_the_clips(model: str, brim_mm: float):
    profile = SLICING_PROFILES[model]
    width_mm, depth_mm = profile.bed_mm
    bed = Rect(-width_mm / 2, -depth_mm / 2, width_mm / 2, depth_mm / 2)
    for box in list_usable_volumes(profile, brim_mm):
        enlarged_rect = box.rect.expand(brim_mm - 1e-9)
        assert bed.contains(enlarged_rect)
        assert not any(enlarged_rect.overlaps(clip) for clip in profile.clips)
        assert box.height_mm == profile.height_mm


@given(models, st.tuples(lengths_mm, lengths_mm, lengths_mm))
def test_placed_part_lies_in_a_box_of_the_usable_volume(model: str, extents_mm: tuple[float, float, float]):
    boxes = list_usable_volumes(SLICING_PROFILES[model], 8.0)
    placement = place_part(extents_mm, boxes)
    width_mm, depth_mm, height_mm = extents_mm
    if placement is None:
        assert not any(
            box.rect.width_mm >= width_mm and box.rect.depth_mm >= depth_mm and box.height_mm >= height_mm
            for box in boxes
        )
        return
    if placement.is_rotated:
        width_mm, depth_mm = depth_mm, width_mm
    part = Rect(
        placement.x_mm - width_mm / 2,
        placement.y_mm - depth_mm / 2,
        placement.x_mm + width_mm / 2,
        placement.y_mm + depth_mm / 2,
    )
    slack_mm = FIT_TOLERANCE_MM
    assert any(
        box.rect.expand(slack_mm).contains(part) and box.height_mm + slack_mm >= height_mm for box in boxes
    )


def test_usable_volume_of_an_ultimaker_2_plus_with_an_8_mm_brim_has_the_known_sizes():
    sizes_mm = [box.size_mm for box in list_usable_volumes(PROFILES["ultimaker2_plus"], 8.0)]
    assert (207.0, 191.0, 205.0) in sizes_mm
    assert any(depth_mm == 207.0 and width_mm <= 165.0 for width_mm, depth_mm, _ in sizes_mm)


def test_smaller_limit_of_the_user_is_used():
    assert list_usable_volumes(PROFILES["ultimaker2_plus"], 0.0, (100.0, 90.0, 500.0))[0].size_mm == (
        100.0,
        90.0,
        205.0,
    )


@given(st.floats(22.0, 110.0), st.floats(22.0, 110.0))
def test_heating_to_a_higher_target_takes_longer(first_c: float, second_c: float):
    heater = HeaterModel(gain_c=105.0, tau_s=520.0)
    low_c, high_c = sorted((first_c, second_c))
    assert heater.compute_heating_s(low_c) <= heater.compute_heating_s(high_c)
    assert heater.compute_heating_s(20.0) == 0.0
    assert heater.compute_heating_s(200.0) == math.inf
    assert heater.compute_heating_s(high_c, start_c=low_c) == pytest.approx(
        heater.compute_heating_s(high_c) - heater.compute_heating_s(low_c), abs=1e-6
    )
