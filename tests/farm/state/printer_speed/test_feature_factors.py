"""Time factors by feature: the fit to finished prints."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.model import TimeFactors
from farm.state.printer_speed import (
    MAX_FACTOR,
    MIN_FACTOR,
    MIN_PRINTS,
    Timing,
    fit_feature_factors,
)

TRUE_FACTORS = st.tuples(*[st.floats(MIN_FACTOR + 0.01, MAX_FACTOR - 0.01)] * 5)
SEEDS = st.integers(0, 10_000)


def draw_shares(rng):
    weights = [rng.uniform(0.02, 1.0) for _ in range(5)]
    return tuple(weight / sum(weights) for weight in weights)


def draw_timings(seed, factors, count=40, noise=0.0):
    rng = random.Random(seed)
    timings = []
    for _ in range(count):
        shares = draw_shares(rng)
        ratio = TimeFactors(1.0, factors).compute_factor(shares) * (1.0 + rng.gauss(0.0, noise))
        timings.append(Timing(shares, ratio))
    return timings


@given(SEEDS, TRUE_FACTORS)
def test_true_factors_are_recovered(seed, true_factors):
    assert fit_feature_factors(draw_timings(seed, true_factors)) == pytest.approx(true_factors, abs=1e-3)


@given(SEEDS, TRUE_FACTORS)
def test_noise_of_a_percent_leaves_the_time_of_other_prints_within_a_percent(seed, true_factors):
    factors = fit_feature_factors(draw_timings(seed, true_factors, count=60, noise=0.01))
    errors = [
        TimeFactors(1.0, factors).compute_factor(timing.shares) / timing.ratio - 1.0
        for timing in draw_timings(seed + 1, true_factors)
    ]
    assert sum(map(abs, errors)) / len(errors) < 0.01


@given(SEEDS, st.lists(st.floats(0.8, 1.3), min_size=MIN_PRINTS, max_size=60))
def test_prints_of_one_mix_of_features_give_one_factor(seed, ratios):
    shares = draw_shares(random.Random(seed))
    factors = fit_feature_factors([Timing(shares, ratio) for ratio in ratios])
    assert max(factors) - min(factors) < 1e-9
    assert min(ratios) - 1e-9 <= factors[0] <= max(ratios) + 1e-9


@given(SEEDS, st.floats(0.8, 1.3))
def test_one_factor_of_all_prints_is_the_factor_of_all_features(seed, ratio):
    timings = [Timing(timing.shares, ratio) for timing in draw_timings(seed, (1.0,) * 5)]
    assert fit_feature_factors(timings) == pytest.approx((ratio,) * 5)


@given(SEEDS, TRUE_FACTORS)
def test_feature_without_time_gets_a_factor_among_the_others(seed, true_factors):
    timings = []
    for timing in draw_timings(seed, true_factors):
        walls, infill, skins, supports, travel = timing.shares
        shares = (walls + supports, infill, skins, 0.0, travel)
        timings.append(Timing(shares, TimeFactors(1.0, true_factors).compute_factor(shares)))
    walls, infill, skins, supports, travel = fit_feature_factors(timings)
    other_factors = (walls, infill, skins, travel)
    assert other_factors == pytest.approx((*true_factors[:3], true_factors[4]), abs=1e-3)
    assert min(other_factors) - 1e-9 <= supports <= max(other_factors) + 1e-9


print_shares = st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5).map(
    lambda weights: tuple((weight + 1e-6) / (sum(weights) + 5e-6) for weight in weights)
)
print_timings = st.lists(
    st.builds(Timing, print_shares, st.floats(0.5, 2.0)), min_size=MIN_PRINTS, max_size=50
)


@given(print_timings, st.randoms(use_true_random=False))
def test_factors_are_bounded_and_independent_of_the_order_of_prints(timings, rng):
    factors = fit_feature_factors(timings)
    assert all(MIN_FACTOR <= factor <= MAX_FACTOR for factor in factors)
    shuffled_timings = list(timings)
    rng.shuffle(shuffled_timings)
    assert fit_feature_factors(shuffled_timings) == factors


@given(SEEDS, TRUE_FACTORS, st.lists(st.floats(0.5, 2.0), min_size=1, max_size=6))
def test_few_prints_with_a_wrong_time_are_ignored(seed, true_factors, wrong_ratios):
    timings = draw_timings(seed, true_factors, count=40)
    wrong_timings = [
        Timing(timing.shares, ratio) for timing, ratio in zip(timings, wrong_ratios, strict=False)
    ]
    factors = fit_feature_factors([*wrong_timings, *timings[len(wrong_timings) :]])
    assert factors == pytest.approx(true_factors, abs=0.02)


def test_too_few_prints_give_no_factors():
    timings = draw_timings(1, (1.0, 1.1, 1.2, 1.0, 0.9), count=MIN_PRINTS)
    assert fit_feature_factors(timings[1:]) is None
    assert fit_feature_factors(timings) is not None
