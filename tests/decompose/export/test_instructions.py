"""Instructions for assembly: all parts and joints, no external files, and glue in each picture."""

from __future__ import annotations

import base64
import pickle
import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from decompose.assembly import Assembly
from decompose.decompose import decompose_model
from decompose.export import draw_parts
from decompose.export.instructions import Pictures, render_instructions, write_instructions
from decompose.export.layout import draw_layout
from decompose.export.page_check import find_page_faults
from decompose.export.picture import make_part_colours
from decompose.export.pin_sheet import draw_gauge
from decompose.export.raster import draw_shapes, make_camera
from decompose.export.step_picture import (
    ELEVATIONS_DEG,
    StepPictures,
    choose_view,
    draw_steps,
    find_pose,
    name_top_direction,
    turn_pose_over,
)
from decompose.export.step_scene import (
    GLUE_COLOUR,
    MARK_COLOUR,
    PIN_COLOUR,
    build_both_bodies,
    build_moved_body,
    find_glued_faces,
)
from decompose.files.names import ASSEMBLY, INSTRUCTIONS, PICTURE
from decompose.geometry import Model, Solid
from decompose.options import ConnectorOptions, Engine, Options
from decompose.pieces import find_joints, list_box_planes
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.results import Decomposition, connect_parts


@pytest.fixture(scope="module")
def table() -> Decomposition:
    """Cut a table for four printers."""
    legs = [Solid.box((x, y, 0), (x + 20, y + 20, 90)) for x in (0, 100) for y in (0, 100)]
    solid = Solid.union([Solid.box((0, 0, 80), (120, 120, 100)), *legs])
    printers = [TargetPrinter(name, ((80.0, 130.0, 130.0),)) for name in "abcd"]
    options = Options(engine=Engine.GUILLOTINE, granularity=8, prove=False)
    return decompose_model(
        Model(solid, (), 1.0), printers, options, CostModel(1.0, *[1e-3] * 7, brim_mm=0.0)
    ).with_assembly()


@pytest.fixture(scope="module")
def drilled_table(table: Decomposition) -> Decomposition:
    """Add pins and marks to the table."""
    options = replace(table.options, connectors=ConnectorOptions(2.85, marks=True))
    return connect_parts(replace(table, options=options))


@pytest.fixture(scope="module")
def step_pictures(drilled_table: Decomposition) -> list[StepPictures]:
    return draw_steps(drilled_table)


@pytest.fixture(scope="module")
def page(drilled_table: Decomposition, step_pictures: list[StepPictures]) -> str:
    return render_instructions(drilled_table, Pictures(step_pictures))


@pytest.fixture(scope="module")
def pinwheel(table: Decomposition) -> Decomposition:
    """Make four bricks around a fifth, without a common plane."""
    spans = [
        ((0, 0, 0), (40, 20, 20)),
        ((40, 0, 0), (60, 40, 20)),
        ((20, 40, 0), (60, 60, 20)),
        ((0, 20, 0), (20, 60, 20)),
        ((20, 20, 0), (40, 40, 20)),
    ]
    parts = []
    for number, span in enumerate(spans, 1):
        fields = {
            "id": f"p{number:02d}",
            "solid": Solid.box(*span),
            "planes": list_box_planes(np.array(span, float)),
        }
        parts.append(replace(table.parts[0], **fields))
    joints = tuple(find_joints(parts))
    return replace(table.without_parts(), parts=tuple(parts), joints=joints).with_assembly()


def list_pictures(page: str) -> list[Image.Image]:
    return [
        Image.open(BytesIO(base64.b64decode(data))).convert("RGB")
        for data in re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    ]


def count_colour(picture: Image.Image, colour: np.ndarray) -> int:
    """Count pixels in a shade of a colour."""
    pixels = np.asarray(picture, dtype=np.float64) / 255.0
    brightest_channel = int(np.argmax(colour))
    shade = pixels[..., brightest_channel, None] / colour[brightest_channel]
    return int(((np.abs(pixels - shade * colour) < 0.03).all(axis=2) & (shade[..., 0] > 0.3)).sum())


