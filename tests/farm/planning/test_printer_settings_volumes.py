"""Beds of the drivers compared with Cura's definitions, and the smaller usable volume of a part."""

import pytest

from drivers.printers import PROFILES, SLICING_PROFILES
from farm.config import PrinterSection
from farm.planning.printer_settings import find_usable_volumes, list_bed_boxes, list_max_part_sizes_mm
from printers.slicing_printers import UM2_PLUS
from slicing.errors import EngineMissing
from slicing.settings import SettingsRequest, find_resources, resolve_settings


@pytest.fixture(scope="module")
def resources():
    try:
        return find_resources()
    except EngineMissing as missing:
        pytest.skip(str(missing))


@pytest.mark.parametrize("model", sorted(SLICING_PROFILES))
def test_beds_and_clips_equal_those_of_cura(resources, model):
    settings, profile = resources.read_machine(model).settings, SLICING_PROFILES[model]
    assert profile.model == model
    assert profile.title == resources.read_machine(model).name
    assert profile.bed_mm == (settings["machine_width"].default, settings["machine_depth"].default)
    assert profile.height_mm == settings["machine_height"].default
    areas = {
        (*(min(axis) for axis in zip(*area, strict=True)), *(max(axis) for axis in zip(*area, strict=True)))
        for area in settings["machine_disallowed_areas"].default
    }
    assert {(c.min_x_mm, c.min_y_mm, c.max_x_mm, c.max_y_mm) for c in profile.clips} == areas


def test_only_printers_with_a_heated_bed_have_a_driver_profile(resources):
    heated_models = {
        model
        for model in SLICING_PROFILES
        if resources.read_machine(model).settings["machine_heated_bed"].default
    }
    assert set(PROFILES) == heated_models


def test_usable_volume_of_a_model_is_reduced_by_the_shrinkage(resources):
    section = PrinterSection(name="a", model="ultimaker2_plus", port="/dev/ttyACM0")
    settings = resolve_settings(SettingsRequest(UM2_PLUS, material="generic_abs"), resources)
    volumes = find_usable_volumes(section, settings.brim_width_mm)
    for (x, y, z), box in zip(list_max_part_sizes_mm(volumes, settings), volumes, strict=True):
        assert (x * settings.scale_xy, y * settings.scale_xy, z * settings.scale_z) == pytest.approx(
            box.size_mm
        )
        assert x < box.size_mm[0]
    assert max(box[4] for box in list_bed_boxes(section)) == 205.0  # the bed itself is unchanged
