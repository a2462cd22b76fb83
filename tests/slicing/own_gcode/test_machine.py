"""A person's own G-code that names another machine, nozzle or filament."""

import pytest

from model_files.make_gcode import FILAMENT_MM2, make_marlin, make_square
from model_files.own_gcode import accept, assert_refused

THIN_FILAMENT_SQUARE = make_square(e_per_mm=0.4 * 0.2 / (FILAMENT_MM2 * 1.75**2 / 2.85**2) * 0.85)
"""Square whose E is for filament of 1.75 mm, and small enough to be plausible for 2.85 mm."""


def make_file(comment, lines=None):
    flavour, *other_lines = lines or make_marlin()
    return [flavour, comment, *other_lines]


def list_warnings(lines):
    return [line for line in accept(lines).notices if line.startswith("Warning: ")]


@pytest.mark.parametrize(
    "comment",
    [
        ";TARGET_MACHINE.NAME:Creality Ender-3",
        ";TARGET_MACHINE.NAME:Ultimaker 2",
        ";TARGET_MACHINE.NAME:Ultimaker 2+ Connect",
        "; printer_model = MK3S",
        "; printer_settings_id = Original Prusa i3 MK3",
        "; printer_name = ATOM 3D PRINTER",
    ],
)
def test_file_for_another_machine_that_fits_causes_a_warning(comment):
    (warning,) = list_warnings(make_file(comment))
    assert repr(comment.split(":")[-1].split("=")[-1].strip()) in warning


@pytest.mark.parametrize(
    "comment",
    [
        ";TARGET_MACHINE.NAME:Ultimaker 2+",
        ";TARGET_MACHINE.NAME:Ultimaker 2 Extended+",
        "; printer_model = ultimaker2_extended_plus",
        "; printer_model = UM2+",
        "; printer_model = ",
        '; printer_settings_id = ""',
        "; printer_settings_id = - default FFF printer -",
    ],
)
def test_file_for_an_ultimaker_2_plus_or_no_machine_causes_no_warning(comment):
    assert list_warnings(make_file(comment)) == []


@pytest.mark.parametrize("command", ["G29", "M420 S1", "G80", 'M862.3 P "MK3S"', "M906 X800"])
def test_file_for_another_machine_whose_start_does_not_fit_is_refused(command):
    lines = make_file("; printer_model = MK3S")
    lines.insert(3, command)
    assert_refused(
        lines, rf"sliced for 'MK3S' \(line 4: {command.split()[0]} .*slice it for the Ultimaker 2\+"
    )


def test_file_for_another_machine_with_another_origin_is_refused():
    lines = make_file(
        "; printer_model = Delta", [*make_marlin(), "; bed_shape = -100x-100,100x-100,100x100,-100x100"]
    )
    assert_refused(lines, "sliced for 'Delta' .its bed begins at '-100x-100'")
    assert list_warnings([line.replace("-100x-100,", "0x0,") for line in lines])


def test_file_for_another_machine_must_state_its_filament():
    """Refuse a file without it, because E for filament of 1.75 mm would extrude 2.3 times as much."""
    assert list_warnings(make_marlin(THIN_FILAMENT_SQUARE)) == [
        "Warning: its lines have 2.3 times the cross-section of a line as wide as the nozzle: was it sliced "
        "for another nozzle?"
    ]
    assert_refused(
        make_file(";TARGET_MACHINE.NAME:Creality Ender-3", make_marlin(THIN_FILAMENT_SQUARE)),
        "'Creality Ender-3' .* 2.3 times",
    )
    assert_refused(make_file(";Filament Diameter #1: 1.75"), "1.75 mm: set the filament's diameter")
    assert_refused(make_file("; fiber_dia_mm = 1.75"), "1.75 mm: set the filament's diameter")


def test_wide_lines_without_a_stated_nozzle_cause_a_warning():
    wide_square = make_square(e_per_mm=0.8 * 0.2 / FILAMENT_MM2)
    assert len(list_warnings(make_marlin(wide_square))) == 1
    assert list_warnings(make_file(";Nozzle Diameter #1: 0.80", make_marlin(wide_square))) == []
    assert accept(make_file(";Nozzle Diameter #1: 0.80", make_marlin(wide_square))).nozzle_mm == 0.8


def test_machine_name_is_printed_without_control_characters():
    (warning,) = list_warnings(make_file("; printer_model = \x1b[2J[red]" + "x" * 500))
    assert warning.isprintable() and len(warning) < 300


def test_material_is_reported():
    assert accept(make_file("; filament_type = PETG;PETG")).filament_type == "PETG"
    assert accept(make_marlin()).filament_type is None
