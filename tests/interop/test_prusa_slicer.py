"""G-code of PrusaSlicer with its own profile for the Ultimaker 2, as the farm reads it."""

import configparser
import shutil
import subprocess
from itertools import chain
from pathlib import Path

import pytest
import trimesh

from make_gcode import FILAMENT_MM2, Summed
from slicing.errors import GcodeRefused
from slicing.own_gcode import PrintTarget, accept_gcode
from slicing_printers import UM2_PLUS

PROGRAM = shutil.which("prusa-slicer")
PRESETS = ("print:0.20mm NORMAL @ULTIMAKER2", "filament:Generic PLA @ULTIMAKER2", "printer:Ultimaker 2")
pytestmark = pytest.mark.skipif(PROGRAM is None, reason="prusa-slicer is missing: `make peers`")


def find_profile():
    """Return the file with PrusaSlicer's presets for Ultimakers."""
    top = Path(PROGRAM).resolve().parents[1]
    return next(
        chain.from_iterable(
            top.glob(f"{way}share/PrusaSlicer/profiles/Ultimaker.ini") for way in ("", "*/*/")
        )
    )


def flatten_preset(presets, title):
    """Return the values of a preset with those that it inherits."""
    own, values = dict(presets[title]), {}
    for name in filter(None, map(str.strip, own.pop("inherits", "").split(";"))):
        values |= flatten_preset(presets, f"{title.partition(':')[0]}:{name}")
    return values | own


@pytest.fixture(scope="module")
def slice_box(tmp_path_factory):
    """Slice a box by PrusaSlicer with options of its command line; returns the path of the G-code."""
    folder = tmp_path_factory.mktemp("prusa")
    presets = configparser.RawConfigParser(delimiters=("=",), comment_prefixes=("#",))
    presets.read(find_profile())
    values = {key: value for title in PRESETS for key, value in flatten_preset(presets, title).items()}
    (folder / "um2.ini").write_text("".join(f"{key} = {value}\n" for key, value in values.items()))
    trimesh.creation.box((20.0, 20.0, 2.0)).export(folder / "box.stl")

    def slice_model(name, *options):
        path = folder / f"{name}.gcode"
        words = [
            PROGRAM,
            "--load",
            folder / "um2.ini",
            *options,
            "--export-gcode",
            folder / "box.stl",
            "-o",
            path,
        ]
        subprocess.run(words, check=True, capture_output=True, timeout=120)
        return path

    return slice_model


def accept(path):
    target = PrintTarget(UM2_PLUS, FILAMENT_MM2, 0.4, nozzle_c=210.0, bed_c=60.0)
    return accept_gcode(path.read_bytes().splitlines(keepends=True), target, stopwatch=Summed())


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
    accepted = accept(slice_box("-".join(options).replace("/", "") or "default", *options))
    assert (accepted.filament_type, accepted.nozzle_mm, accepted.nozzle_c, accepted.bed_c) == (
        "PLA",
        0.4,
        205.0,
        55.0,
    )
    warning = [notice for notice in accepted.notices if notice.startswith("Warning")]
    assert len(warning) == 1 and "'ULTIMAKER2'" in warning[0] and "fits the Ultimaker 2+" in warning[0]
    assert max(accepted.max_mm) < 220.0


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--filament-diameter", "1.75"), "filament of 1.75 mm: set the filament's diameter to 2.85 mm"),
        (("--gcode-flavor", "smoothie"), "flavour is 'smoothie': set the G-code flavour to Marlin"),
        (("--use-volumetric-e",), "switch off `Use volumetric E`"),
        (("--temperature", "290"), r"line \d+: M104 sets 290 C, and the nozzle may have at most 260"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_refusals_say_what_to_change_in_the_slicer(slice_box, options, reason):
    with pytest.raises(GcodeRefused, match=reason):
        accept(slice_box("-".join(options), *options))
