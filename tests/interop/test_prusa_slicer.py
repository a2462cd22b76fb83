"""G-code of PrusaSlicer with its own profile for the Ultimaker 2, as the farm reads it."""

import pytest

from model_files.make_gcode import FILAMENT_MM2, TravelTimeEstimator
from printers.slicing_printers import UM2_PLUS
from slicing.errors import GcodeRefused
from slicing.own_gcode import PrintTarget, accept_gcode


def accept(path):
    target = PrintTarget(UM2_PLUS, FILAMENT_MM2, 0.4, nozzle_c=210.0, bed_c=60.0)
    return accept_gcode(
        path.read_bytes().splitlines(keepends=True), target, time_estimator=TravelTimeEstimator()
    )


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--gcode-flavor", "marlin2"),
        ("--use-relative-e-distances", "--layer-gcode", "G92 E0"),
        ("--use-firmware-retraction",),
        ("--spiral-vase", "--perimeters", "1", "--fill-density", "0", "--top-solid-layers", "0"),
        ("--raft-layers", "2"),
        ("--support-material", "--retract-lift", "0.4", "--wipe"),
        ("--duplicate", "2", "--complete-objects"),
        ("--ironing",),
    ],
    ids=" ".join,
)
def test_slices_with_the_profile_for_the_ultimaker_2_are_accepted(slice_box, options):
    result = accept(slice_box("-".join(options).replace("/", "") or "default", *options))
    assert (result.filament_type, result.nozzle_mm, result.nozzle_c, result.bed_c) == (
        "PLA",
        0.4,
        205.0,
        55.0,
    )
    [warning] = [notice for notice in result.notices if notice.startswith("Warning")]
    assert "'ULTIMAKER2'" in warning and "fit the Ultimaker 2+" in warning
    assert max(result.max_mm) < 220.0


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--filament-diameter", "1.75"), "filament of 1.75 mm: set the filament's diameter to 2.85 mm"),
        (("--gcode-flavor", "smoothie"), "flavour is 'smoothie': set the G-code flavour to Marlin"),
        (("--use-volumetric-e",), "switch off `Use volumetric E`"),
        (("--temperature", "290"), r"line \d+: M104 sets 290 C, but the limit of the nozzle is 260 C"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_refusal_names_the_setting_to_change_in_the_slicer(slice_box, options, reason):
    with pytest.raises(GcodeRefused, match=reason):
        accept(slice_box("-".join(options), *options))
