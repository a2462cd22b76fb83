"""Motion planner: durations of moves, and limits of look-ahead."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulator.firmware.planner import CAPACITY, STANDSTILL_MM_S, Limits, Planner, Point
from drivers.printers import PROFILES

PROFILE = PROFILES["ultimaker2_plus"]
START_POINT: Point = (100.0, 100.0, 50.0, 0.0)


class Bench:
    """Planner that is always kept full and records the moves of its feeder."""

    def __init__(self) -> None:
        self.fed_mm = 0.0
        self.planner = Planner(Limits.from_profile(PROFILE), START_POINT, self._record_feed)
        self.now_s = 0.0

    def _record_feed(self, e_mm: float, z_mm: float) -> None:
        self.fed_mm += e_mm

    def add_move(self, target: Point, feedrate_mm_s: float) -> None:
        self.now_s = max(self.now_s, self.planner.compute_next_free_s())
        self.planner.advance(self.now_s)
        self.planner.add(target, feedrate_mm_s, self.now_s)

    def finish(self) -> float:
        self.planner.advance(math.inf)
        return self.planner.idle_since_s


def compute_trapezoid_s(
    distance_mm: float,
    speed_mm_s: float,
    acceleration_mm_s2: float,
    entry_mm_s: float,
    exit_mm_s: float = STANDSTILL_MM_S,
) -> float:
    """Compute the time of a straight move by the textbook formula."""
    ramps_mm = (2 * speed_mm_s**2 - entry_mm_s**2 - exit_mm_s**2) / (2 * acceleration_mm_s2)
    if ramps_mm <= distance_mm:
        ramps_s = (2 * speed_mm_s - entry_mm_s - exit_mm_s) / acceleration_mm_s2
        return ramps_s + (distance_mm - ramps_mm) / speed_mm_s
    top_mm_s = math.sqrt((2 * acceleration_mm_s2 * distance_mm + entry_mm_s**2 + exit_mm_s**2) / 2)
    return (2 * top_mm_s - entry_mm_s - exit_mm_s) / acceleration_mm_s2


@pytest.mark.parametrize("distance_mm", [1.0, 5.0, 20.0, 90.0])
@pytest.mark.parametrize("speed_mm_s", [5.0, 60.0, 150.0, 300.0])
def test_straight_move_takes_the_time_of_its_trapezoid(distance_mm: float, speed_mm_s: float) -> None:
    bench = Bench()
    bench.add_move((100 + distance_mm, 100, 50, 0), speed_mm_s)
    entry_mm_s = min(speed_mm_s, PROFILE.jerk_mm_s[0] / 2)  # a move from standstill begins with half the jerk
    assert bench.finish() == pytest.approx(compute_trapezoid_s(distance_mm, speed_mm_s, 3000.0, entry_mm_s))


def test_z_keeps_its_limits_of_speed_and_acceleration() -> None:
    bench = Bench()
    bench.add_move((100, 100, 150, 0), 300.0)
    assert bench.finish() == pytest.approx(compute_trapezoid_s(100.0, 40.0, 100.0, PROFILE.jerk_mm_s[1] / 2))


def test_feeder_keeps_its_speed_limit() -> None:
    bench = Bench()
    bench.add_move((100, 100, 50, 90), 300.0)
    assert bench.finish() == pytest.approx(compute_trapezoid_s(90.0, 45.0, 3000.0, PROFILE.jerk_mm_s[2] / 2))
    assert bench.fed_mm == pytest.approx(90.0)


@given(pieces=st.integers(2, 60), speed_mm_s=st.sampled_from([20.0, 60.0, 150.0]))
@settings(max_examples=40, deadline=None)
def test_split_line_takes_about_as_long_as_an_unsplit_one(pieces: int, speed_mm_s: float) -> None:
    unsplit_bench, split_bench = Bench(), Bench()
    unsplit_bench.add_move((180, 100, 50, 4), speed_mm_s)
    for k in range(1, pieces + 1):
        split_bench.add_move((100 + 80 * k / pieces, 100, 50, 4 * k / pieces), speed_mm_s)
    unsplit_s, split_s = unsplit_bench.finish(), split_bench.finish()
    # Up to two starts from standstill and the end of the queue take longer; no move takes less time.
    assert split_s >= unsplit_s - 1e-9
    assert split_s == pytest.approx(unsplit_s, abs=0.07)
    assert split_bench.fed_mm == pytest.approx(unsplit_bench.fed_mm)


moves = st.lists(
    st.tuples(
        st.floats(0, 200), st.floats(0, 200), st.sampled_from([0.2, 0.2, 0.2, 0.4, 5.0]), st.floats(-5, 30)
    ),
    min_size=1,
    max_size=60,
)


@given(moves=moves, speed_mm_s=st.floats(1, 300))
@settings(max_examples=150, deadline=None)
def test_moves_end_at_their_target_and_never_early(moves: list[Point], speed_mm_s: float) -> None:
    bench = Bench()
    min_s, position_mm = 0.0, START_POINT
    for target in moves:
        bench.add_move(target, speed_mm_s)
        assert len(bench.planner) <= CAPACITY
        move_mm = math.dist(bench.planner.target_mm[:3], position_mm[:3])
        min_s += move_mm / speed_mm_s
        position_mm = bench.planner.target_mm
    assert bench.finish() >= min_s * (1 - 1e-9)
    # Moves of less than six steps are added to the next ones.
    for axis, steps_per_mm in enumerate((80.0, 80.0, 200.0, 369.0)):
        assert bench.planner.target_mm[axis] == pytest.approx(moves[-1][axis], abs=5.001 / steps_per_mm)
    assert bench.fed_mm == pytest.approx(bench.planner.target_mm[3])
    assert bench.planner.moving_s <= bench.planner.idle_since_s + 1e-9


@given(moves=moves, speed_mm_s=st.floats(5, 300))
@settings(max_examples=100, deadline=None)
def test_position_never_changes_faster_than_the_maximum_speed(moves: list[Point], speed_mm_s: float) -> None:
    """Check in steps of 1 ms that no axis moves further than its maximum speed allows."""
    bench = Bench()
    planner = bench.planner
    for target in moves[:CAPACITY]:
        planner.add(target, speed_mm_s, 0.0)
    last_position_mm = planner.compute_position(0.0)
    now_s = 0.0
    while len(planner) and now_s < 20.0:
        now_s += 0.001
        planner.advance(now_s)
        position_mm = planner.compute_position(now_s)
        for axis in range(3):
            max_mm = PROFILE.max_feedrate_mm_s[axis] * 0.001
            assert abs(position_mm[axis] - last_position_mm[axis]) <= max_mm * 1.001 + 1e-9
        last_position_mm = position_mm


@given(moves=moves, speed_mm_s=st.floats(5, 300))
@settings(max_examples=100, deadline=None)
def test_entry_speeds_are_reachable(moves: list[Point], speed_mm_s: float) -> None:
    bench = Bench()
    for target in moves:
        bench.add_move(target, speed_mm_s)
        blocks = bench.planner._blocks
        for block, next_block in itertools.pairwise(blocks[1:]):
            assert next_block.entry_mm2_s2 <= block.entry_mm2_s2 + block.gain_mm2_s2 + 1e-6
            assert block.entry_mm2_s2 <= next_block.entry_mm2_s2 + block.gain_mm2_s2 + 1e-6
        for block in blocks:
            assert (
                block.entry_mm2_s2 <= block.max_entry_mm2_s2 + 1e-9 <= block.speed_mm_s**2 * (1 + 1e-9) + 1e-6
            )


def test_stop_keeps_the_position_and_counts_fed_filament() -> None:
    bench = Bench()
    bench.add_move((200, 100, 50, 10), 100.0)
    bench.add_move((200, 200, 50, 20), 100.0)
    position_mm = bench.planner.stop(0.5)
    assert 100 < position_mm[0] < 200 and position_mm[1] == 100
    assert bench.fed_mm == pytest.approx(position_mm[3]) == pytest.approx((position_mm[0] - 100) / 10)
    assert len(bench.planner) == 0 and bench.planner.compute_position(9.0) == position_mm


def test_moves_added_late_do_not_stretch_a_queue_that_is_not_empty() -> None:
    """Check that no move is delayed if moves are added late but in time."""
    prompt_bench, late_bench = Bench(), Bench()
    targets = [(100 + 2.0 * k, 100.0, 50.0, 0.1 * k) for k in range(1, 45)]
    for target in targets:
        prompt_bench.add_move(target, 50.0)
    for k, target in enumerate(targets):
        if len(late_bench.planner) >= CAPACITY:
            late_bench.now_s = max(late_bench.now_s, late_bench.planner.compute_next_free_s()) + (
                0.1 if k % 5 == 0 else 0.0
            )
            late_bench.planner.advance(late_bench.now_s)
        late_bench.planner.add(target, 50.0, late_bench.now_s)
    assert late_bench.finish() == pytest.approx(prompt_bench.finish(), abs=1e-6)


def test_short_moves_are_stretched_only_while_few_are_queued() -> None:
    elapsed_s = []
    for slowdown, feed_interval_s in ((False, 0.0), (True, 0.0), (True, 0.004)):
        planner = Planner(Limits.from_profile(PROFILE), START_POINT, lambda e_mm, z_mm: None, slowdown)
        now_s = 0.0
        for k in range(1, 401):
            now_s = max(now_s + feed_interval_s, planner.compute_next_free_s())
            planner.advance(now_s)
            planner.add((100 + k * 0.2, 100.0, 50.0, 0.0), 100.0, now_s)  # 2 ms each
        planner.advance(math.inf)
        elapsed_s.append(planner.idle_since_s)
    plain_s, full_queue_s, late_host_s = elapsed_s
    assert plain_s == pytest.approx(0.8, rel=0.1)
    assert plain_s < full_queue_s < plain_s + 8 * 0.02  # only its first moves were added to a short queue
    assert late_host_s > 2 * plain_s
