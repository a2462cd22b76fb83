"""Violations of the rules for pins and marks, and failures, which leave out connectors."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import shapely
from scipy.spatial import QhullError

from decompose.assembly import plan_assembly
from decompose.connectors import Blank, Connectors, Pin, Tool, drill_parts, plan_connectors
from decompose.decompose import decompose_model
from decompose.errors import GeometryError, ModelNotSolid, Rule
from decompose.export import files, write_decomposition
from decompose.files.names import REPORT
from decompose.geometry import Model, Solid, write_stl
from decompose.options import ConnectorOptions, Engine, Interior, Options
from decompose.pieces import Piece, Seam, find_joints, list_box_planes
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem.connector_cost import MARK_AREA_PRICES, PIN_AREA_PRICES, set_connector_prices
from decompose.results import Decomposition, Part, check_stl, connect, connect_parts, decomposition
from decompose.results.connector_prices import price_connectors
from decompose.results.connector_rules import ConnectorFault, DrilledParts, find_wrong_fits

ALL_CONNECTORS = ConnectorOptions(2.85, 0.4, marks=True)
UP_AXIS = np.array([0.0, 0.0, 1.0])
LEANING_AXIS = np.array([0.0, 0.6, -0.8])  # level faces can have holes in this pose, but no grooves


@pytest.fixture(scope="module")
def drilled_parts() -> DrilledParts:
    return drill_tower(LEANING_AXIS)


def drill_tower(up: np.ndarray, fits_mm: tuple[float, ...] = (0.4, 0.4, 0.4)) -> DrilledParts:
    """Drill three blocks on top of each other; `up` is the up axis of the middle one."""
    spans = [((0, 0, 0), (60, 40, 20)), ((0, 0, 20), (60, 40, 50)), ((0, 0, 50), (60, 40, 80))]
    pieces = [
        Piece(Solid.box(*span), list_box_planes(np.array(span, dtype=np.float64)), np.zeros((0, 2, 3)))
        for span in spans
    ]
    joints = find_joints(pieces)
    assembly = plan_assembly(pieces, joints)
    blanks = [
        Blank(str(n), piece.solid, pose_up, fit_mm)
        for n, (piece, pose_up, fit_mm) in enumerate(
            zip(pieces, (UP_AXIS, up, UP_AXIS), fits_mm, strict=True), 1
        )
    ]
    connectors = plan_connectors(blanks, joints, assembly, ALL_CONNECTORS, 25.0)
    return DrilledParts(blanks, drill_parts(blanks, connectors), joints, assembly.steps, connectors)


def change_pin(parts: DrilledParts, change: Callable[[Pin], Pin]) -> DrilledParts:
    first_pin, *other_pins = parts.connectors.pins
    connectors = replace(parts.connectors, pins=(change(first_pin), *other_pins))
    return replace(parts, connectors=connectors, drilled_solids=drill_parts(parts.blanks, connectors))


def move_hole(pin: Pin, offset_mm: tuple[float, float, float]) -> Pin:
    first_hole, second_hole = pin.holes
    return replace(
        pin, holes=(replace(first_hole, points_mm=first_hole.points_mm + np.array(offset_mm)), second_hole)
    )


def shift_pin_outwards(parts: DrilledParts) -> DrilledParts:
    """Move both holes and the pin to within a millimetre of the part's side."""

    def shift(pin: Pin) -> Pin:
        offset_mm = np.array([0.9 - min(hole.points_mm[:, 0].min() for hole in pin.holes), 0.0, 0.0])
        first_hole, second_hole = (replace(hole, points_mm=hole.points_mm + offset_mm) for hole in pin.holes)
        return replace(pin, position_mm=pin.position_mm + offset_mm, holes=(first_hole, second_hole))

    return change_pin(parts, shift)


def cut_undeclared_hole(parts: DrilledParts) -> DrilledParts:
    hole = Solid.box((25.0, 18.0, 5.0), (28.0, 21.0, 9.0))
    return replace(parts, drilled_solids=[parts.drilled_solids[0].subtract(hole), *parts.drilled_solids[1:]])


