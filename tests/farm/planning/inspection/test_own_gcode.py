"""Own G-code: accepted, refused, and planned as one plate. The tests need Cura's files but no engine."""

import math
import tracemalloc

import pytest

from decompose.options import Engine
from drivers.printers import PROFILES
from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions
from farm.planning.inspection.own_gcode import FirmwareTimeEstimator, inspect_gcode, is_gcode, plan_gcode
from farm.planning.plan import DecomposeTask
from model_files.make_gcode import make_marlin, make_square, make_ultigcode
from slicing.errors import EngineMissing
from slicing.settings import find_resources

LOW, TALL = "ultimaker2_plus", "ultimaker2_extended_plus"


def make_section(name, model=LOW, **fields):
    return PrinterSection(name=name, model=model, port=f"/dev/{name}", **fields)


@pytest.fixture(scope="module", autouse=True)
def resources():
    try:
        return find_resources()
    except EngineMissing as missing:
        pytest.skip(str(missing))


@pytest.fixture
def files(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    return folder


@pytest.fixture
def inspect_lines(tmp_path, files):
    def run(lines, fleet=(), name="tower.gcode", **options):
        upload = tmp_path / "upload"
        upload.unlink(missing_ok=True)
        upload.write_text("\n".join(lines) + "\n")
        fleet = fleet or [make_section("a"), make_section("b", TALL)]
        return inspect_gcode(upload, name, JobOptions(**options), fleet, files)

    return run


@pytest.fixture
def plan_lines(tmp_path, files, inspect_lines):
    def run(lines, fleet=(), **options):
        fleet = tuple(fleet or [make_section("a"), make_section("b", TALL)])
        inspection = inspect_lines(lines, fleet, **options)
        folder = tmp_path / "work"
        folder.mkdir()
        task = DecomposeTask(
            job=7,
            model=files / inspection.file,
            options=JobOptions(**options),
            printers=fleet,
            round_count=1,
            folder=folder,
        )
        return plan_gcode(task, files)

    return run


@pytest.mark.parametrize("name", ["a.gcode", "A.GCODE", "b.g", "c.gco"])
def test_g_code_is_recognised_by_its_name(name):
    assert is_gcode(name)
    assert not is_gcode(name + ".stl")


@pytest.mark.parametrize("name", ["a.gcode.gz", "a.g.zip", "a.bgcode", "a.ufp", "a.gcode.3mf"])
def test_packed_g_code_is_refused_with_advice(name):
    with pytest.raises(FarmError, match=r"unpack|plain|package") as error:
        is_gcode(name)
    assert error.value.code is ErrorCode.GCODE


def test_packed_models_are_not_treated_as_gcode():
    assert not is_gcode("a.stl.gz")
    assert not is_gcode("a.3mf")


def test_file_is_stored_with_its_requirements(inspect_lines, files):
    lines = make_ultigcode()
    inspection = inspect_lines(lines)
    assert (files / inspection.file).read_text().splitlines() == lines
    assert inspection.own_gcode.nozzle_mm == 0.4
    assert inspection.own_gcode.min_mm == pytest.approx((-11.5, -11.5, 0.2))
    assert inspection.own_gcode.max_mm == pytest.approx((8.5, 8.5, 0.6))
    assert any("UltiGCode" in line for line in inspection.repairs)


@pytest.mark.parametrize(
    ("options", "flags"),
    [
        ({"scale": 2.0, "longest_side_mm": 9.0}, "--longest-side --scale:"),
        ({"printers": 2}, "--printers:"),
        ({"quality": "paper"}, "--quality:"),
        ({"pin_mm": 2.85, "marks": True}, "--pins --marks:"),
        ({"engine": Engine.GUILLOTINE}, "--engine:"),
    ],
)
def test_options_for_models_are_refused_for_gcode(inspect_lines, options, flags):
    with pytest.raises(FarmError, match=flags) as error:
        inspect_lines(make_marlin(), **options)
    assert error.value.code is ErrorCode.SETTINGS


def test_one_printer_may_be_requested(inspect_lines):
    assert inspect_lines(make_marlin(), printers=1).scale == 1.0


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (make_ultigcode(nozzle="0.8"), "nozzle of 0.8 mm, and a has 0.4 mm"),
        (make_marlin(make_square(at_mm=210.0)), "X 210.0..230.0"),
        (make_marlin(make_square(at_mm=0.0)), "on its clips"),
        (make_marlin(make_square(layers=1000, layer_mm=0.32)), "up to Z 320.0 mm"),
        (make_marlin(body=["G0 Z12", "G0 X-20"]), "moves to X -20.0"),
        (make_marlin(body=["G0 Z400"]), "moves to Z 400.0"),
    ],
)
def test_file_that_fits_no_printer_is_refused(inspect_lines, lines, message):
    with pytest.raises(FarmError, match=message) as error:
        inspect_lines(lines)
    assert error.value.code is ErrorCode.NO_FIT


def test_file_for_another_printer_names_the_right_one(inspect_lines):
    with pytest.raises(FarmError, match="choose the Creality Ender-3 in your slicer"):
        inspect_lines(
            make_marlin(body=["G0 Z12", "G0 X-20"]),
            [make_section("a", "creality_ender3", material="generic_pla_175")],
        )