def test_page_names_every_part_and_joint_once_and_loads_no_file(
    drilled_table: Decomposition, page: str
) -> None:
    rows = re.findall(r"<tr[^>]*><td>(p\d+)</td>", page)
    assert rows == [drilled_table.parts[number].id for number in drilled_table.assembly.part_order]
    assert sorted(rows) == [part.id for part in drilled_table.parts]
    names = re.findall(r'<tr[^>]*><td class="name">(\d+-\d+)</td>', page)
    assert len(names) == len(drilled_table.joints) and len(set(names)) == len(names)
    assert all(source.startswith("data:") for source in re.findall(r'(?:src|href)="([^"]*)"', page))
    assert "url(" not in page and "<script" not in page and "@import" not in page
    assert len(list_pictures(page)) == 2 * (len(drilled_table.parts) - 1)
    assert find_page_faults(page, drilled_table) == []


def test_pins_and_marks_are_listed_in_their_steps(drilled_table: Decomposition, page: str) -> None:
    sections = re.findall(r'<section class="step".*?</section>', page, re.S)
    for number, section in enumerate(sections):
        pins = [pin for pin in drilled_table.connectors.pins if pin.step == number]
        assert len(pins) >= 2
        keys = re.findall(r"data-pin[^>]*>key (\d+)", section)  # sorted by joint
        assert sorted(keys) == sorted(f"{pin.length_mm:.0f}" for pin in pins)
        joints = drilled_table.assembly.steps[number].joints
        marks = [mark for mark in drilled_table.connectors.marks if mark.joint in joints]
        assert len(marks) >= 2 and section.count("data-mark") == len(marks)
        for mark in marks:
            assert f">{mark.text.replace('^', ' ↑').replace('.', '●')}</span> on {mark.part + 1}" in section
    lengths_mm = [round(pin.length_mm) for pin in drilled_table.connectors.pins]
    for length_mm in (8, 4):
        cells = f'<td class="number">{length_mm}</td><td class="number">{lengths_mm.count(length_mm)}</td>'
        assert cells in page


def test_faces_without_a_mark_are_named(
    drilled_table: Decomposition, step_pictures: list[StepPictures]
) -> None:
    first_mark = drilled_table.connectors.marks[0]
    other_marks = tuple(
        mark
        for mark in drilled_table.connectors.marks
        if (mark.part, mark.joint) != (first_mark.part, first_mark.joint)
    )
    connectors = replace(drilled_table.connectors, marks=other_marks)
    text = render_instructions(replace(drilled_table, connectors=connectors), Pictures(step_pictures))
    assert f"no mark on {first_mark.part + 1}<" in text
    assert "no mark on" not in render_instructions(drilled_table, Pictures(step_pictures))


def test_ruler_and_gauge_have_their_size_in_millimetres(page: str) -> None:
    drawing = draw_gauge([(13.0, 2.85), (7.0, 2.85)])
    size_match = re.search(r'width="([\d.]+)mm" height="([\d.]+)mm" viewBox="0 0 ([\d.]+) ([\d.]+)"', drawing)
    assert size_match is not None and size_match.groups()[:2] == size_match.groups()[2:]
    assert re.findall(r'<rect [^>]*width="([\d.]+)" height="([\d.]+)"', drawing) == [
        ("13", "2.85"),
        ("7", "2.85"),
    ]
    ends = [float(x) for x in re.findall(r"M([\d.]+) 2L\1 8", drawing)]
    assert ends[-1] - ends[0] == 100.0 and len(ends) == 11
    assert (
        drawing.count("<svg") == page.count("<svg") == 1 and "svg { display: block; max-width: none" in page
    )