def add_material(parts: DrilledParts) -> DrilledParts:
    bump = Solid.box((59.0, 10.0, 5.0), (62.0, 12.0, 9.0))
    return replace(
        parts, drilled_solids=[Solid.union([parts.drilled_solids[0], bump]), *parts.drilled_solids[1:]]
    )


def turn_parts_over(parts: DrilledParts) -> DrilledParts:
    return replace(
        parts, blanks=[replace(blank, up_direction=np.array([0.0, 0.8, -0.6])) for blank in parts.blanks]
    )


def separate_holes(parts: DrilledParts) -> DrilledParts:
    return change_pin(parts, lambda pin: move_hole(pin, (1.0, 1.0, 0.0)))


def tilt_pin(parts: DrilledParts) -> DrilledParts:
    return change_pin(parts, lambda pin: replace(pin, axis=np.array([1.0, 0.0, 0.0])))


@pytest.mark.parametrize(
    ("damage", "rule"),
    [
        (cut_undeclared_hole, Rule.ONLY_HOLES_REMOVED),
        (add_material, Rule.ONLY_HOLES_REMOVED),
        (shift_pin_outwards, Rule.PIN_WALLS),
        (turn_parts_over, Rule.SUPPORT_FREE),
        (separate_holes, Rule.PINS_UNAMBIGUOUS),
        (tilt_pin, Rule.PIN_DIRECTIONS),
    ],
)
def test_each_rule_refuses_parts_that_break_it(
    drilled_parts: DrilledParts, damage: Callable[[DrilledParts], DrilledParts], rule: Rule
) -> None:
    assert list(drilled_parts.find_faults()) == []
    assert rule in {fault.rule for fault in damage(drilled_parts).find_faults()}


def test_pins_of_equal_depth_or_equal_distance_fit_wrongly(drilled_parts: DrilledParts) -> None:
    pins = drilled_parts.connectors.pins
    assert find_wrong_fits(pins) == []
    equal_pins = [replace(pin, length_mm=2.0 * pin.depth_mm - 5.0) for pin in pins]
    assert any("by 180 degrees" in fault for fault in find_wrong_fits(equal_pins))
    first_pins = [pin for pin in pins if pin.step == 0][:2]
    repeated_pins = [replace(pin, step=1) for pin in first_pins]
    assert any("fit each other" in fault for fault in find_wrong_fits([*first_pins, *repeated_pins]))


@pytest.fixture(scope="module")
def halves() -> Decomposition:
    model = Model(Solid.box((0, 0, 0), (80, 40, 30)), (), 1.0)
    printers = [TargetPrinter(f"p{i}", ((50.0, 50.0, 50.0),)) for i in range(2)]
    options = Options(Engine.GUILLOTINE, granularity=6, prove=False, connectors=ALL_CONNECTORS)
    cost = CostModel(1.0, *[1e-3] * 7, brim_mm=0.0)
    return decompose_model(model, printers, options, cost).with_assembly()


def test_parts_are_written_with_their_holes_and_the_report_lists_them(
    halves: Decomposition, tmp_path: Path
) -> None:
    connected_result = connect_parts(halves)
    for part in connected_result.parts:
        assert part.printed_solid.volume_mm3 < part.solid.volume_mm3 - 50.0
        write_stl(tmp_path / f"{part.id}.stl", part.build_stl_triangles())
        check_stl(tmp_path / f"{part.id}.stl", part)
    for number, (part, old_part) in enumerate(zip(connected_result.parts, halves.parts, strict=True)):
        added_s = price_connectors(connected_result.connectors, number, old_part.rotation[2])
        assert part.price_s - old_part.bare_price_s == pytest.approx(added_s) == part.connectors_s
    report_object = json.loads(json.dumps(connected_result.as_dict()))
    [step], report = report_object["assembly"]["steps"], report_object["connectors"]
    assert step["pins"] == [pin["id"] for pin in report["pins"]] == [1, 2]
    assert step["codes"] == [{"part": "p01", "text": "1-2^"}, {"part": "p02", "text": "2-1^"}]
    assert report["cut_list"] == [
        {"length_mm": length_mm, "diameter_mm": 2.85, "count": 1} for length_mm in (8.0, 4.0)
    ]
    assert [pin["kind"] for pin in report["pins"]] == ["key", "key"]
    assert [mark["text"] for mark in report["marks"]] == ["1-2^", "2-1^"]
    assert report["failures"] == report["unpinned"] == report["unmarked"] == []