def test_file_without_a_nozzle_needs_printers_with_one_size(inspect_lines):
    fleet = [make_section("a"), make_section("b", nozzle_mm=0.8, colour="red")]
    with pytest.raises(FarmError, match=r"nozzle_diameter = 0\.4") as error:
        inspect_lines(make_marlin(), fleet)
    assert error.value.code is ErrorCode.GCODE
    assert (
        inspect_lines(
            make_marlin(make_square(e_per_mm=0.8 * 0.2 / 6.379)), fleet, colour="red"
        ).own_gcode.nozzle_mm
        is None
    )
    assert inspect_lines(make_ultigcode(), fleet).own_gcode.nozzle_mm == 0.4


def test_refusal_names_the_line(inspect_lines):
    with pytest.raises(FarmError, match=r"tower.gcode: line \d+: M500 changes the printer's") as error:
        inspect_lines(make_marlin(body=["M500"]))
    assert error.value.code is ErrorCode.GCODE


def test_plan_is_one_plate_on_the_lowest_printer_that_fits(plan_lines, files):
    plan = plan_lines(
        make_marlin(), [make_section("b", TALL), make_section("c", price_per_kg=30.0), make_section("d")]
    )
    (plate,), (part,) = plan.plates, plan.parts
    assert (plate.printer, plate.parts, part.plate) == ("c", (part.id,), plate.id)
    assert plan.serial_s == plan.expected_s == plate.expected_s > plate.sliced_s > 0
    assert plate.filament_mm == pytest.approx(240 * 0.08 / (math.pi * 2.85**2 / 4), abs=1e-3)
    assert plate.grams == pytest.approx(240 * 0.08 / 1000 * 1.24, rel=0.01)
    assert plate.price == pytest.approx(plate.grams * 0.03)
    assert (files / plate.gcode).read_text().startswith(";FLAVOR:Marlin\n")
    assert (files / part.file).read_text().splitlines() == make_marlin()


def test_tall_print_is_assigned_to_a_tall_printer(plan_lines):
    tall_lines = make_marlin(make_square(layers=750, layer_mm=0.32))
    assert plan_lines(tall_lines).plates[0].printer == "b"


def test_ultigcode_is_heated_for_the_material_of_the_printer(plan_lines, files):
    plan = plan_lines(make_ultigcode(), [make_section("a", material="generic_abs")])
    text = (files / plan.plates[0].gcode).read_text()
    temperature_lines = {line for line in text.splitlines() if line.startswith(("M109", "M190"))}
    assert {line.split()[0] for line in temperature_lines} == {"M109", "M190"}
    assert not temperature_lines & {"M109 S200", "M190 S60"}


@pytest.mark.parametrize(("nozzle_c", "has_warning"), [(250, True), (215, False)])
def test_file_for_another_material_causes_a_warning(plan_lines, inspect_lines, nozzle_c, has_warning):
    lines = [line.replace("S205", f"S{nozzle_c}") for line in make_marlin()]
    for notices in (inspect_lines(lines).repairs, plan_lines(lines).repairs):
        assert any(f"{nozzle_c} C, and generic_pla on a" in line for line in notices) is has_warning


@pytest.mark.parametrize(
    ("message", "material", "has_warning"),
    [
        ("PLA", "generic_pla", False),
        ("PLA+", "generic_pla", False),
        ("PETG", "generic_pla", True),
        ("FLEX", "generic_tpu", False),
        ("ABS", "generic_cpe", True),
    ],
)
def test_file_with_another_material_name_causes_a_warning(
    plan_lines, inspect_lines, message, material, has_warning
):
    lines, fleet = [*make_marlin(), f"; filament_type = {message}"], [make_section("a", material=material)]
    for notices in (inspect_lines(lines, fleet).repairs, plan_lines(lines, fleet).repairs):
        warnings = [line for line in notices if line.startswith("Warning: it was sliced for")]
        assert [repr(message) in line and material in line for line in warnings] == [True] * has_warning


def test_file_for_another_machine_causes_a_warning(plan_lines, inspect_lines):
    lines = [*make_marlin(), "; printer_model = MK3S"]
    for notices in (inspect_lines(lines).repairs, plan_lines(lines).repairs):
        assert notices[-1].startswith("Warning: it was sliced for 'MK3S'.")


def test_print_time_matches_the_planner_of_the_firmware():
    clock = FirmwareTimeEstimator(PROFILES[LOW])
    clock.move(105.0, 50.0, 20.0, 0.0, 50.0)
    clock.wait(3.0)
    for n in range(40):
        clock.move(105.0 + (n % 2), 50.0, 20.0, 0.0, 50.0)
    # 100 mm at 50 mm/s, with acceleration and deceleration of 3000 mm/s2
    assert (
        3.0 + 2.0
        < clock.measure_time_s()
        < clock.measure_time_s(finish=True)
        < 3.0 + 2.05 + 40 * (1 / 50 + 2 * 50 / 3000)
    )
    assert clock.measure_time_s(finish=True) == clock.measure_time_s()


def test_large_file_takes_little_more_memory_than_its_text(inspect_lines):
    points = [(100.0 + n % 17, 100.0 + n % 13, 0.2, 0.02) for n in range(1, 20_000)]
    lines = make_marlin([[(100.0, 100.0, 0.2, 0.0), *points]])
    inspect_lines(make_marlin())  # Cura's files are read once
    tracemalloc.start()
    try:
        inspect_lines(lines)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 6 * sum(map(len, lines))
