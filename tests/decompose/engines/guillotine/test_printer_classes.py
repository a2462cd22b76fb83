"""Classes of equal printers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from decompose.engines.guillotine import classify_printers
from decompose.engines.guillotine.partitioner import list_class_states
from decompose.engines.guillotine.printer_classes import count_divisions
from decompose.printers import TargetPrinter

PLUS_BOXES = ((206.9, 190.9, 205.0), (164.9, 206.9, 205.0))
EXTENDED_BOXES = tuple((x, y, 305.0) for x, y, _ in PLUS_BOXES)
FLAT_BOXES = ((250.0, 150.0, 100.0),)


def make_printers(
    *boxes_and_factors: tuple[tuple[tuple[float, float, float], ...], float],
) -> list[TargetPrinter]:
    return [TargetPrinter(str(i), *item) for i, item in enumerate(boxes_and_factors)]


def test_equal_printers_are_one_class() -> None:
    (printer_class,) = classify_printers(make_printers(*[(PLUS_BOXES, 1.1)] * 5), 100.0)
    assert (printer_class.box_sizes_mm, printer_class.time_factor, printer_class.count) == (
        PLUS_BOXES,
        1.1,
        5,
    )


def test_different_volumes_are_classes_but_similar_speeds_are_not() -> None:
    fleet = make_printers(*[(PLUS_BOXES, 1.0 + 0.002 * i) for i in range(8)], *[(EXTENDED_BOXES, 1.0)] * 3)
    result = classify_printers(fleet, 100.0)
    assert [(item.box_sizes_mm, item.count) for item in result] == [(PLUS_BOXES, 8), (EXTENDED_BOXES, 3)]
    assert result[0].time_factor == 1.014


def test_speeds_are_separated_into_classes_before_volumes() -> None:
    fleet = make_printers(*[(PLUS_BOXES, 1.0)] * 12, *[(PLUS_BOXES, 0.4)] * 3, *[(EXTENDED_BOXES, 1.0)] * 4)
    three_classes = classify_printers(fleet, 1000.0)
    assert [item.count for item in three_classes] == [12, 4, 3]
    two_classes = classify_printers(fleet, 20.0)
    assert [(item.count, item.time_factor) for item in two_classes] == [(16, 1.0), (3, 0.4)]
    assert two_classes[0].box_sizes_mm == PLUS_BOXES


factors = st.floats(0.3, 2.0)
box_choices = st.sampled_from([PLUS_BOXES, EXTENDED_BOXES, FLAT_BOXES])


@given(
    fleet=st.lists(st.tuples(box_choices, factors), min_size=1, max_size=20), max_count=st.integers(1, 200)
)
def test_each_printer_of_a_class_can_print_its_parts(
    fleet: list[tuple[tuple[tuple[float, float, float], ...], float]], max_count: int
) -> None:
    result = classify_printers(make_printers(*fleet), max_count)
    members = [printer.name for item in result for printer in item.printers]
    assert sorted(members) == sorted(str(i) for i in range(len(fleet)))
    assert len(result) == 1 or count_divisions([item.count for item in result]) <= max_count
    for item in result:
        for printer in item.printers:
            assert printer.time_factor <= item.time_factor
            assert all(printer.fits(*box) for box in item.box_sizes_mm)


@given(counts=st.lists(st.integers(1, 4), min_size=1, max_size=3))
def test_count_divisions_equals_the_number_of_sums_in_the_search(counts: list[int]) -> None:
    assert count_divisions(counts) == len(list_class_states(sorted(counts)[:-1])[1])
