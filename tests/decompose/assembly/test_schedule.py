"""Schedule of an assembly: work while glue dries, and the longest chain."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from decompose.assembly.schedule import StepWork, compute_critical_path_s, order_steps


def make_work(*bodies: set[int]) -> StepWork:
    a, b = bodies
    return StepWork((frozenset(a), frozenset(b)), joint_count=1, glue_mm2=500.0, is_steady=True)


def test_person_glues_the_next_pair_while_the_first_dries() -> None:
    works = [make_work({0}, {1}), make_work({0, 1}, {2}), make_work({3}, {4}), make_work({0, 1, 2}, {3, 4})]
    order = order_steps(works, drying_s=100.0)
    assert [number for number, _ in order] == [0, 2, 1, 3]
    assert order[1][1] == pytest.approx(works[0].work_s)
    assert order[2][1] == pytest.approx(works[0].work_s + works[2].work_s)


def test_person_waits_if_no_other_step_is_ready() -> None:
    works = [make_work({0}, {1}), make_work({0, 1}, {2})]
    order = order_steps(works, drying_s=1000.0)
    assert order == [(0, 0.0), (1, pytest.approx(works[0].work_s + 1000.0))]
    assert compute_critical_path_s(works, drying_s=1000.0) == pytest.approx(order[1][1] + works[1].work_s)


def test_step_takes_longer_with_more_joints_more_glue_or_a_single_part() -> None:
    work = StepWork((frozenset({0, 1}), frozenset({2, 3})), 1, 100.0, is_steady=True)
    assert StepWork(work.bodies, 2, 100.0, is_steady=True).work_s > work.work_s
    assert StepWork(work.bodies, 1, 900.0, is_steady=True).work_s > work.work_s
    assert StepWork(work.bodies, 1, 100.0, is_steady=False).work_s > work.work_s
    assert StepWork((frozenset({0}), frozenset({2, 3})), 1, 100.0, is_steady=True).work_s > work.work_s


@st.composite
def draw_trees(draw: st.DrawFn) -> list[StepWork]:
    """Draw a random tree of steps, in which each step follows the steps that make its bodies."""
    bodies = [{part} for part in range(draw(st.integers(2, 12)))]
    works = []
    while len(bodies) > 1:
        a = bodies.pop(draw(st.integers(0, len(bodies) - 1)))
        b = bodies.pop(draw(st.integers(0, len(bodies) - 1)))
        works.append(make_work(a, b))
        bodies.append(a | b)
    return works


@given(draw_trees(), st.floats(0.0, 2000.0))
def test_no_step_begins_before_its_bodies_are_dry(works: list[StepWork], drying_s: float) -> None:
    order = order_steps(works, drying_s)
    assert sorted(number for number, _ in order) == list(range(len(works)))
    dry_at_s = {
        work.parts: at_s + work.work_s + drying_s for work, (_, at_s) in pair_with_order(works, order)
    }
    for work, (_, at_s) in pair_with_order(works, order):
        assert all(at_s >= dry_at_s[body] - 1e-6 for body in work.bodies if body in dry_at_s)
    end_s = max(at_s + works[number].work_s for number, at_s in order)
    busy_s = sum(work.work_s for work in works)
    assert (
        max(busy_s, compute_critical_path_s(works, drying_s)) - 1e-6
        <= end_s
        <= busy_s + drying_s * len(works)
    )


def pair_with_order(
    works: list[StepWork], order: list[tuple[int, float]]
) -> list[tuple[StepWork, tuple[int, float]]]:
    return [(works[number], (number, at_s)) for number, at_s in order]