def test_every_picture_shows_glue_pins_and_marks(step_pictures: list[StepPictures]) -> None:
    for step in step_pictures:
        both_picture, moved_picture = (
            Image.open(BytesIO(png)).convert("RGB") for png in (step.both_bodies, step.moved_body)
        )
        assert (
            count_colour(both_picture, GLUE_COLOUR) > 1000 and count_colour(moved_picture, GLUE_COLOUR) > 1000
        )
        assert count_colour(both_picture, PIN_COLOUR) > 50


def test_chosen_view_shows_pins_and_marks(drilled_table: Decomposition) -> None:
    for number, step in enumerate(drilled_table.assembly.steps):
        pose = find_pose(step.direction)
        scene = build_both_bodies(number, drilled_table, 60.0 * step.direction)
        camera = make_camera(*choose_view(scene, pose, ELEVATIONS_DEG, None)) @ pose
        visible_numbers = draw_shapes(scene.shapes, camera, 400, oversampling=1).front_shapes
        visible_counts = [
            (visible_numbers == 1 + scene.first_pin_shape + k).sum() for k in range(len(scene.pins))
        ]
        assert len(visible_counts) >= 2 and min(visible_counts) > 0
        ink_numbers = [k for k, shape in enumerate(scene.shapes, 1) if (shape.colour == MARK_COLOUR).all()]
        assert ink_numbers and np.isin(visible_numbers, ink_numbers).sum() > 20


def test_pose_has_the_joint_upwards_and_keeps_left_and_right_apart() -> None:
    for direction in ([1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0.6, 0, 0.8]):
        pose = find_pose(np.array(direction, dtype=np.float64))
        assert pose @ direction == pytest.approx([0.0, 0.0, 1.0])
        assert pose @ pose.T == pytest.approx(np.eye(3)) and np.linalg.det(pose) == pytest.approx(1.0)
        turned_pose = turn_pose_over(pose, 30.0)
        assert turned_pose @ direction == pytest.approx([0.0, 0.0, -1.0]) and np.linalg.det(
            turned_pose
        ) == pytest.approx(1.0)
    assert name_top_direction(make_camera(-60.0, 30.0)) == "upwards"
    assert name_top_direction(make_camera(-60.0, 30.0) @ find_pose(np.array([0.0, 0.0, -1.0]))) == "downwards"


def test_holes_of_the_moved_body_lie_where_its_pins_go(drilled_table: Decomposition) -> None:
    scene = build_moved_body(0, drilled_table)
    for pin, shape in zip(scene.pins, scene.shapes[scene.first_pin_shape :], strict=False):
        assert np.abs(shape.triangles.mean(axis=(0, 1)) - pin.position_mm).max() < 2.0
        assert np.cross(*np.diff(shape.triangles[0], axis=0)) @ pin.axis < 0.0  # seen from below


def test_step_without_pins_states_the_reason(
    drilled_table: Decomposition, step_pictures: list[StepPictures]
) -> None:
    other_pins = tuple(pin for pin in drilled_table.connectors.pins if pin.step != 1)
    for unpinned, reason in (
        (((1, "too small for a pin"),), "too small for a pin"),
        ((), "the holes were left out"),
    ):
        connectors = replace(drilled_table.connectors, pins=other_pins, unpinned_steps=unpinned)
        text = render_instructions(replace(drilled_table, connectors=connectors), Pictures(step_pictures))
        assert f"No pins ({reason}): align the faces by their rims." in text


def test_faces_point_away_from_the_fixed_body_even_where_they_slide(pinwheel: Decomposition) -> None:
    assert any(step.slides for step in pinwheel.assembly.steps)
    for step in pinwheel.assembly.steps:
        for entry in find_glued_faces(step, pinwheel):
            inside_mm = np.array(entry.face.outline.representative_point().coords[0]) @ entry.face.axes
            point = inside_mm + entry.face.offset_mm * entry.face.normal - 0.5 * entry.outward_normal
            bounds = [pinwheel.parts[part].solid.bounds_mm for part in step.fixed_parts]
            assert any((lo < point).all() and (point < hi).all() for lo, hi in bounds)


