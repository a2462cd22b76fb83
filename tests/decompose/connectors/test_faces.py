"""Free area on faces for the outlines of tools."""

from __future__ import annotations

import shapely

from decompose.connectors.faces import erode_area


def test_erosion_leaves_the_places_where_a_shape_stays_inside():
    area = shapely.box(0, 0, 20, 10) - shapely.box(8, 4, 12, 6)
    shape = shapely.box(-1, 0, 1, 3)
    expected_area = shapely.box(1, 0, 19, 7) - shapely.box(7, 1, 13, 6)
    assert erode_area(area, shape).symmetric_difference(expected_area).area < 1e-9
    assert erode_area(shapely.box(0, 0, 1.9, 10), shape).is_empty
    assert erode_area(shapely.Polygon(), shape).is_empty