def test_cost_has_the_prices_of_the_requested_connectors() -> None:
    cost = CostModel(1.0, *[1e-3] * 7, brim_mm=0.0)
    for pin_mm, marks in product((None, 2.85), (False, True)):
        priced_cost = set_connector_prices(cost, ConnectorOptions(pin_mm, marks=marks))
        expected_prices = (pin_mm is not None) * np.array(PIN_AREA_PRICES) + marks * np.array(
            MARK_AREA_PRICES
        )
        prices = priced_cost.connector_side_s_per_mm2, priced_cost.connector_level_s_per_mm2
        assert prices == pytest.approx(tuple(expected_prices))
        assert set_connector_prices(priced_cost, ConnectorOptions()) == cost


def test_partition_prices_connectors_before_they_have_places(halves: Decomposition) -> None:
    """Estimate them by the area of the cut faces, and replace the estimate by what is cut."""
    prices = PIN_AREA_PRICES, MARK_AREA_PRICES
    s_per_mm2 = sum(price.side_s_per_mm2 for price in prices), sum(price.level_s_per_mm2 for price in prices)
    for part in halves.parts:
        is_upright = abs(part.rotation[2, 0]) < 0.5
        assert part.connectors_s == pytest.approx(1200.0 * s_per_mm2[0 if is_upright else 1])
    connected_result = connect_parts(halves)
    connected_parts = connected_result.parts
    prices_s = [part.price_s for part in connected_parts]
    assert (connected_result.makespan_s, connected_result.sum_s) == pytest.approx(
        (max(prices_s), sum(prices_s))
    )
    assert [part.bare_price_s for part in connected_parts] == pytest.approx(
        [part.bare_price_s for part in halves.parts]
    )


def test_makespan_stays_if_the_speed_of_a_printer_is_not_known(halves: Decomposition) -> None:
    """Move a load to a printer for which the model was not cut, as for copies of a model."""
    moved_parts = (replace(halves.parts[0], printer="other"), *halves.parts[1:])
    connected_result = connect_parts(replace(halves, parts=moved_parts))
    assert connected_result.makespan_s == halves.makespan_s
    assert connected_result.sum_s == pytest.approx(sum(part.price_s for part in connected_result.parts))


@pytest.mark.parametrize("up", [UP_AXIS, LEANING_AXIS])
def test_hole_has_the_fit_of_its_printer_and_both_grooves_have_the_wider_fit(up: np.ndarray) -> None:
    parts = drill_tower(up, (0.4, 0.7, 0.4))
    assert len(parts.connectors.pins) == 4 and list(parts.find_faults()) == []
    for pin in parts.connectors.pins:
        for hole in pin.holes:
            if pin.key_direction is not None:
                assert pin.depth_mm == pytest.approx((2.85 + 0.7) / np.sqrt(2.0))
                continue
            offsets_mm = hole.points_mm[:6] - hole.points_mm[:6].mean(axis=0)
            width_mm = np.sqrt(3.0) * np.linalg.norm(offsets_mm, axis=1).max()
            assert width_mm == pytest.approx(2.85 + parts.blanks[hole.part].pin_fit_mm)


def test_fit_of_a_blank_is_that_of_its_printer(halves: Decomposition) -> None:
    options = replace(ALL_CONNECTORS, printer_fits_mm=((halves.parts[1].printer, 0.7),))
    connected_result = connect_parts(replace(halves, options=replace(halves.options, connectors=options)))
    assert not connected_result.connectors.failures
    assert [pin.depth_mm for pin in connected_result.connectors.pins] == pytest.approx(
        [3.55 / np.sqrt(2.0)] * 2
    )


