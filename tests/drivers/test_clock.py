"""Farm time, compared with the wall time of the host."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import Clock, read_wall_s

times_s = st.floats(0, 4e9)


@given(scale=st.floats(1, 1000), anchor_s=times_s, wall_s=times_s)
def test_wall_and_farm_time_are_inverse_conversions(scale: float, anchor_s: float, wall_s: float):
    clock = Clock(scale, anchor_s)
    assert clock.to_wall_s(clock.to_farm_s(wall_s)) == pytest.approx(wall_s, abs=1e-2)
    assert clock.to_farm_s(anchor_s) == anchor_s


def test_clock_of_scale_one_equals_wall_time():
    assert Clock().to_farm_s(12345.0) == 12345.0
    assert Clock(60.0).to_wall_duration_s(90.0) == 1.5


@pytest.mark.parametrize("step_s", [600.0, -600.0, 3e7])
def test_setting_the_clock_of_the_host_moves_no_deadline(step_s: float, monkeypatch: pytest.MonkeyPatch):
    set_s = time.time() + step_s
    old_now_s = Clock().now()
    monkeypatch.setattr(time, "time", lambda: set_s)
    assert old_now_s <= Clock().now() < old_now_s + 300.0
    assert abs(read_wall_s() - old_now_s) < 300.0


@pytest.mark.parametrize("step_s", [6 * 3600.0, -6 * 3600.0, 3e7])
def test_clock_step_of_the_host_is_applied_once(step_s: float, monkeypatch: pytest.MonkeyPatch):
    host_time = time.time
    clock, agent_clock = Clock(), Clock()
    assert clock.follow_host() == 0.0
    monkeypatch.setattr(time, "time", lambda: host_time() + step_s)
    assert clock.follow_host() == pytest.approx(step_s, abs=1.0)
    assert clock.follow_host() == 0.0
    # The agent's clock does not follow.
    assert clock.now() - agent_clock.now() == pytest.approx(step_s, abs=1.0)
    assert clock.to_wall_s(clock.now()) == pytest.approx(read_wall_s(), abs=60.0)
    monkeypatch.setattr(time, "time", host_time)
    assert clock.follow_host() == pytest.approx(-step_s, abs=1.0)


def test_small_steps_of_the_host_clock_add_up(monkeypatch: pytest.MonkeyPatch):
    real_time, clock = time.time, Clock()
    shifts_s = []
    for tenths in range(1, 31):
        monkeypatch.setattr(time, "time", lambda tenths=tenths: real_time() + tenths / 10)
        shifts_s.append(clock.follow_host())
    assert 0.0 in shifts_s
    assert 2.0 < clock.host_shift_s == pytest.approx(sum(shifts_s))


def test_clock_of_simulated_printers_never_steps(monkeypatch: pytest.MonkeyPatch):
    real_time, clock = time.time, Clock(60.0, time.time())
    monkeypatch.setattr(time, "time", lambda: real_time() + 1e6)
    assert (clock.follow_host(), clock.host_shift_s) == (0.0, 0.0)
