"""Records in the form of the books of farm 0.1."""

import pytest
from pydantic import ValidationError

from books.make_books import make_plan_event
from farm.model import Part, PartGeometry, PartPrintOptions

FLAT_PART = {
    "id": "1/p01",
    "job": 1,
    "plate": "1/01",
    "file": "p.stl",
    "cut_from": "1/p00",
    "to_model": [1.0] * 16,
    "min_mm": [0.0] * 3,
    "max_mm": [1.0] * 3,
    "volume_mm3": 1.0,
    "brim_width_mm": 3.0,
    "layer_0_expansion_mm": -0.2,
    "stands": False,
}


def test_part_of_farm_0_1_is_read_into_nested_records():
    part = Part.model_validate(FLAT_PART)
    assert part.print_options == PartPrintOptions(brim_width_mm=3.0, layer_0_expansion_mm=-0.2, stands=False)
    assert (part.geometry, part.cut_from) == (make_plan_event().parts[0].geometry, "1/p00")
    assert Part.model_validate_json(part.model_dump_json()) == part
    assert "brim_width_mm" in FLAT_PART  # the input is unchanged


def test_part_without_print_options_has_those_of_its_quality():
    options = ("brim_width_mm", "layer_0_expansion_mm", "stands")
    part = Part.model_validate({name: value for name, value in FLAT_PART.items() if name not in options})
    assert part.print_options == PartPrintOptions()
    assert isinstance(part.geometry, PartGeometry)


@pytest.mark.parametrize("damage", [{"to_model": None}, {"stand": True}, {"volume_mm3": "much"}])
def test_damaged_part_is_refused(damage):
    with pytest.raises(ValidationError):
        Part.model_validate({**FLAT_PART, **damage})


def test_plate_of_farm_0_1_is_read_by_its_former_names():
    plate = make_plan_event().plates[0]
    old_fields = plate.model_dump()
    old_fields |= {"print_time_s": old_fields.pop("sliced_s"), "estimated_s": old_fields.pop("expected_s")}
    assert type(plate).model_validate(old_fields) == plate