def test_prices_grow_only_with_the_tools_of_a_part(drilled_parts: DrilledParts) -> None:
    connectors = drilled_parts.connectors
    up_axes = [blank.up_direction for blank in drilled_parts.blanks]
    prices_s = [price_connectors(connectors, n, up) for n, up in enumerate(up_axes)]
    fewer_connectors = replace(connectors, pins=connectors.pins[1:])
    fewer_prices_s = [price_connectors(fewer_connectors, n, up) for n, up in enumerate(up_axes)]
    cut_parts = {hole.part for hole in connectors.pins[0].holes}
    assert [cheaper_s < price_s for cheaper_s, price_s in zip(fewer_prices_s, prices_s, strict=True)] == [
        n in cut_parts for n in range(3)
    ]
    assert price_connectors(Connectors(), 0, UP_AXIS) == 0.0


def test_part_that_is_cut_again_keeps_its_holes_and_codes(halves: Decomposition) -> None:
    """Cut a drilled part again after a fault, when its neighbour is already printed."""
    result = connect_parts(halves)
    printed_solid = result.parts[0].printed_solid
    printers = [TargetPrinter(f"p{i}", ((30.0, 40.0, 50.0),)) for i in range(2)]
    options = replace(halves.options, interior=Interior.KEEP)
    cost = CostModel(1.0, *[1e-3] * 7, brim_mm=0.0)
    second_result = decompose_model(Model(printed_solid, (), 1.0), printers, options, cost).with_assembly()
    named_parts = replace(
        second_result,
        parts=tuple(replace(p, id=f"p01{c}") for c, p in zip("ab", second_result.parts, strict=True)),
    )
    pieces = connect_parts(named_parts)
    assert not pieces.connectors.failures
    assert {mark.text.rstrip("^") for mark in pieces.connectors.marks} == {"1a-1b", "1b-1a"}
    printed_solids = Solid.union([piece.printed_solid for piece in pieces.parts])
    old_tools = [Solid.hull(tool.points_mm) for tool in result.connectors.tools if tool.part == 0]
    assert len(old_tools) > 10 and printed_solids.intersect(Solid.union(old_tools)).volume_mm3 < 1e-3


def test_parts_stay_as_they_were_cut_without_options(halves: Decomposition) -> None:
    plain_halves = replace(halves, options=replace(halves.options, connectors=ConnectorOptions()))
    assert connect_parts(plain_halves) is plain_halves


