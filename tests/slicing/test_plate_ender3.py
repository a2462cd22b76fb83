"""Slices for Creality's Ender-3, from Cura's own definition of the printer."""

import pytest
import trimesh

from drivers.printers import SLICING_PROFILES, list_usable_volumes
from model_files.make_stl import write_stl_bytes
from printers.slicing_printers import PRINTERS
from slicing.errors import BadSetting
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import SettingsRequest, resolve_settings

MODEL = "creality_ender3"


@pytest.mark.parametrize("quality", ["glue", "paper", "standard"])
def test_part_passes_all_checks_of_a_slice(tmp_path, engine, resources, quality):
    request = SettingsRequest(PRINTERS[MODEL], quality, material="generic_pla_175")
    settings = resolve_settings(request, resources)
    assert settings.filament_diameter_mm == 1.75
    boxes = list_usable_volumes(SLICING_PROFILES[MODEL], 0.0)
    bed = tuple((*list_corners(box.rect), box.height_mm) for box in boxes)
    stl = tmp_path / "part.stl"
    stl.write_bytes(write_stl_bytes(trimesh.creation.box((60, 30, 10))))
    result = slice_plate(PlateRequest(stl, settings, tmp_path / "part.gcode", engine, bed, timeout_s=60.0))
    text = result.gcode.read_text()
    positions = [text.index(f"\n{mark}") for mark in ("M190 S", "M109 S200", "G28\n", ";LAYER:0\n")]
    assert positions == sorted(positions)  # the printer heats before it homes
    # Of 8 mm, 6.5 mm are already retracted.
    assert text.rindex("\nG1 F1500 E-1.5\n") > text.rindex(";TIME_ELAPSED")
    assert "M83" not in text and "G10" not in text


def list_corners(rect):
    return rect.min_x_mm, rect.min_y_mm, rect.max_x_mm, rect.max_y_mm


def test_thick_filament_is_refused_and_a_thin_one_is_suggested(resources):
    with pytest.raises(BadSetting, match=r"not for the Creality Ender-3.*generic_pla_175"):
        resolve_settings(SettingsRequest(PRINTERS[MODEL]), resources)


def test_missing_nozzle_is_refused(resources):
    request = SettingsRequest(PRINTERS[MODEL], material="generic_pla_175", nozzle_mm=0.7)
    with pytest.raises(BadSetting, match=r"nozzle 0.7 mm.*0.4mm Nozzle"):
        resolve_settings(request, resources)
