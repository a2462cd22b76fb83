"""Watch over both heaters, with given temperature curves."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import Fault
from drivers.gcode import HeaterName
from drivers.link.replies import Report
from drivers.safety import Finding, HeaterWatch
from drivers.safety.heater_watch import RULES

NOZZLE, BED = HeaterName.NOZZLE, HeaterName.BED


class Curve:
    """Temperature of a first-order heater that is switched on or off."""

    def __init__(self, name: HeaterName, start_c: float = 21.0) -> None:
        self.now_c = start_c
        self.gain_c, self.tau_s = (380.0, 180.0) if name is NOZZLE else (105.0, 520.0)

    def step(self, is_on: bool, seconds: float) -> float:
        top_c = 21.0 + self.gain_c * is_on
        self.now_c = top_c + (self.now_c - top_c) * math.exp(-seconds / self.tau_s)
        return self.now_c


def observe_heater(
    watch: HeaterWatch, name: HeaterName, now_c: float, set_c: float, now_s: float
) -> Finding | None:
    nozzle_c, bed_c = (now_c, 21.0) if name is NOZZLE else (21.0, now_c)
    return watch.judge_report(
        Report(nozzle_c, 0.0, bed_c, 0.0), {NOZZLE: 0.0, BED: 0.0} | {name: set_c}, now_s
    )


@pytest.mark.parametrize(("name", "set_c"), [(NOZZLE, 210.0), (NOZZLE, 260.0), (BED, 60.0), (BED, 100.0)])
@pytest.mark.parametrize("interval_s", [1.0, 3.0, 12.0])
def test_healthy_heater_causes_no_finding(name: HeaterName, set_c: float, interval_s: float):
    watch, curve, rng = HeaterWatch(4.0), Curve(name), random.Random(1)
    now_s = 0.0
    for target_c, seconds in ((set_c, 1800.0), (set_c - 15, 900.0), (set_c, 900.0), (0.0, 3600.0)):
        end_s = now_s + seconds
        while now_s < end_s:
            now_s += interval_s
            is_on = curve.now_c < target_c
            curve.step(is_on, interval_s)
            if (curve.now_c < target_c) != is_on and target_c:
                curve.now_c = target_c
            reading_c = curve.now_c + rng.gauss(0.0, 0.15)
            assert observe_heater(watch, name, reading_c, target_c, now_s) is None
    assert watch.is_cooling


@pytest.mark.parametrize(
    ("name", "failure_c", "limit_s"), [(NOZZLE, 150.0, 80.0), (BED, 45.0, 170.0), (NOZZLE, 30.0, 80.0)]
)
def test_heater_that_stops_warming_is_detected(name: HeaterName, failure_c: float, limit_s: float):
    watch, curve = HeaterWatch(4.0), Curve(name)
    set_c = 210.0 if name is NOZZLE else 60.0
    now_s, failed_s = 0.0, math.nan
    while now_s < 3600.0:
        now_s += 1.0
        if math.isnan(failed_s):
            curve.step(True, 1.0)
            failed_s = now_s if curve.now_c >= failure_c else math.nan
        result = observe_heater(watch, name, curve.now_c, set_c, now_s)
        if result is not None:
            assert result.fault is Fault.HEATER_TIMEOUT
            assert now_s - failed_s <= limit_s
            return
    raise AssertionError("the fault was not found")


@pytest.mark.parametrize("is_on", [False, True])
@pytest.mark.parametrize("name", [NOZZLE, BED])
def test_heater_that_leaves_its_target_is_detected(name: HeaterName, is_on: bool):
    set_c = 210.0 if name is NOZZLE else 60.0
    watch, curve, now_s = HeaterWatch(4.0), Curve(name, set_c), 0.0
    for _ in range(100):
        now_s += 3.0
        assert observe_heater(watch, name, set_c, set_c, now_s) is None
    deviation_start_s = now_s
    while (result := observe_heater(watch, name, curve.step(is_on, 3.0), set_c, now_s)) is None:
        now_s += 3.0
        assert now_s < deviation_start_s + 400.0
    assert result.fault is (Fault.HEATER_STUCK_ON if is_on else Fault.THERMAL_RUNAWAY)
    assert abs(curve.now_c - set_c) > RULES[name].max_deviation_c


@pytest.mark.parametrize("name", [NOZZLE, BED])
def test_only_falling_temperatures_confirm_a_heater_off(name: HeaterName):
    warm_c = 200.0 if name is NOZZLE else 60.0
    falling_watch, constant_watch, late_watch = HeaterWatch(4.0), HeaterWatch(4.0), HeaterWatch(4.0)
    curve, second_curve = Curve(name, warm_c), Curve(name, warm_c)
    result = None
    for time_s in range(1, 200):
        now_s = float(time_s)
        assert observe_heater(falling_watch, name, curve.step(False, 1.0), 0.0, now_s) is None
        result = result or observe_heater(constant_watch, name, warm_c, 0.0, now_s)
        observe_heater(late_watch, name, second_curve.step(time_s > 60, 1.0), 0.0, now_s)
        if time_s == 40:
            assert falling_watch.is_cooling and not constant_watch.is_cooling and late_watch.is_cooling
    assert falling_watch.is_cooling and not constant_watch.is_cooling and not late_watch.is_cooling
    assert result is not None and result.fault is Fault.HEATER_STUCK_ON


@pytest.mark.parametrize("seconds", [70.0, 200.0, 4000.0, -4000.0])
@pytest.mark.parametrize("name", [NOZZLE, BED])
def test_gap_without_reports_is_not_a_heater_fault(name: HeaterName, seconds: float):
    """Skip reports, as if the host slept, its clock was set, or a move took a long time."""
    set_c = 210.0 if name is NOZZLE else 60.0
    for target_c, start_c in ((set_c, 30.0), (0.0, set_c)):
        watch, curve, now_s = HeaterWatch(4.0), Curve(name, start_c), 0.0
        for time_s in range(60):
            now_s += seconds if time_s in (5, 6, 30) else 1.0
            assert observe_heater(watch, name, curve.step(target_c > 0, 1.0), target_c, now_s) is None


def test_reading_below_freezing_means_a_broken_sensor():
    watch = HeaterWatch(4.0)
    results = [observe_heater(watch, BED, -14.0, 0.0, float(time_s)) for time_s in range(5)]
    assert results[-1] is not None and results[-1].fault is Fault.MINTEMP
    assert not watch.is_cooling


@given(
    st.lists(st.tuples(st.integers(0, 3), st.floats(0.0, 999.0)), max_size=30), st.sampled_from([NOZZLE, BED])
)
def test_garbled_report_among_good_ones_is_ignored(
    garbled_reports: list[tuple[int, float]], name: HeaterName
):
    """Garble at most every third report, because reports have no checksum."""
    set_c = 210.0 if name is NOZZLE else 60.0
    watch, now_s = HeaterWatch(4.0), 0.0
    for good_count, garbled_c in garbled_reports:
        for reading_c in (*[set_c] * (good_count + 2), garbled_c):
            now_s += 3.0
            assert observe_heater(watch, name, reading_c, set_c, now_s) is None
