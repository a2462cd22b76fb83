"""Slices of the real CuraEngine."""

import errno
import multiprocessing
import os
import select
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from model_files.make_stl import write_stl_bytes
from slicing import plate
from slicing.errors import EngineFailed, EngineMissing, EngineTimeout, Rule, SliceRejected, SlicingError
from slicing.mesh import read_triangles
from slicing.plate import slice_plate
from slicing.slice_store import write_atomically


def test_cube_with_the_settings_of_the_paper_has_the_known_time_and_filament(make_request, make_settings):
    """Check the result of the whole chain; with other settings, the print takes up to six times as long."""
    result = slice_plate(make_request(trimesh.creation.box((50, 50, 50)), settings=make_settings("paper")))
    # CuraEngine says 4906 s, of which `remove_reset_times` removes 35 s for a reset of the extruder.
    assert int(result.sliced_s) == 4871
    assert int(result.filament_mm3) == 17911
    assert (result.layers, result.height_mm) == (200, pytest.approx(50.02))
    assert result.grams == pytest.approx(17.911 * 1.24, rel=1e-3)
    assert result.max_mm[0] == pytest.approx(25 + 8.05 - 0.175, abs=0.05)


def test_file_is_ready_to_stream(make_request, cube_20):
    result = slice_plate(make_request(cube_20))
    text = result.gcode.read_text()
    assert f";TIME:{int(result.sliced_s)}\n" in text[:200]
    assert "2.14748e+06" not in text
    order = [
        text.index(mark)
        for mark in ("\nG28\n", "\nM190 S60\n", "\nM109 S200\n", "\nG1 F47 E7.8\n", ";LAYER:0\n")
    ]
    assert order == sorted(order)
    assert text.index("G1 F1500 E-13.5") > text.rindex(";TIME_ELAPSED")
    assert "part.stl" in text
    assert str(result.gcode.parent) not in text


def test_supports_are_switched_on_and_off_in_both_scopes(make_request, make_settings):
    tee = trimesh.boolean.union(
        [
            trimesh.creation.box((10, 10, 20)),
            trimesh.creation.box((40, 10, 4), trimesh.transformations.translation_matrix((0, 0, 12))),
        ]
    )
    assert ";TYPE:SUPPORT\n" in slice_plate(make_request(tee)).gcode.read_text()
    plain_slice = slice_plate(make_request(tee, settings=make_settings(support_enable="false")))
    assert ";TYPE:SUPPORT\n" not in plain_slice.gcode.read_text()


def test_memory_limit_grows_with_the_layers(make_request, make_settings):
    result = slice_plate(
        make_request(
            trimesh.creation.box((3, 3, 204)), settings=make_settings("high", support_enable="false")
        )
    )
    assert result.layers > 3300


@pytest.mark.parametrize(
    "mesh", [trimesh.creation.cone(10, 30), trimesh.creation.cone(4, 60)], ids=["cone", "spike"]
)
def test_unprintable_tips_are_accepted(make_request, mesh):
    result = slice_plate(make_request(mesh))
    assert result.height_mm < mesh.extents[2]


def make_prism(bottom_mm, top_mm, height_mm):
    """Make a box 51.142 mm deep whose top is narrower than its bottom."""
    ends = ((0.0, bottom_mm / 2), (height_mm, top_mm / 2))
    corners = [(x * half, y * 25.571, z) for z, half in ends for x in (-1, 1) for y in (-1, 1)]
    return trimesh.convex.convex_hull(np.array(corners))


@pytest.mark.parametrize(
    "mesh", [make_prism(85.042, 85.042, 2), make_prism(84.98, 85.1, 6)], ids=["all layers", "one layer"]
)
def test_sound_part_that_loses_a_corner_in_the_engine_is_sliced_again(make_request, make_settings, mesh):
    """Use an outer wall whose centre line is 84.642 x 50.742 mm: 2**32 square micrometres."""
    result = slice_plate(make_request(mesh, settings=make_settings(infill_sparse_density="0")))
    assert result.unprinted_walls == ()
    assert result.height_mm == pytest.approx(mesh.extents[2], abs=0.11)
    assert result.max_mm[0] < mesh.extents[0] / 2 + 8.1  # including the brim