def test_only_the_pin_that_breaks_a_rule_is_left_out(
    halves: Decomposition, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans: list[Connectors] = []

    def plan_pin_outside(*args: object) -> Connectors:
        connectors = plan_connectors(*args)  # type: ignore[arg-type]
        deep_pin, shallow_pin = connectors.pins
        plans.append(replace(connectors, pins=(move_hole(deep_pin, (0.0, 0.0, 50.0)), shallow_pin)))
        return plans[0]

    monkeypatch.setattr(connect, "plan_connectors", plan_pin_outside)
    connectors = connect_parts(halves).connectors
    assert connectors.pins == plans[0].pins[1:] and connectors.marks == plans[0].marks
    assert connectors.failures
    assert all(" is left out: " in failure for failure in connectors.failures)


def test_thin_walls_and_close_marks_are_blamed_on_one_connector(drilled_parts: DrilledParts) -> None:
    parts = shift_pin_outwards(drilled_parts)
    assert {fault.connector for fault in parts.find_faults()} == {parts.connectors.pins[0]}
    first_mark, *other_marks = drilled_parts.connectors.marks
    pin = next(p for p in drilled_parts.connectors.pins if p.joint == first_mark.joint)
    hole = next(hole for hole in pin.holes if hole.part == first_mark.part)
    offset_mm = pin.position_mm - first_mark.lines_mm[0, 0]
    offset_mm -= (offset_mm @ hole.inward_normal) * hole.inward_normal
    moved_mark = replace(
        first_mark, grooves=tuple(replace(g, points_mm=g.points_mm + offset_mm) for g in first_mark.grooves)
    )
    connectors = replace(drilled_parts.connectors, marks=(moved_mark, *other_marks))
    close_parts = replace(
        drilled_parts,
        connectors=connectors,
        drilled_solids=drill_parts(drilled_parts.blanks, connectors),
    )
    assert {fault.connector for fault in close_parts.find_faults()} == {moved_mark}


def test_no_body_fits_turned_after_a_pin_is_left_out(drilled_parts: DrilledParts) -> None:
    """Leave out a pin of a pair that has further pins of the shape of the other one."""
    deep_pin, shallow_pin, *_ = (pin for pin in drilled_parts.connectors.pins if pin.step == 0)
    third_pin = replace(shallow_pin, position_mm=shallow_pin.position_mm + np.array([10.0, 0.0, 0.0]))
    connectors = replace(drilled_parts.connectors, pins=(deep_pin, shallow_pin, third_pin))
    assert connectors.remove(third_pin, "").pins == (deep_pin, shallow_pin)
    assert connectors.remove(deep_pin, "").pins == (shallow_pin,)
    assert connectors.remove(shallow_pin, "").pins == (deep_pin,)


def test_part_that_breaks_a_rule_stays_as_it_was_cut(
    halves: Decomposition, monkeypatch: pytest.MonkeyPatch
) -> None:
    def find_faults(parts: DrilledParts) -> Iterator[ConnectorFault]:
        if any(tool.part == 0 for tool in parts.connectors.tools):
            yield ConnectorFault(Rule.ONLY_HOLES_REMOVED, 0, "it is no longer one piece")

    monkeypatch.setattr(DrilledParts, "find_faults", find_faults)
    result = connect_parts(halves)
    first, second = result.parts
    assert first.drilled_solid is None and first.connectors_s == 0.0 and second.connectors_s > 0.0
    [failure] = result.connectors.failures
    assert failure == "p01 has no holes and marks: it is no longer one piece (rule drilled)"


@pytest.mark.parametrize("kind", [ModelNotSolid, shapely.errors.GEOSException, QhullError])
def test_failed_operation_changes_no_part_and_is_reported(
    halves: Decomposition, monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    def fail(*args: object) -> Connectors:
        raise kind("cutting holes: the triangles bound no solid")

    monkeypatch.setattr(connect, "plan_connectors", fail)
    result = connect_parts(halves)
    assert result.parts == tuple(
        replace(part, price_s=part.bare_price_s, connectors_s=0.0) for part in halves.parts
    )
    [failure] = result.connectors.failures
    assert failure.startswith("no pins and marks: cutting holes")


def test_holes_that_would_damage_an_stl_are_left_out_and_reported(
    halves: Decomposition, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse_holes(path: Path, part: Part) -> None:
        if part.drilled_solid is not None:
            raise GeometryError(Rule.STL, part.id, f"{path.name}, read back, is not watertight")
        check_stl(path, part)

    monkeypatch.setattr(files, "check_stl", refuse_holes)
    written_files = write_decomposition(halves, tmp_path)
    assert [part.drilled_solid for part in written_files.parts] == [None, None]
    assert not written_files.connectors.pins and not written_files.connectors.marks
    [failure] = json.loads((tmp_path / REPORT).read_text())["connectors"]["failures"]
    assert failure.startswith("no pins and marks: ") and "not watertight" in failure


def test_seams_that_cannot_be_measured_are_left_out(
    halves: Decomposition, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*args: object) -> list[Seam]:
        raise shapely.errors.GEOSException("TopologyException: side location conflict")

    monkeypatch.setattr(decomposition, "measure_seams", fail)
    result = halves.with_assembly()
    assert result.seams == () and len(result.assembly.steps) == len(halves.assembly.steps)
    assert result.sum_seams_mm() == 0.0 and result.describe_thin_rims() == ""
    assert result.as_dict()["joints"][0]["seam_mm"] == 0.0


def test_tool_that_opens_outside_its_joint_is_refused(drilled_parts: DrilledParts) -> None:
    mark = drilled_parts.connectors.marks[0]
    shifted_tools = tuple(
        Tool(t.part, t.points_mm + np.array([0.0, 30.0, 0.0]), t.inward_normal, t.face_offset_mm)
        for t in mark.grooves
    )
    connectors = replace(drilled_parts.connectors, marks=(replace(mark, grooves=shifted_tools),))
    parts = replace(
        drilled_parts, connectors=connectors, drilled_solids=drill_parts(drilled_parts.blanks, connectors)
    )
    assert Rule.PIN_WALLS in {fault.rule for fault in parts.find_faults()}
