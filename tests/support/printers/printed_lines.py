"""Printed lines and travel of toolpaths, to compare a changed file with the original."""

import numpy as np
import pytest
import shapely


def assert_same_lines(path, other_path):
    """Compare the lines by their ends in either direction, feature and feedrate, and their extrusion."""
    (rows, extruded_mm), (other_rows, other_extruded_mm) = map(list_printed_lines, (path, other_path))
    assert rows == other_rows
    assert extruded_mm == pytest.approx(other_extruded_mm, abs=2e-4)


def list_printed_lines(path):
    is_line = (path.extruded_mm > 0.0) & path.is_head_move
    points = np.stack((path.start[is_line, :3], path.end[is_line, :3]), axis=1).round(2)
    rows = zip(
        (tuple(sorted(map(tuple, ends))) for ends in points.tolist()),
        [path.features[feature] for feature in path.feature[is_line]],
        path.feed_mm_min[is_line].tolist(),
        path.extruded_mm[is_line].tolist(),
        strict=True,
    )
    sorted_rows = sorted(rows)
    return [row[:3] for row in sorted_rows], [row[3] for row in sorted_rows]


def measure_travel_mm(path):
    is_travel = (path.extruded_mm == 0.0) & path.is_head_move & (path.end[:, 2] == path.start[:, 2])
    return float(np.hypot(*(path.end - path.start)[is_travel, :2].T).sum())


def list_travel(path, layer):
    """Return the travel moves within a layer, from the end of the one below."""
    is_travel = (path.extruded_mm == 0.0) & path.is_head_move & (path.end[:, 2] == path.start[:, 2])
    is_travel &= path.start[:, 2] == path.end[path.layer == layer, 2].max()
    return shapely.MultiLineString(
        list(np.stack((path.start[is_travel, :2], path.end[is_travel, :2]), axis=1))
    )