def test_part_is_sliced_again_as_a_scaled_mesh(make_request, tmp_path):
    """Check the scaled mesh, which is sliced if a section loses a corner before the walls are offset."""
    request = make_request(trimesh.creation.box((80, 60, 2)))
    corners = read_triangles(request.stl.read_bytes())
    folder = tmp_path / "scaled"
    folder.mkdir()
    scaled_mesh = plate._build_scaled_request(request, corners, 1e-3, 0.01, folder)
    assert scaled_mesh.stl != request.stl
    assert trimesh.load_mesh(scaled_mesh.stl).extents == pytest.approx((80.08, 60.06, 2.0), abs=1e-3)
    assert float(scaled_mesh.settings.extruder["xy_offset"]) == pytest.approx(
        0.01 + float(request.settings.extruder.get("xy_offset") or 0.0)
    )
    assert plate._build_scaled_request(request, corners, 0.0, 0.0, folder) is request


def test_inner_wall_that_is_lost_in_the_engine_is_sliced_again(make_request):
    """Use an inner wall of 84.642 x 50.742 mm, without which the part is filled with skin."""
    result = slice_plate(make_request(trimesh.creation.box((85.692, 51.792, 3))))
    text = result.gcode.read_text()
    layer = text[text.index(";LAYER:7\n") : text.index(";LAYER:8\n")]
    assert ";TYPE:WALL-INNER" in layer
    assert ";TYPE:SKIN" not in layer


BALL = trimesh.creation.icosphere(3, 20)


def keep_facets(mesh, count):
    return write_stl_bytes(trimesh.Trimesh(mesh.vertices, mesh.faces[:count], process=False))


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (np.random.default_rng(1).bytes(4096), Rule.BROKEN_MESH),
        (b"", Rule.BROKEN_MESH),
        (b"solid nothing\nendsolid nothing\n", Rule.BROKEN_MESH),
        (write_stl_bytes(BALL)[:30_000], Rule.BROKEN_MESH),
        (keep_facets(BALL, 640), Rule.BROKEN_MESH),
        (keep_facets(trimesh.creation.box((20, 20, 20)), 11), Rule.BROKEN_MESH),
        (write_stl_bytes(trimesh.creation.box((20, 20, 0.1))), Rule.NOTHING_PRINTED),
        (write_stl_bytes(trimesh.creation.box((20, 0.2, 20))), Rule.NOTHING_PRINTED),
        (write_stl_bytes(trimesh.creation.box((0.02, 0.02, 0.02))), Rule.NOTHING_PRINTED),
        (trimesh.creation.box((20, 20, 20)).export(file_type="stl"), Rule.HEIGHT),
        (write_stl_bytes(trimesh.creation.box((213, 50, 3))), Rule.OUTSIDE_BED),
        (write_stl_bytes(trimesh.creation.box((10, 10, 206))), Rule.OUTSIDE_BED),
    ],
    ids=[
        "random bytes",
        "empty",
        "no facets",
        "cut short",
        "half the facets",
        "one facet missing",
        "flat",
        "thin wall",
        "in metres",
        "below the bed",
        "too wide with its brim",
        "too high",
    ],
)
def test_bad_input_is_rejected_and_leaves_no_file(make_request, content, rule):
    request = make_request(content)
    with pytest.raises(SliceRejected) as error:
        slice_plate(request)
    assert error.value.rule is rule
    assert "\n" not in str(error.value)
    assert [path.name for path in request.output_path.parent.iterdir()] == ["part.stl"]


def test_repeated_slice_runs_no_engine(make_request, cube_20, tmp_path, make_settings):
    request = make_request(cube_20, cache=tmp_path / "cache")
    first_result = slice_plate(request)
    second_result = slice_plate(replace(request, output_path=tmp_path / "again.gcode"))
    assert (first_result.is_cached, second_result.is_cached) == (False, True)
    assert second_result == replace(first_result, gcode=second_result.gcode, is_cached=True)
    assert second_result.gcode.read_bytes() == first_result.gcode.read_bytes()
    assert not slice_plate(replace(request, settings=make_settings("paper"))).is_cached
    with pytest.raises(SliceRejected, match="build volume"):
        slice_plate(replace(request, bed=((-5.0, -5.0, 5.0, 5.0, 205.0),)))


