"""Fixture for slices of PrusaSlicer with its own profile for the Ultimaker 2."""

import configparser
import shutil
import subprocess
from itertools import chain
from pathlib import Path

import pytest
import trimesh

PROGRAM = shutil.which("prusa-slicer")
PRESETS = ("print:0.20mm NORMAL @ULTIMAKER2", "filament:Generic PLA @ULTIMAKER2", "printer:Ultimaker 2")


def find_profile():
    """Return the file with PrusaSlicer's presets for Ultimakers."""
    top = Path(PROGRAM).resolve().parents[1]
    return next(
        chain.from_iterable(
            top.glob(f"{prefix}share/PrusaSlicer/profiles/Ultimaker.ini") for prefix in ("", "*/*/")
        )
    )


def flatten_preset(presets, title):
    """Return the values of a preset with those that it inherits."""
    preset, values = dict(presets[title]), {}
    for name in filter(None, map(str.strip, preset.pop("inherits", "").split(";"))):
        values |= flatten_preset(presets, f"{title.partition(':')[0]}:{name}")
    return values | preset


@pytest.fixture(scope="session")
def slice_box(tmp_path_factory):
    """Return a function that slices a box with PrusaSlicer and options; it returns the path of the G-code."""
    if PROGRAM is None:
        pytest.skip("prusa-slicer is missing: `make peers`")
    folder = tmp_path_factory.mktemp("prusa")
    presets = configparser.RawConfigParser(delimiters=("=",), comment_prefixes=("#",))
    presets.read(find_profile())
    values = {key: value for title in PRESETS for key, value in flatten_preset(presets, title).items()}
    (folder / "um2.ini").write_text("".join(f"{key} = {value}\n" for key, value in values.items()))
    trimesh.creation.box((20.0, 20.0, 2.0)).export(folder / "box.stl")

    def slice_model(name, *options):
        path = folder / f"{name}.gcode"
        command = [
            PROGRAM,
            "--load",
            folder / "um2.ini",
            *options,
            "--export-gcode",
            folder / "box.stl",
            "-o",
            path,
        ]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        return path

    return slice_model
