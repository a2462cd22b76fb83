"""Fixture that slices with PrusaSlicer and its own profile for the Ultimaker 2."""

import configparser
import shutil
import subprocess
from itertools import chain
from pathlib import Path

import pytest
import trimesh

PRUSA_SLICER = shutil.which("prusa-slicer")
PRESETS = ("print:0.20mm NORMAL @ULTIMAKER2", "filament:Generic PLA @ULTIMAKER2", "printer:Ultimaker 2")


def find_profile():
    """Return the path of PrusaSlicer's presets for Ultimakers."""
    prefix_folder = Path(PRUSA_SLICER).resolve().parents[1]
    return next(
        chain.from_iterable(
            prefix_folder.glob(f"{prefix}share/PrusaSlicer/profiles/Ultimaker.ini") for prefix in ("", "*/*/")
        )
    )


def flatten_preset(presets, title):
    """Return the values of a preset, including inherited ones."""
    preset, values = dict(presets[title]), {}
    for name in filter(None, map(str.strip, preset.pop("inherits", "").split(";"))):
        values |= flatten_preset(presets, f"{title.partition(':')[0]}:{name}")
    return values | preset


@pytest.fixture(scope="session")
def slice_box(tmp_path_factory):
    """Return a function that slices a box with options of PrusaSlicer, and returns the path of the G-code."""
    if PRUSA_SLICER is None:
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
            PRUSA_SLICER,
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
