"""Places of parts on beds in the instructions, which must be those of the slices."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from decompose.export.layout import describe_place, put_part_on_bed
from decompose.geometry import Solid
from decompose.printers import BedPlace
from decompose.results import Part
from drivers.printers import PROFILES, list_usable_volumes, place_part
from farm.planning.parts import slice_part
from farm.planning.parts.bed_places import Bed, make_place_finder

PROFILE = PROFILES["ultimaker2_plus"]
BED = Bed(PROFILE.bed_mm, list_usable_volumes(PROFILE, 8.0), SimpleNamespace(scale_xy=1.0, scale_z=1.0))


def make_part(*size_mm):
    corner = np.array(size_mm) / 2.0
    return Part("p01", Solid.box(-corner, corner), np.eye(4), 1.0, "um2-01")


@pytest.mark.parametrize("size_mm", [(50.0, 20.0, 10.0), (160.0, 205.0, 10.0), (190.0, 206.0, 10.0)])
def test_part_is_drawn_where_it_is_sliced(size_mm):
    part = make_part(*size_mm)
    pose = make_place_finder({"um2-01": BED})(part)
    placement = place_part(size_mm, BED.usable_volumes)
    assert pose == BedPlace(PROFILE.bed_mm, (placement.x_mm, placement.y_mm), placement.is_rotated)
    vertices, faces = part.build_printing_mesh()
    drawn_mm, _ = put_part_on_bed(vertices, faces, pose)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.apply_transform(slice_part._build_transform(mesh, placement, np.ones(3)))
    assert drawn_mm[:, :2] == pytest.approx(mesh.vertices[:, :2])


def test_part_of_an_unknown_printer_and_one_that_does_not_fit_have_no_place():
    assert make_place_finder({})(make_part(10.0, 10.0, 10.0)) is None
    assert BED.place(make_part(300.0, 10.0, 10.0)) is None


def test_place_is_described_from_the_front():
    assert describe_place(None) == ""
    assert describe_place(BedPlace((223.0, 223.0), (0.2, -0.4), False)) == "in the middle"
    text = describe_place(BedPlace((223.0, 223.0), (-3.0, 12.4), True))
    assert text == "3 mm left of and 12 mm behind the middle"
