"""Temperatures of the heaters."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.emulator.hardware.thermal import AMBIENT_C, FULL_POWER, Heater
from drivers.printers import PROFILES

NOZZLE = PROFILES["ultimaker2_plus"].nozzle
BED = PROFILES["ultimaker2_plus"].bed


def test_new_heater_has_the_temperature_of_the_room_and_keeps_it() -> None:
    heater = Heater(NOZZLE)
    assert heater.compute_temperature_c(0.0) == heater.compute_temperature_c(1e5) == AMBIENT_C
    assert heater.compute_power(1e5) == 0


@given(target_c=st.floats(50, 260))
def test_nozzle_reaches_its_target_at_the_modelled_time_and_holds_it(target_c: float) -> None:
    heater = Heater(NOZZLE)
    heater.set_target(target_c, 0.0)
    expected_s = NOZZLE.compute_heating_s(target_c)
    assert heater.compute_power(0.0) == FULL_POWER
    assert heater.compute_temperature_c(expected_s * 0.99) < target_c
    assert heater.compute_temperature_c(expected_s + 1e-6) == pytest.approx(target_c)
    assert heater.compute_temperature_c(expected_s + 5000.0) == pytest.approx(target_c)
    assert 0 < heater.compute_power(expected_s + 5000.0) < FULL_POWER


@given(steps_s=st.lists(st.floats(0.01, 50), min_size=1, max_size=40))
def test_temperature_is_independent_of_the_sampling_rate(steps_s: list[float]) -> None:
    for model, period_s, target_c in ((NOZZLE, 0.0, 210.0), (BED, 5.0, 60.0)):
        sampled_heater, other_heater = Heater(model, period_s), Heater(model, period_s)
        sampled_heater.set_target(target_c, 0.0)
        other_heater.set_target(target_c, 0.0)
        now_s = 0.0
        for step_s in steps_s:
            now_s += step_s
            sampled_heater.compute_temperature_c(now_s)
        assert sampled_heater.compute_temperature_c(now_s) == pytest.approx(
            other_heater.compute_temperature_c(now_s), abs=1e-6
        )


def test_bed_switches_each_five_seconds_and_stays_within_a_degree() -> None:
    heater = Heater(BED, period_s=5.0)
    heater.set_target(60.0, 0.0)
    now_s = BED.compute_heating_s(60.0) + 10.0
    states = set()
    while now_s < 3000.0:
        assert heater.compute_temperature_c(now_s) == pytest.approx(60.0, abs=1.0)
        states.add(heater.compute_power(now_s))
        now_s += 1.0
    assert states == {0, FULL_POWER}


@given(target_c=st.floats(30, 250), wait_s=st.floats(1, 2000))
def test_unpowered_heater_cools_to_room_temperature(target_c: float, wait_s: float) -> None:
    heater = Heater(NOZZLE)
    heater.set_target(target_c, 0.0)
    top_c = heater.compute_temperature_c(5000.0)
    heater.set_target(0.0, 5000.0)
    middle_c = AMBIENT_C + (top_c - AMBIENT_C) / 2
    expected_s = heater.compute_cooling_s(middle_c, 5000.0)
    assert expected_s == pytest.approx(NOZZLE.tau_s * math.log(2))
    assert AMBIENT_C <= heater.compute_temperature_c(5000.0 + wait_s) < top_c
    assert heater.compute_power(5000.0 + wait_s) == 0


def test_lower_target_is_approached_from_above_and_then_held() -> None:
    heater = Heater(NOZZLE)
    heater.set_target(240.0, 0.0)
    heater.compute_temperature_c(2000.0)
    heater.set_target(180.0, 2000.0)
    assert heater.compute_temperature_c(2001.0) > 180.0
    assert heater.compute_temperature_c(4000.0) == pytest.approx(180.0)


def test_dead_element_never_warms() -> None:
    heater = Heater(BED, period_s=5.0, is_dead=True)
    heater.set_target(60.0, 0.0)
    assert heater.compute_temperature_c(3000.0) == pytest.approx(AMBIENT_C)
    assert heater.compute_power(3000.0) == FULL_POWER
    assert heater.compute_heating_s(60.0, 3000.0) == math.inf