def test_error_for_a_full_disk_names_the_file(tmp_path, monkeypatch):
    def fail_on_full_disk(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("slicing.slice_store.os.fdopen", fail_on_full_disk)
    with pytest.raises(OSError, match="No space left") as error:
        write_atomically(tmp_path / "part.gcode", b"G28")
    assert error.value.filename == str(tmp_path / "part.gcode")
    assert not list(tmp_path.iterdir())


def test_reading_a_cache_entry_counts_as_use(make_request, cube_20, tmp_path):
    request = make_request(cube_20, cache=tmp_path / "cache")
    slice_plate(request)
    (entry,) = (tmp_path / "cache").glob("*.json")
    os.utime(entry, (1000, 1000))
    assert slice_plate(request).is_cached
    assert entry.stat().st_mtime > 1000


def test_damaged_cache_entry_is_sliced_again(make_request, cube_20, tmp_path):
    cache = tmp_path / "cache"
    request = make_request(cube_20, cache=cache)
    first_result = slice_plate(request)
    for path in cache.glob("*.gcode"):
        path.write_text("G28")
    second_result = slice_plate(request)
    assert (second_result.is_cached, second_result.sha256) == (False, first_result.sha256)
    for path in cache.glob("*.json"):
        path.write_text("{}")
    assert not slice_plate(request).is_cached


def test_only_an_incomplete_stored_slice_needs_the_engine(
    make_request, cube_20, tmp_path, write_script, engine
):
    engine_script = write_script(f'exec {engine} "$@"')
    cache = tmp_path / "cache"
    request = replace(make_request(cube_20, cache=cache), engine=engine_script)
    first_result = slice_plate(request)
    assert not first_result.is_cached
    write_script("echo '[ERROR] was asked to slice'; exit 1")  # the same program fails from now on
    assert slice_plate(request) == replace(first_result, is_cached=True)
    (entry,) = cache.glob("*.json")
    entry.unlink()  # as if the worker was killed between the writes of the two files
    with pytest.raises(EngineFailed, match="was asked to slice"):
        slice_plate(request)


def test_engine_runs_in_worker_processes(make_request, cube_20):
    request = make_request(cube_20)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(slice_plate, request).result(60).layers == 100
        low_bed_request = replace(request, bed=((-30.0, -30.0, 30.0, 30.0, 5.0),))
        with pytest.raises(SliceRejected, match="outside the bed"):
            pool.submit(slice_plate, low_bed_request).result(60)


def test_failing_engine_is_reported(make_request, cube_20, write_script):
    engine = write_script('echo "[ERROR] no such luck" >&2; exit 3')
    with pytest.raises(EngineFailed, match=r"exit code 3\): \[ERROR\] no such luck"):
        slice_plate(replace(make_request(cube_20), engine=engine))


def test_killed_engine_is_reported(make_request, cube_20, write_script):
    with pytest.raises(EngineFailed, match="SIGSEGV"):
        slice_plate(replace(make_request(cube_20), engine=write_script("kill -SEGV $$")))


def test_engine_that_hangs_is_stopped_with_all_its_processes(make_request, cube_20, write_script, tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    os.close(os.open(fifo, os.O_WRONLY))  # the engine may be killed before it opens the FIFO
    try:
        engine = write_script(f"sleep 600 > {fifo} & sleep 600 > {fifo}")
        with pytest.raises(EngineTimeout, match="did not finish within 1 s"):
            slice_plate(replace(make_request(cube_20), engine=engine, timeout_s=1.0))
        poll = select.poll()
        poll.register(reader, 0)
        assert poll.poll(10_000)  # all processes with the writing end have ended
    finally:
        os.close(reader)


def test_missing_engine_is_reported(make_request, cube_20, tmp_path):
    with pytest.raises(EngineMissing, match="FARM_CURA_ENGINE"):
        slice_plate(replace(make_request(cube_20), engine=tmp_path / "nothing"))


def test_missing_model_is_reported(make_request, cube_20, tmp_path):
    with pytest.raises(SlicingError, match="No such file"):
        slice_plate(replace(make_request(cube_20), stl=tmp_path / "nothing.stl"))
