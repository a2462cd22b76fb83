"""Size that a refusal advises: the model can be cut at this size, but not at a slightly larger one."""

from __future__ import annotations

import pytest

from decompose.advised_size import advise_longest_side_mm
from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from tests.decompose.conftest import PLUS_BOXES

OPTIONS = Options(Engine.GUILLOTINE, 4, prove=False)


def make_block(size_mm: tuple[float, float, float]) -> Model:
    return Model(Solid.box((0.0, 0.0, 0.0), size_mm), (), 1.0)


@pytest.mark.parametrize(
    ("size_mm", "printers", "min_mm", "max_mm"),
    [
        ((300.0, 300.0, 300.0), 4, 200, 207),  # the cube root of the volume gives 238, which is refused
        ((210.0, 210.0, 210.0), 2, 200, 207),  # the cube root of the volume gives 166, which is too small
        ((2000.0, 20.0, 20.0), 3, 560, 640),
    ],
)
def test_advised_size_can_be_cut(
    size_mm: tuple[float, float, float], printers: int, min_mm: int, max_mm: int, cost: CostModel
) -> None:
    target_printers = [TargetPrinter(str(number), PLUS_BOXES) for number in range(printers)]
    with pytest.raises(NoFit, match="give a smaller --longest-side") as error:
        decompose_model(make_block(size_mm), target_printers, OPTIONS, cost)
    assert error.value.is_too_large
    side_mm = advise_longest_side_mm(make_block(size_mm), target_printers, OPTIONS, cost)
    assert side_mm is not None
    assert min_mm <= side_mm <= max_mm
    x_mm, y_mm, z_mm = (side_mm / max(size_mm) * side for side in size_mm)
    assert (
        len(decompose_model(make_block((x_mm, y_mm, z_mm)), target_printers, OPTIONS, cost).parts) <= printers
    )
