"""Skin at hidden recesses: patches that close only recesses are left out, and all else stays."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import shapely
import trimesh

from printers.slicing_printers import PRINTERS
from slicing.checks import read_toolpath
from slicing.glued_parts import HiddenRecess
from slicing.glued_parts.sides import find_bed_points
from slicing.plate import slice_plate
from slicing.settings import PartSettings, SettingsRequest, resolve_settings

HEIGHT_MM = 12.0
DEPTH_MM = 0.35
STROKES_MM = ((-6.0, 6.0), (0.0, 6.0), (6.0, 6.0))  # X and length along Y of each stroke
RECESS = HiddenRecess(-6.5, -3.5, 6.5, 3.5, 0.0, DEPTH_MM)


def make_block(opens_upwards):
    """Make a block with the strokes of a mark in its top or in its bed face."""
    block = trimesh.creation.box((60.0, 50.0, HEIGHT_MM))
    block.apply_translation((0.0, 0.0, HEIGHT_MM / 2.0))
    return cut_strokes(block, HEIGHT_MM if opens_upwards else 0.0)


def cut_strokes(mesh, face_z_mm):
    """Cut the strokes of a mark into a level face of a mesh."""
    for x_mm, length_mm in STROKES_MM:
        groove = trimesh.creation.box((2.0 * DEPTH_MM, length_mm, 2.0 * DEPTH_MM))
        mesh = mesh.difference(groove.apply_translation((x_mm, 0.0, face_z_mm)), engine="manifold")
    return mesh


def list_skin(path, settings):
    """List the lines of skin of each layer, in bed-centred mm."""
    is_skin = path.is_feature("SKIN") & (path.extruded_mm > 0.0) & path.is_head_move
    starts_mm, ends_mm = find_bed_points(path, settings)
    lines = shapely.linestrings(np.stack([starts_mm[is_skin], ends_mm[is_skin]], axis=1))
    return {layer: lines[path.layer[is_skin] == layer] for layer in np.unique(path.layer[is_skin]).tolist()}


@pytest.fixture
def slice_block(make_request, resources):
    """Return a function that slices a mesh with recesses, and returns the result, its path and its skin."""

    def slice_mesh(mesh, *recesses, overrides=None, **changes):
        part = PartSettings(HEIGHT_MM, bed_face_hidden=True, tops_hidden=True)
        request = SettingsRequest(PRINTERS["ultimaker2_plus"], "glue", overrides=overrides or {})
        settings = replace(resolve_settings(request, resources, part), **changes)
        result = slice_plate(make_request(mesh, settings=settings, hidden_recesses=recesses))
        path = read_toolpath(result.gcode.read_bytes())
        return result, path, list_skin(path, settings)

    return slice_mesh


@pytest.mark.parametrize("opens_upwards", [False, True], ids=["bed", "top"])
def test_patches_are_left_out_and_solid_layers_stay(slice_block, opens_upwards):
    z_mm = (HEIGHT_MM, HEIGHT_MM - DEPTH_MM) if opens_upwards else (0.0, DEPTH_MM)
    recess = replace(RECESS, face_z_mm=z_mm[0], bottom_z_mm=z_mm[1])
    block = make_block(opens_upwards)
    old_result, old_path, old_skin = slice_block(block)
    new_result, new_path, new_skin = slice_block(block, recess)
    omitted_layers = sorted(set(old_skin) - set(new_skin))
    last = int(old_path.layer.max())
    assert omitted_layers == ([last - 4, last - 3] if opens_upwards else [2, 3, 4])
    assert all(len(new_skin[layer]) == len(old_skin[layer]) for layer in new_skin)
    assert new_result.sliced_s < old_result.sliced_s
    for feature in ("WALL-OUTER", "WALL-INNER", "FILL"):
        lengths = [p.extruded_mm[p.is_feature(feature)].clip(min=0.0).sum() for p in (old_path, new_path)]
        assert lengths[1] == pytest.approx(lengths[0], abs=0.02)


def test_patch_that_closes_something_else_as_well_stays(slice_block):
    block = make_block(opens_upwards=False)
    hollow = trimesh.creation.box((30.0, 30.0, 2.0 * DEPTH_MM))
    block = block.difference(hollow, engine="manifold")
    assert set(slice_block(block)[2]) == set(slice_block(block, RECESS)[2])


def test_recess_elsewhere_changes_nothing(slice_block):
    block = make_block(opens_upwards=False)
    elsewhere = RECESS.move((15.0, 15.0))
    old_mm, new_mm = (slice_block(block, *recesses)[1].extruded_mm.sum() for recesses in ((), (elsewhere,)))
    assert new_mm == pytest.approx(old_mm, abs=1e-4)


def test_patches_stay_in_layers_of_the_minimum_time(slice_block):
    block, overrides = make_block(opens_upwards=False), {"cool_min_layer_time": 200}
    old_skin = slice_block(block, overrides=overrides)[2]
    assert set(slice_block(block, RECESS, overrides=overrides)[2]) == set(old_skin) > {2, 3, 4}


def test_patches_stay_where_inner_walls_stay(slice_block):
    block = make_block(opens_upwards=False)
    old_skin = slice_block(block, has_single_hidden_walls=False)[2]
    assert set(slice_block(block, RECESS, has_single_hidden_walls=False)[2]) == set(old_skin) > {2, 3, 4}


def test_patch_that_closes_a_visible_slope_as_well_stays(slice_block):
    flat_cone = [(x, y, z) for x, y, z in product((-1.0, 1.0), (-1.0, 1.0), (0.0, 1.6))]
    sizes_mm = np.array([(9.2, 6.2) if z == 0.0 else (5.2, 2.2) for _, _, z in flat_cone])
    corners_mm = np.array(flat_cone) * np.column_stack([sizes_mm, np.ones(8)])
    foot = cut_strokes(trimesh.convex.convex_hull(corners_mm), 0.0).apply_translation((0.0, -30.0, 0.0))
    part = trimesh.util.concatenate([make_block(opens_upwards=False), foot])
    part.apply_translation((0.0, 6.0, 0.0))
    recesses = [RECESS.move((0.0, y_mm)) for y_mm in (6.0, -24.0)]
    old_skin, new_skin = slice_block(part)[2], slice_block(part, *recesses)[2]
    for layer in range(2, 6):
        old_mm, new_mm = (sum(line.length for line in skin[layer]) for skin in (old_skin, new_skin))
        area = recesses[1].build_area(4.0)
        on_foot_mm = sum(line.length for line in old_skin[layer] if area.intersects(line))
        assert new_mm == pytest.approx(on_foot_mm)
        assert (new_mm < old_mm) == (layer < 5)
