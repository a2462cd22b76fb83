"""Times of plates, and the assignment of loads to printers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.printers import PROFILES
from farm.planning.plate_times import compute_plate_seconds, reassign_loads

NAMES = list("abcdef")
LOADS_S = st.floats(0.0, 1e6)
FACTORS = st.floats(0.8, 1.25)


def test_time_factor_applies_only_to_layers():
    profile = PROFILES["ultimaker2_plus"]
    overhead_s = compute_plate_seconds(profile, 0.0, 200.0, 60.0, 1.2)
    assert overhead_s == compute_plate_seconds(profile, 0.0, 200.0, 60.0)
    assert compute_plate_seconds(profile, 1000.0, 200.0, 60.0, 1.2) == pytest.approx(overhead_s + 1200.0)


def compute_makespan(loads_s, new_printers, factors):
    return max(load_s * factors[new_printers[name]] for name, load_s in loads_s.items())


@given(
    st.dictionaries(st.sampled_from(NAMES), LOADS_S, min_size=1),
    st.fixed_dictionaries(dict.fromkeys(NAMES, FACTORS)),
    st.fixed_dictionaries({name: st.sampled_from(["low", "tall"]) for name in NAMES}),
)
def test_loads_move_only_between_equal_printers_without_delay(loads_s, factors, kinds):
    new_printers = reassign_loads(loads_s, kinds, factors)
    assert sorted(new_printers) == sorted(new_printers.values()) == NAMES
    assert all(kinds[item] == kinds[other_item] for item, other_item in new_printers.items())
    unchanged_printers = {name: name for name in NAMES}
    assert compute_makespan(loads_s, new_printers, factors) <= compute_makespan(
        loads_s, unchanged_printers, factors
    )


def test_loads_stay_without_learned_factors():
    kinds = dict.fromkeys(NAMES, "low")
    assert reassign_loads({"a": 1.0, "b": 9.0}, kinds, {}) == {name: name for name in NAMES}


def test_single_part_is_moved_to_the_fastest_printer():
    new_printers = reassign_loads({"a": 5.0}, {"a": 0, "b": 0}, {"a": 1.1, "b": 0.9})
    assert new_printers == {"a": "b", "b": "a"}
