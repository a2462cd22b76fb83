"""Each rule refuses a result that breaks it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decompose.decompose import decompose_model
from decompose.errors import GeometryError, Rule
from decompose.export import write_decomposition
from decompose.geometry import Model, Solid
from decompose.grid import Box, Grid, GridRules, build_grid
from decompose.options import Options
from decompose.pieces import cut_cells
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.results import Decomposition, Part, check_stl
from decompose.results.check import check_missing_volume, check_result

SIZE_MM = (60.0, 40.0, 20.0)
PRINTERS = [TargetPrinter(f"p{i}", ((50.0, 50.0, 50.0),)) for i in range(3)]


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(Solid.box((0, 0, 0), SIZE_MM), (), 1.0)


@pytest.fixture(scope="module")
def grid(model: Model) -> Grid:
    vertices, faces = model.solid.arrays()
    return build_grid(vertices[faces], 6, GridRules(5.0, False, 0.7, 0.75))


@pytest.fixture(scope="module")
def halves(grid: Grid) -> list[Box]:
    nx, ny, nz = grid.shape
    return [(0, 0, 0, nx // 2, ny, nz), (nx // 2, 0, 0, nx, ny, nz)]


def make_part(solid: Solid, name: str, printer: str) -> Part:
    matrix = np.eye(4)
    lo, hi = solid.bounds_mm
    matrix[:3, 3] = [*(lo + hi)[:2] / 2.0, lo[2]]
    return Part(name, solid, matrix, 100.0, printer)


def convert_to_mm(grid: Grid, boxes: list[Box]) -> np.ndarray:
    return np.array([grid.find_bounds_mm(box) for box in boxes])


@pytest.fixture(scope="module")
def valid_result(model: Model, grid: Grid, halves: list[Box]) -> Decomposition:
    cost = CostModel(1.0, *[1e-3] * 7, brim_mm=0.0)
    base_result = decompose_model(model, PRINTERS, Options(granularity=6, min_wall_mm=5.0), cost)
    parts = [
        replace(make_part(piece.solid, f"p{i + 1:02d}", f"p{i}"), planes=piece.planes)
        for i, box in enumerate(halves)
        for piece in cut_cells(model.solid, grid, box)
    ]
    return replace(base_result.without_parts(), parts=tuple(parts))


def test_valid_result_passes_all_rules(
    valid_result: Decomposition, model: Model, grid: Grid, halves: list[Box]
) -> None:
    coverage = check_result(valid_result.parts, convert_to_mm(grid, halves), model, PRINTERS, 5.0)
    assert coverage.surface_error < 1e-9
    assert coverage.overlap_mm3 == 0.0


def overlap_parts(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    """Extend the second part by 1 mm into the first."""
    lo, hi = parts[1].solid.bounds_mm
    return [parts[0], replace(parts[1], solid=Solid.box((lo[0] - 1.0, lo[1], lo[2]), hi))]


def repeat_part(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    return [*parts, replace(parts[0], id="p03", printer="p2")]


def drop_part(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    return parts[:1]


def repeat_printer(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    return [parts[0], replace(parts[1], printer=parts[0].printer)]


def rename_printer(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    return [parts[0], replace(parts[1], printer="nobody")]


def enlarge_part(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    return [replace(parts[0], solid=model.solid)]


def split_part(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    separate_boxes = Solid.union([Solid.box((0, 0, 0), (5, 5, 5)), Solid.box((10, 0, 0), (15, 5, 5))])
    return [replace(parts[0], solid=separate_boxes), parts[1]]


def empty_part(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    return [replace(parts[0], solid=parts[0].solid.clip((900, 900, 900), (901, 901, 901))), parts[1]]


def hollow_part(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    """Remove material inside the first part without changing its surface."""
    lo, hi = parts[0].solid.bounds_mm
    return [replace(parts[0], solid=parts[0].solid.subtract(Solid.box(lo + 8.0, hi - 8.0))), parts[1]]


def notch_edge(parts: list[Part], model: Model, grid: Grid) -> list[Part]:
    """Cut a notch into an edge."""
    notch = Solid.box((5.0, -1.0, 19.0), (6.0, 1.0, 21.0))
    return [replace(parts[0], solid=parts[0].solid.subtract(notch)), parts[1]]


@pytest.mark.parametrize(
    ("damage", "rule", "name"),
    [
        (overlap_parts, Rule.NO_OVERLAP, "p02"),
        (repeat_part, Rule.NO_OVERLAP, "p03"),
        (drop_part, Rule.SURFACE, None),
        (notch_edge, Rule.SURFACE, None),
        (hollow_part, Rule.SURFACE, None),
        (repeat_printer, Rule.OWN_PRINTER, "p02"),
        (rename_printer, Rule.FITS, "p02"),
        (enlarge_part, Rule.FITS, "p01"),
        (split_part, Rule.ONE_PIECE, "p01"),
        (empty_part, Rule.CLOSED, "p01"),
    ],
)
def test_broken_rule_is_named(
    valid_result: Decomposition,
    model: Model,
    grid: Grid,
    halves: list[Box],
    damage: Callable[[list[Part], Model, Grid], list[Part]],
    rule: Rule,
    name: str | None,
) -> None:
    damaged_result = replace(valid_result, parts=tuple(damage(list(valid_result.parts), model, grid)))
    with pytest.raises(GeometryError) as error:
        check_result(damaged_result.parts, convert_to_mm(grid, halves), model, PRINTERS, 5.0)
    assert (error.value.rule, error.value.part) == (rule, name)
    assert str(rule) in str(error.value)


def test_hollows_must_be_whole_cells_inside_the_wall(cost: CostModel) -> None:
    block = Model(Solid.box((0, 0, 0), (100, 100, 100)), (), 1.0)
    vertices, faces = block.solid.arrays()
    grid = build_grid(vertices[faces], 10, GridRules(15.0, False, 0.7, 0.75))
    printers = [TargetPrinter("p", ((500.0, 500.0, 500.0),))]
    base_result = decompose_model(block, printers, Options(granularity=10, min_wall_mm=15.0), cost)
    shell = block.solid.subtract(Solid.box(*grid.find_bounds_mm((4, 4, 4, 6, 6, 6))))
    thin_walled_solid = block.solid.subtract(Solid.box(*grid.find_bounds_mm((1, 4, 4, 6, 6, 6))))

    def list_boxes_around(lo: int) -> list[Box]:
        """List the boxes around the hollow [lo, 6) x [4, 6) x [4, 6)."""
        return [
            (0, 0, 0, lo, 10, 10), (6, 0, 0, 10, 10, 10), (lo, 0, 0, 6, 4, 10),
            (lo, 6, 0, 6, 10, 10), (lo, 4, 0, 6, 6, 4), (lo, 4, 6, 6, 6, 10),
        ]  # fmt: skip

    hollow_result = replace(base_result, parts=(make_part(shell, "p01", "p"),))
    check_missing_volume(hollow_result.parts, convert_to_mm(grid, list_boxes_around(4)), block, 15.0)
    with pytest.raises(GeometryError) as error:
        check_missing_volume(hollow_result.parts, convert_to_mm(grid, [(0, 0, 0, 10, 10, 10)]), block, 15.0)
    assert error.value.rule == Rule.INTERIOR
    thin_result = replace(base_result, parts=(make_part(thin_walled_solid, "p01", "p"),))
    with pytest.raises(GeometryError) as error:
        check_missing_volume(thin_result.parts, convert_to_mm(grid, list_boxes_around(1)), block, 15.0)
    assert error.value.rule == Rule.WALL


@pytest.mark.parametrize(("top_mm", "gap_mm"), [(199.0, 1.0), (189.0, None)])
def test_wall_is_measured_to_faces_not_only_to_their_corners(
    cost: CostModel, top_mm: float, gap_mm: float | None
) -> None:
    """Use a cube whose corners and face centres are far from a hollow under one of its faces."""
    cube = Model(Solid.box((0, 0, 0), (200, 200, 200)), (), 1.0)
    vertices, faces = cube.solid.arrays()
    printers = [TargetPrinter("p", ((500.0, 500.0, 500.0),))]
    base_result = decompose_model(cube, printers, Options(granularity=6, min_wall_mm=10.0), cost)
    plain_grid = build_grid(vertices[faces], 3, GridRules(10.0, False, 0.7, 0.75))
    x, z = np.array([-1.0, 150.0, 170.0, 201.0]), np.array([-1.0, top_mm - 20.0, top_mm, 201.0])
    cuts = (np.ones((4, 3, 3)), np.ones((3, 4, 3)), np.ones((3, 3, 4)))
    grid = replace(plain_grid, planes=(x, x, z), cuts=cuts)  # its middle cell is the hollow
    boxes_around: list[Box] = [
        (0, 0, 0, 1, 3, 3), (2, 0, 0, 3, 3, 3), (1, 0, 0, 2, 1, 3),
        (1, 2, 0, 2, 3, 3), (1, 1, 0, 2, 2, 1), (1, 1, 2, 2, 2, 3),
    ]  # fmt: skip
    assert grid.shape == (3, 3, 3)
    shell = cube.solid.subtract(Solid.box((150.0, 150.0, top_mm - 20.0), (170.0, 170.0, top_mm)))
    hollow_result = replace(base_result, parts=(make_part(shell, "p01", "p"),))
    if gap_mm is None:
        check_missing_volume(hollow_result.parts, convert_to_mm(grid, boxes_around), cube, 10.0)
        return
    with pytest.raises(GeometryError, match=f"is {gap_mm:.2f} mm from the surface") as error:
        check_missing_volume(hollow_result.parts, convert_to_mm(grid, boxes_around), cube, 10.0)
    assert error.value.rule == Rule.WALL


def test_damaged_stl_is_refused(valid_result: Decomposition, tmp_path: Path) -> None:
    files = write_decomposition(valid_result, tmp_path)
    path = tmp_path / files.parts[0].file
    data = bytearray(path.read_bytes())
    check_stl(path, files.parts[0])
    triangle_count = int.from_bytes(data[80:84], "little") - 1
    path.write_bytes(data[:80] + triangle_count.to_bytes(4, "little") + data[84:-50])
    with pytest.raises(GeometryError, match="not watertight"):
        check_stl(path, files.parts[0])
    path.write_bytes(bytes(84))  # no triangles
    with pytest.raises(GeometryError, match="not watertight"):
        check_stl(path, files.parts[0])
    with pytest.raises(GeometryError, match="mm3 instead of"):
        check_stl(
            tmp_path / files.parts[1].file, replace(files.parts[0], solid=Solid.box((0, 0, 0), SIZE_MM))
        )
