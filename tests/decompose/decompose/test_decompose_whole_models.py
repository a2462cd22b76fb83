"""Complete models, which are cut without a fault, or refused with the reason."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.results import Decomposition

BOXES_MM = ((170.0, 170.0, 200.0),)
box = Solid.box


def make_ball(radius_mm: float, centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Solid:
    sphere = trimesh.creation.icosphere(3, radius_mm)
    return Solid.from_arrays(sphere.vertices + np.array(centre_mm), sphere.faces)


def make_nested_bodies() -> Solid:
    hollow = box((0, 0, 0), (260, 260, 260)).subtract(box((20, 20, 20), (240, 240, 240)))
    return Solid.union([hollow, box((100, 100, 100), (150, 150, 150))])


def make_touching_bodies() -> Solid:
    return Solid.union([box((0, 0, 0), (150, 100, 80)), box((150, 100, 0), (300, 200, 80))])


def make_separate_bodies() -> Solid:
    return Solid.union(
        [box((0, 0, 0), (150, 100, 80)), box((200, 0, 0), (300, 100, 80)), make_ball(40, (90, 250, 60))]
    )


def make_sheet() -> Solid:
    return box((0, 0, 0), (400, 300, 2))


def make_wall() -> Solid:
    return box((0, 0, 0), (400, 2, 300))


def make_pins() -> Solid:
    """Make a slab with pins as thin as a line of filament."""
    pins = [box((20 * i + 10, 15 * i + 10, 59), (20 * i + 10.3, 15 * i + 10.3, 62)) for i in range(10)]
    return Solid.union([box((0, 0, 0), (300, 200, 60)), *pins])


def make_cube(side_mm: float) -> Callable[[], Solid]:
    return lambda: box((0, 0, 0), (side_mm, side_mm, side_mm))


def make_pyramid() -> Solid:
    """Make a model with steps of 40 mm, which coincide with the planes of a grid of 40 mm."""
    return Solid.union(
        [box((40 * i, 40 * i, 40 * i), (400 - 40 * i, 400 - 40 * i, 40 * i + 40)) for i in range(5)]
    )


def make_pipe() -> Solid:
    return box((0, 0, 0), (300, 300, 300)).subtract(box((1, 1, -1), (299, 299, 301)))


def cut_solid(solid: Solid, cost: CostModel, printers: int, granularity: int) -> Decomposition:
    target_printers = [TargetPrinter(f"um-{i}", BOXES_MM) for i in range(printers)]
    options = Options(Engine.GUILLOTINE, granularity, prove=False)
    return decompose_model(Model(solid, (), 1.0), target_printers, options, cost)


@pytest.mark.parametrize(
    ("make_solid", "granularity", "printers"),
    [
        (make_nested_bodies, 6, 12),
        (make_touching_bodies, 6, 8),
        (make_separate_bodies, 6, 8),
        (make_sheet, 3, 10),
        (make_wall, 3, 10),
        (make_pins, 6, 8),
        (make_cube(100.0), 5, 8),
        (make_cube(200.0), 5, 8),
        (make_cube(400.0), 8, 27),
        (make_pyramid, 5, 20),
        (make_pipe, 5, 16),
    ],
)
def test_whole_models_are_cut_without_faults(
    make_solid: Callable[[], Solid], granularity: int, printers: int, cost: CostModel
) -> None:
    solid = make_solid()
    result = cut_solid(solid, cost, printers, granularity)
    assert 2 <= len(result.parts) <= printers
    assert result.faults == ()
    assert result.coverage.surface_error < 1e-6
    assert sum(p.solid.volume_mm3 for p in result.parts) <= solid.volume_mm3 * (1.0 + 1e-9)
    held_joints = [j for j in result.joints if j.area_mm2 >= 25.0]
    assert len(held_joints) >= len(result.parts) - len(solid.list_pieces())


def test_model_that_fits_one_printer_is_not_cut(cost: CostModel) -> None:
    solid = make_ball(30.0)
    result = cut_solid(solid, cost, 1, 6)
    (part,) = result.parts
    assert part.solid.volume_mm3 == pytest.approx(solid.volume_mm3)
    assert result.joints == ()


def test_sufficient_number_of_printers_is_reported(cost: CostModel) -> None:
    with pytest.raises(NoFit, match=r"400 x 400 x 400 mm needs \d+ parts.*there are 2") as error:
        cut_solid(make_cube(400.0)(), cost, 2, 8)
    needed_printer_count = error.value.needed_printer_count
    assert needed_printer_count is not None
    assert len(cut_solid(make_cube(400.0)(), cost, needed_printer_count, 8).parts) <= needed_printer_count


def test_model_too_large_for_any_fleet_is_reported(cost: CostModel) -> None:
    """Use a bed that is smaller than a cell of the finest grid."""
    target_printers = [TargetPrinter(f"um-{i}", ((10.0, 10.0, 10.0),)) for i in range(50)]
    with pytest.raises(NoFit, match=r"printers with room for \d+ mm along each axis would be enough"):
        decompose_model(
            Model(make_ball(200.0), (), 1.0), target_printers, Options(Engine.GUILLOTINE, 8), cost
        )


def test_rod_of_100_m_is_refused_before_a_grid_is_built(
    cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse_call(*_: object) -> None:
        raise AssertionError("a grid is built")

    monkeypatch.setattr("decompose.problem.problem.build_grid", refuse_call)
    with pytest.raises(NoFit, match=r"100000 x 4 x 4 mm needs 320 parts at least.*there are 20") as error:
        cut_solid(box((0, 0, 0), (100_000, 4, 4)), cost, 20, 10)
    assert "\n" not in str(error.value)
    assert error.value.needed_printer_count is None
    with pytest.raises(NoFit, match=r"needs 5 parts at least.*there are 3") as error:
        cut_solid(box((0, 0, 0), (1_300, 4, 4)), cost, 3, 10)
    assert error.value.needed_printer_count == 5
    distant_boxes = Solid.union([box((0, 0, 0), (50, 50, 50)), box((99_950, 0, 0), (100_000, 50, 50))])
    with pytest.raises(AssertionError, match="a grid is built"):
        cut_solid(distant_boxes, cost, 20, 10)
