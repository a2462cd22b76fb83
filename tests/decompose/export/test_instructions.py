"""Instructions for assembly: all parts and joints, nothing loaded, and glue in each picture."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from decompose.assembly import Assembly
from decompose.decompose import decompose_model
from decompose.export.instructions import Pictures, render_instructions, write_instructions
from decompose.export.layout import draw_layout
from decompose.export.page_check import find_page_faults
from decompose.export.picture import part_colours
from decompose.export.raster import make_camera
from decompose.export.step_picture import (
    GLUE_COLOUR,
    choose_camera,
    draw_steps,
    find_glued_faces,
)
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.pieces import find_joints, list_box_planes
from decompose.print_time import CostModel
from decompose.printers import PrinterRoom
from decompose.results import Decomposition


@pytest.fixture(scope="module")
def table() -> Decomposition:
    """A table that is cut for four printers."""
    legs = [Solid.box((x, y, 0), (x + 20, y + 20, 90)) for x in (0, 100) for y in (0, 100)]
    solid = Solid.union([Solid.box((0, 0, 80), (120, 120, 100)), *legs])
    rooms = [PrinterRoom(name, ((80.0, 130.0, 130.0),)) for name in "abcd"]
    options = Options(engine=Engine.GUILLOTINE, granularity=8, prove=False)
    return decompose_model(
        Model(solid, (), 1.0), rooms, options, CostModel(1.0, *[1e-3] * 7, brim_mm=0.0)
    ).with_assembly()


@pytest.fixture(scope="module")
def pinwheel(table: Decomposition) -> Decomposition:
    """Four bricks around a fifth, which have no plane in common."""
    spans = [
        ((0, 0, 0), (40, 20, 20)),
        ((40, 0, 0), (60, 40, 20)),
        ((20, 40, 0), (60, 60, 20)),
        ((0, 20, 0), (20, 60, 20)),
        ((20, 20, 0), (40, 40, 20)),
    ]
    parts = []
    for number, span in enumerate(spans, 1):
        own = {
            "id": f"p{number:02d}",
            "solid": Solid.box(*span),
            "planes": list_box_planes(np.array(span, float)),
        }
        parts.append(replace(table.parts[0], **own))
    joints = tuple(find_joints(parts))
    return replace(table.without_parts(), parts=tuple(parts), joints=joints).with_assembly()


def pictures_of(page: str) -> list[Image.Image]:
    return [
        Image.open(BytesIO(base64.b64decode(data))).convert("RGB")
        for data in re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    ]


def count_glue(picture: Image.Image) -> int:
    """Count pixels in a shade of the colour of glue."""
    pixels = np.asarray(picture, dtype=np.float64) / 255.0
    shade = pixels[..., 0:1]
    return int(((np.abs(pixels - shade * GLUE_COLOUR) < 0.03).all(axis=2) & (shade[..., 0] > 0.3)).sum())


def test_the_page_names_every_part_and_joint_once_and_loads_nothing(table: Decomposition) -> None:
    page = render_instructions(table, Pictures(draw_steps(table)))
    rows = re.findall(r"<tr[^>]*><td>(p\d+)</td>", page)
    assert rows == [table.parts[number].id for number in table.assembly.part_order]
    assert sorted(rows) == [part.id for part in table.parts]
    names = re.findall(r"<tr[^>]*><td>(\d+-\d+)</td>", page)
    assert len(names) == len(table.joints) and len(set(names)) == len(names)
    assert all(source.startswith("data:") for source in re.findall(r'(?:src|href)="([^"]*)"', page))
    assert "url(" not in page and "<script" not in page and "@import" not in page
    assert len(pictures_of(page)) == len(table.parts) - 1
    assert find_page_faults(page, table) == []


def test_every_picture_shows_where_the_glue_goes(table: Decomposition) -> None:
    page = render_instructions(table, Pictures(draw_steps(table)))
    assert [count_glue(picture) > 200 for picture in pictures_of(page)] == [True] * len(table.assembly.steps)


def test_faces_point_away_from_the_fixed_body_also_where_they_slide(pinwheel: Decomposition) -> None:
    assert any(step.slides for step in pinwheel.assembly.steps)
    for step in pinwheel.assembly.steps:
        for entry in find_glued_faces(step, pinwheel):
            inside = np.array(entry.face.outline.representative_point().coords[0]) @ entry.face.axes
            point = inside + entry.face.offset_mm * entry.face.normal - 0.5 * entry.outward
            bounds = [pinwheel.parts[part].solid.bounds_mm for part in step.fixed]
            assert any((lo < point).all() and (point < hi).all() for lo, hi in bounds)


def test_view_before_is_kept_or_approached(table: Decomposition) -> None:
    glued = find_glued_faces(table.assembly.steps[0], table)
    best = choose_camera(glued, None)
    views = [make_camera(azimuth, elevation) for azimuth in range(0, 360, 45) for elevation in (-22, 22, 45)]
    gains = [float(choose_camera(glued, view)[2] @ view[2] - best[2] @ view[2]) for view in views]
    assert min(gains) > -1e-9
    assert max(gains) > 0.1


def test_parts_without_an_order_are_named(table: Decomposition) -> None:
    page = render_instructions(replace(table, assembly=Assembly((), ((0, 1),))), Pictures())
    assert "p01, p02 cannot be joined" in page


def test_check_of_the_page_tells_what_is_missing_doubled_or_loaded(table: Decomposition) -> None:
    page = render_instructions(table, Pictures(draw_steps(table)))
    name = table.parts[0].id
    assert find_page_faults(page.replace(f'data-part="{name}"', ""), table) == [f"part {name} is missing"]
    row = re.search(r"<tr data-joint.*?</tr>", page, re.S)
    assert row is not None
    [doubled] = find_page_faults(page.replace(row[0], 2 * row[0]), table)
    assert doubled.startswith("joint p") and doubled.endswith("is named too often")
    remote = page.replace("<h1>", '<img src="https://example.org/x.png"><h1>')
    assert find_page_faults(remote, table) == ["it loads https://example.org/x.png"]
    styled = page.replace("<style>", "<style>@import 'x';")
    assert find_page_faults(styled, table) == ["its style loads something"]


def test_page_with_a_fault_says_so_first(
    table: Decomposition, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "decompose.export.instructions.find_page_faults", lambda *_: ["joint p01 p02 is missing"]
    )
    write_instructions(table, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert page.index("is not complete") < page.index("joint p01 p02 is missing") < page.index("Step 1")


def test_layout_shows_every_part_in_its_colour(table: Decomposition) -> None:
    picture = Image.open(BytesIO(draw_layout(table.parts, table.assembly.part_order))).convert("RGB")
    pixels = np.asarray(picture, dtype=np.float64) / 255.0
    for colour in part_colours(len(table.parts)):
        shares = pixels / colour
        alike = (np.ptp(shares, axis=2) < 0.05) & (shares.max(axis=2) > 0.45)
        assert alike.sum() > 300