def test_previous_view_is_kept_or_approached(drilled_table: Decomposition) -> None:
    pose = find_pose(drilled_table.assembly.steps[0].direction)
    scene = build_both_bodies(0, drilled_table, 60.0 * drilled_table.assembly.steps[0].direction)

    def compute_turn_deg(azimuth_deg: float, start_deg: float) -> float:
        return abs((azimuth_deg - start_deg + 180.0) % 360.0 - 180.0)

    best_deg, _ = choose_view(scene, pose, ELEVATIONS_DEG, None)
    turn_angles = [
        (
            compute_turn_deg(
                choose_view(scene, pose, ELEVATIONS_DEG, previous_azimuth_deg)[0], previous_azimuth_deg
            ),
            compute_turn_deg(best_deg, previous_azimuth_deg),
        )
        for previous_azimuth_deg in (-58.0, 32.0, 122.0, 212.0)
    ]
    assert all(turn_deg <= default_turn_deg + 1e-9 for turn_deg, default_turn_deg in turn_angles)
    # The previous view has an effect.
    assert any(turn_deg < default_turn_deg - 1.0 for turn_deg, default_turn_deg in turn_angles)


def test_parts_without_an_order_are_named(table: Decomposition) -> None:
    page = render_instructions(replace(table, assembly=Assembly((), ((0, 1),))), Pictures())
    assert "p01, p02 cannot be joined" in page


def test_page_check_names_missing_repeated_and_loaded_items(drilled_table: Decomposition, page: str) -> None:
    table = drilled_table
    name = table.parts[0].id
    assert find_page_faults(page.replace('data-pin="1"', ""), table) == ["pin 1 is missing"]
    assert find_page_faults(page.replace(f'data-part="{name}"', ""), table) == [f"part {name} is missing"]
    row = re.search(r"<tr data-joint.*?</tr>", page, re.S)
    assert row is not None
    faults = find_page_faults(page.replace(row[0], 2 * row[0]), table)
    assert all(fault.endswith("is named too often") for fault in faults)
    assert {fault.split()[0] for fault in faults} == {"joint", "pin", "mark"}
    remote_page = page.replace("<h1>", '<img src="https://example.org/x.png"><h1>')
    assert find_page_faults(remote_page, table) == ["it loads https://example.org/x.png"]
    styled_page = page.replace("<style>", "<style>@import 'x';")
    assert find_page_faults(styled_page, table) == ["its style loads a file"]


def test_page_with_a_fault_reports_it_first(
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
    for colour in make_part_colours(len(table.parts)):
        shares = pixels / colour
        is_similar = (np.ptp(shares, axis=2) < 0.05) & (shares.max(axis=2) > 0.45)
        assert is_similar.sum() > 300


def test_parts_are_drawn_identically_in_another_process(drilled_table: Decomposition, tmp_path: Path) -> None:
    """Draw parts whose solids were sent as triangles, whose order may change."""
    for name, parts in (("here", drilled_table), ("there", pickle.loads(pickle.dumps(drilled_table)))):
        (tmp_path / name).mkdir()
        draw_parts(parts, tmp_path / name)
    local_folder, remote_folder = tmp_path / "here", tmp_path / "there"
    for name in (PICTURE, INSTRUCTIONS):
        assert (local_folder / name).read_bytes() == (remote_folder / name).read_bytes(), name
    assert (local_folder / ASSEMBLY).stat().st_size == (remote_folder / ASSEMBLY).stat().st_size


def test_step_looks_the_same_drawn_alone_or_among_all_steps(
    drilled_table: Decomposition, step_pictures: list[StepPictures]
) -> None:
    middle = len(step_pictures) // 2
    assert 0 < middle < len(step_pictures)
    separate_pictures = [
        *draw_steps(drilled_table, 0, middle),
        *draw_steps(drilled_table, middle, len(step_pictures)),
    ]
    assert [(step.both_bodies, step.moved_body, step.top_direction) for step in separate_pictures] == [
        (step.both_bodies, step.moved_body, step.top_direction) for step in step_pictures
    ]
