"""Assignment of parts to printers that minimises the end of the last part."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from decompose.decompose import decompose_model
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.pieces import solve_bottleneck_assignment
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter


@given(
    part_count=st.integers(1, 4),
    spare_count=st.integers(-1, 2),
    fit_share=st.floats(0.3, 1.0),
    seed=st.integers(0, 10**6),
)
def test_assignment_minimises_the_end_of_the_last_part(
    part_count: int, spare_count: int, fit_share: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    printer_count = max(1, part_count + spare_count)
    seconds = np.outer(rng.integers(1, 9, part_count) * 100.0, rng.choice([0.9, 1.0, 1.2], printer_count))
    seconds[rng.random(seconds.shape) > fit_share] = np.inf
    all_assignments = [
        seconds[range(part_count), list(p)] for p in permutations(range(printer_count), part_count)
    ]
    best_times_s = min(((t.max(), t.sum()) for t in all_assignments), default=(np.inf, np.inf))
    result = solve_bottleneck_assignment(seconds)
    if result is None:
        assert np.isinf(best_times_s[0])
        return
    assert len(set(result)) == part_count
    times_s = seconds[range(part_count), result]
    assert times_s.max() == best_times_s[0]
    assert abs(times_s.sum() - best_times_s[1]) < 1e-3


def test_assignment_succeeds_where_a_greedy_choice_fails() -> None:
    fits = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    result = solve_bottleneck_assignment(np.where(fits > 0.0, 60.0, np.inf))
    assert result is not None
    assert result[0] == 1


def test_first_of_equal_printers_are_used() -> None:
    assert sorted(solve_bottleneck_assignment(np.full((3, 6), 60.0)) or []) == [0, 1, 2]


def test_quickest_printer_takes_the_longest_part(
    ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    printers = [replace(fleet[0], name=str(i), time_factor=1.5 - 0.2 * i) for i in range(3)]
    options = Options(Engine.GUILLOTINE, granularity="vcoarse", prove=False)
    parts = decompose_model(Model(ring_with_bar, (), 1.0), printers, options, cost).parts
    sorted_parts = sorted(parts, key=lambda part: -part.price_s)
    assert [part.printer for part in sorted_parts] == ["2", "1", "0"]
