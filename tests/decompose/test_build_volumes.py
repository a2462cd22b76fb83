"""Build volumes as arrays."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from decompose.build_volumes import fits_all, list_build_volumes
from decompose.printers import TargetPrinter

sizes_mm = st.tuples(*[st.sampled_from([50.0, 100.0, 100.5, 200.0, 300.0])] * 3)


@given(st.lists(st.lists(sizes_mm, min_size=1, max_size=3), max_size=3), sizes_mm)
def test_a_part_fits_all_build_volumes_if_it_fits_every_printer(
    volumes: list[list[tuple[float, float, float]]], size_mm: tuple[float, float, float]
) -> None:
    printers = [TargetPrinter(str(number), tuple(boxes)) for number, boxes in enumerate(volumes)]
    expected = all(printer.fits(*size_mm) for printer in printers)
    assert fits_all(list_build_volumes(printers), *size_mm) == expected
