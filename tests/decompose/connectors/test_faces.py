"""Free area on faces for the outlines of tools."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from decompose.connectors import Blank
from decompose.connectors.faces import Workpieces, erode_area, find_sides
from decompose.connectors.records import RIM_MM
from decompose.connectors.tools import make_groove
from decompose.geometry import Solid
from decompose.pieces import Piece, find_joints


def test_erosion_leaves_the_places_where_a_shape_stays_inside():
    area = shapely.box(0, 0, 20, 10) - shapely.box(8, 4, 12, 6)
    shape = shapely.box(-1, 0, 1, 3)
    expected_area = shapely.box(1, 0, 19, 7) - shapely.box(7, 1, 13, 6)
    assert erode_area(area, shape).symmetric_difference(expected_area).area < 1e-9
    assert erode_area(shapely.box(0, 0, 1.9, 10), shape).is_empty
    assert erode_area(shapely.Polygon(), shape).is_empty


def test_areas_of_a_face_without_tools_follow_every_change():
    """Compare areas that were searched before other tools came and went with those of new workpieces."""
    solids = [Solid.box((0, 0, 0), (40, 30, 10)), Solid.box((0, 0, 10), (40, 30, 20))]
    blanks = [Blank(str(n), solid, np.array([0.0, 0.0, 1.0])) for n, solid in enumerate(solids)]
    joints = find_joints([Piece(s, np.array([[0.0, 0.0, 1.0, 10.0]]), np.zeros((0, 2, 3))) for s in solids])
    [(side, _)] = find_sides(blanks, 0, joints[0])
    grooves = [
        make_groove(side.part, np.array([(x, 5.0, 10.0), (x, 25.0, 10.0)]), side.inward_normal)
        for x in (10.0, 20.0, 30.0)
    ]

    def measure_areas_mm2(workpieces):
        return [workpieces.find_solid_area(side, 2.0, rim_mm).area for rim_mm in (RIM_MM, 0.8)]

    workpieces = Workpieces(blanks)
    placed = []
    changes = ((0, True), (1, True), (2, True), (1, False), (0, False), (1, True))
    for number, (groove, is_added) in enumerate(changes, 1):
        if is_added:
            workpieces.add_tools([grooves[groove]])
            placed.append(grooves[groove])
        else:
            workpieces.remove_tools([grooves[groove]])
            placed.remove(grooves[groove])
        fresh_workpieces = Workpieces(blanks)
        fresh_workpieces.add_tools(placed)
        assert measure_areas_mm2(workpieces) == pytest.approx(measure_areas_mm2(fresh_workpieces))
        assert workpieces.count_changes(side.part) == number
    assert measure_areas_mm2(workpieces)[0] < measure_areas_mm2(Workpieces(blanks))[0]
