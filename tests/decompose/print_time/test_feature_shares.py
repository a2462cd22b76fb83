"""Shares of features in the price of a whole model."""

import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from decompose.print_time import TERM_GROUPS, PrintTimeSettings, estimate_feature_shares

SIDES_MM = st.floats(5.0, 400.0)


def estimate_shares(mesh, **changes):
    return estimate_feature_shares(
        mesh.vertices.view(float), mesh.faces.astype(int), PrintTimeSettings(**changes)
    )


@given(SIDES_MM, SIDES_MM, SIDES_MM)
def test_shares_sum_to_one(width_mm, depth_mm, height_mm):
    shares = estimate_shares(trimesh.creation.box((width_mm, depth_mm, height_mm)))
    assert shares.keys() == TERM_GROUPS.keys()
    assert sum(shares.values()) == pytest.approx(1.0)
    assert min(shares.values()) >= 0.0
    assert shares["supports"] == 0.0  # cuts avoid supports


def test_sheet_is_skin_and_tower_is_walls():
    sheet = estimate_shares(trimesh.creation.box((200.0, 200.0, 2.0)))
    tower = estimate_shares(trimesh.creation.box((10.0, 10.0, 200.0)))
    assert max(sheet, key=sheet.get) == "skins"
    assert max(tower, key=tower.get) == "walls"
    assert estimate_shares(trimesh.creation.box((50.0,) * 3), infill_line_distance_mm=0.0)["infill"] < 0.01
