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
sizes = st.floats(1.0, 400.0)


@given(models, st.floats(0.0, 30.0))
def test_room_with_a_brim_is_on_the_bed_and_off_the_clips(model: str, brim_mm: float):
    profile = SLICING_PROFILES[model]
    width, depth = profile.bed_mm
    bed = Rect(-width / 2, -depth / 2, width / 2, depth / 2)
    for box in list_usable_volumes(profile, brim_mm):
        enlarged_rect = box.rect.expand(brim_mm - 1e-9)
        assert bed.contains(enlarged_rect)
        assert not any(enlarged_rect.overlaps(clip) for clip in profile.clips)
        assert box.height_mm == profile.height_mm


@given(models, st.tuples(sizes, sizes, sizes))
def test_placed_part_lies_in_a_box_of_the_room(model: str, extents_mm: tuple[float, float, float]):
    room = list_usable_volumes(SLICING_PROFILES[model], 8.0)
    placement = place_part(extents_mm, room)
    dx, dy, dz = extents_mm
    if placement is None:
        assert not any(
            box.rect.width_mm >= dx and box.rect.depth_mm >= dy and box.height_mm >= dz for box in room
        )
        return
    if placement.is_rotated:
        dx, dy = dy, dx
    part = Rect(
        placement.x_mm - dx / 2, placement.y_mm - dy / 2, placement.x_mm + dx / 2, placement.y_mm + dy / 2
    )
    slack = FIT_TOLERANCE_MM
    assert any(box.rect.expand(slack).contains(part) and box.height_mm + slack >= dz for box in room)


def test_room_of_an_ultimaker_2_plus_with_an_8_mm_brim_has_the_known_sizes():
    sizes_mm = [box.size_mm for box in list_usable_volumes(PROFILES["ultimaker2_plus"], 8.0)]
    assert (207.0, 191.0, 205.0) in sizes_mm
    assert any(depth == 207.0 and width <= 165.0 for width, depth, _ in sizes_mm)


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
