"""`farm slice` as a command."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

FARM = Path(sys.executable).with_name("farm")


@pytest.fixture
def box(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box((20.0, 18.0, 2.0)).export(path)
    return path


@pytest.fixture
def env(tmp_path):
    """Set the environment variables of the folders for temporary files and for the cache."""
    (tmp_path / "tmp").mkdir()
    return {**os.environ, "TMPDIR": str(tmp_path / "tmp"), "XDG_CACHE_HOME": str(tmp_path / "cache")}


def run_slice(env, *arguments):
    command = [str(FARM), "slice", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=env, check=False)


def test_json_is_one_object_and_a_second_slice_comes_from_the_cache(box, env, tmp_path):
    first_result = run_slice(env, box, "-o", tmp_path / "a.gcode", "--json")
    assert (first_result.returncode, first_result.stderr) == (0, "")
    report = json.loads(first_result.stdout)
    assert (report["schema"], report["cached"]) == (1, False)
    second_result = run_slice(env, box, "-o", tmp_path / "b.gcode", "--price-per-kg", "20")
    assert second_result.returncode == 0
    assert second_result.stdout.endswith("from the cache\n")
    assert (tmp_path / "b.gcode").read_bytes() == (tmp_path / "a.gcode").read_bytes()
    assert not list((tmp_path / "tmp").iterdir())


def test_error_is_printed_in_one_line(box, env, tmp_path):
    result = run_slice(env, box, "-o", tmp_path / "a.gcode", "--set", "layer_height")
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == "farm: --set layer_height: must be KEY=VALUE\n"


@pytest.mark.parametrize(("signal_number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signal_ends_the_engine_and_leaves_no_file(box, env, tmp_path, signal_number, code):
    """Detect the end of the engine with a FIFO, which ends when no process holds it open."""
    os.mkfifo(tmp_path / "fifo")
    engine = tmp_path / "engine"
    lines = ["#!/bin/sh", "[ $1 = help ] && exec CuraEngine help", f"exec 3>{tmp_path / 'fifo'}"]
    engine.write_text("\n".join([*lines, "echo slicing >&3", "exec sleep 1000", ""]))
    engine.chmod(0o755)
    process = subprocess.Popen(
        [str(FARM), "slice", str(box), "-o", str(tmp_path / "out.gcode")],
        env={**env, "FARM_CURA_ENGINE": str(engine)},
        stderr=subprocess.PIPE,
        text=True,
        # A shell that runs the tests in the background ignores SIGINT, and its children inherit this.
        preexec_fn=lambda: signal.signal(signal_number, signal.SIG_DFL),
    )
    with (tmp_path / "fifo").open() as fifo:
        assert fifo.readline() == "slicing\n"
        process.send_signal(signal_number)
        fifo.read()
    _, output = process.communicate()
    assert process.returncode == code
    assert "Traceback" not in output
    assert not list(tmp_path.glob("*.gcode"))
    assert not list((tmp_path / "tmp").iterdir())
