"""No partition ends before its surface and its volume are printed."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.bound import surface_bound_s
from decompose.geometry import Solid
from decompose.print_time import CostModel, Recipe, axis_prices_s

COST = CostModel.from_recipe(Recipe(prelude_s=60.0))
sizes = st.floats(3.0, 200.0)


@settings(deadline=None)  # the first call compiles
@given(sizes, sizes, sizes, st.integers(1, 9))
def test_slabs_of_a_block_never_end_before_it(width: float, depth: float, height: float, slabs: int) -> None:
    """Small slabs too, whose flat sides are all rim and whose walls are all inset."""
    slab = axis_prices_s(*Solid.box((0, 0, 0), (width, depth, height / slabs)).arrays(), COST)
    block = Solid.box((0, 0, 0), (width, depth, height))
    assert slab.min() >= surface_bound_s(block.area_mm2, block.volume_mm3, slabs, COST)
