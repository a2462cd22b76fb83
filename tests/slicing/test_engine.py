"""Runs of scripts in place of the engine: failures are reported, and leave no process and no file."""

import os
import select
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from slicing import engine as engine_module
from slicing.engine import MEMORY_BYTES, EngineLimits, check_versions, read_engine_version, run_engine
from slicing.errors import (
    EngineCrashed,
    EngineFailed,
    EngineMissing,
    EngineOutOfMemory,
    EngineTimeout,
    SlicingError,
)


@pytest.fixture
def run_body(tmp_path, write_script, monkeypatch):
    """Return a function that runs a shell script as the engine, which must leave no temporary file."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    stl = tmp_path / "part.stl"
    stl.write_bytes(b"")

    def call(body, *, timeout_s=60.0, memory_bytes=MEMORY_BYTES, progress=None):
        limits = EngineLimits(1, timeout_s, memory_bytes)
        try:
            return run_engine(write_script(body), stl, {"a": "1"}, {}, limits, progress)
        finally:
            assert list(scratch.iterdir()) == []

    return call


@contextmanager
def watch_writers(fifo):
    """Yield a function that returns True when no process holds the writing end of a FIFO."""
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    os.close(os.open(fifo, os.O_WRONLY))  # an engine may be killed before it opens the FIFO
    hang_up_poll = select.poll()
    hang_up_poll.register(reader, 0)
    try:
        yield lambda: bool(hang_up_poll.poll(20_000))
    finally:
        os.close(reader)


def test_output_and_log_are_returned(run_body):
    result = run_body("echo out; echo err >&2; echo G28 > part.gcode; cat global.json; ls")
    assert result.gcode == b"G28\n"
    assert result.log.startswith("out\nerr\n")
    assert '"default_value": "1"' in result.log
    assert "part.stl" in result.log


def test_missing_output_is_an_empty_file(run_body):
    assert run_body("true").gcode == b""


@pytest.mark.parametrize(
    ("body", "error", "message"),
    [
        ("echo '[ERROR] no such luck' >&2; exit 3", EngineFailed, r"exit code 3\): \[ERROR\] no such luck"),
        ("exit 3", EngineFailed, "log is empty"),
        ("kill -SEGV $$", EngineCrashed, r"crashed \(SIGSEGV\).*repair the mesh"),
        ("kill -ABRT $$", EngineCrashed, "SIGABRT"),
        ("kill -KILL $$", EngineOutOfMemory, "runs out of memory"),
        ("echo std::bad_alloc; kill -ABRT $$", EngineOutOfMemory, r"more than 4.0 GB; scale"),
        ("echo '[ERROR] Unknown exception.'; exit 1", EngineOutOfMemory, "failed twice"),
        (
            "echo \"no value given: 'x'\"; echo ERROR no value given; exit 2",
            EngineFailed,
            "FARM_CURA_RESOURCES",
        ),
    ],
)
def test_each_failure_has_its_own_error(run_body, body, error, message):
    with pytest.raises(error, match=message) as error_info:
        run_body(body)
    assert type(error_info.value) is error
    assert isinstance(error_info.value, SlicingError)
    assert "\n" not in str(error_info.value)


def test_engine_that_succeeds_at_the_second_attempt_is_accepted(run_body, tmp_path):
    command = f"[ -e {tmp_path}/tried ] && exec touch part.gcode; touch {tmp_path}/tried"
    assert run_body(f"{command}; echo '[ERROR] Unknown exception.'; exit 1").gcode == b""


def test_hanging_engine_is_killed_with_its_children(run_body, tmp_path):
    fifo = tmp_path / "fifo"
    with watch_writers(fifo) as has_ended:
        with pytest.raises(EngineTimeout, match=r"did not finish within 0\.5 s; scale"):
            run_body(f"sleep 600 > {fifo} & sleep 600 > {fifo}", timeout_s=0.5)
        assert has_ended()


def test_children_left_running_are_killed(run_body, tmp_path):
    fifo = tmp_path / "fifo"
    with watch_writers(fifo) as has_ended:
        assert run_body(f"exec 3> {fifo}; sleep 600 & echo done").log == "done\n"
        assert has_ended()


def test_engine_with_closed_streams_is_awaited(run_body):
    assert run_body("exec >&- 2>&-; echo G28 > part.gcode").gcode == b"G28\n"


def test_long_log_keeps_its_beginning_and_end(run_body):
    log = run_body("echo first; yes 'a long and tedious line of a log' | head -c 20000000; echo last").log
    assert log.startswith("first\n")
    assert log.endswith("last\n")
    assert len(log) <= 5 * 2**20


def test_engine_with_excessive_output_is_stopped(run_body, monkeypatch):
    monkeypatch.setattr(engine_module, "OUTPUT_BYTES", 100_000)
    with pytest.raises(EngineCrashed, match="wrote more than"):
        run_body("exec head -c 10000000 /dev/zero > part.gcode")


def test_engine_with_excessive_memory_is_stopped(run_body):
    memory_command = f"exec {sys.executable} -c 'x = []\nwhile True: x.append(bytearray(1 << 26))'"
    with pytest.raises(EngineFailed, match="MemoryError"):
        run_body(memory_command, memory_bytes=2**29)


def test_real_engine_without_memory_is_reported(engine, tmp_path, make_settings, cube_20):
    stl = tmp_path / "cube.stl"
    cube_20.export(stl)
    settings = make_settings()
    with pytest.raises(EngineOutOfMemory, match=r"0\.3 GB"):
        run_engine(engine, stl, settings.global_, settings.extruder, EngineLimits(1, 60.0, int(0.28 * 2**30)))


def test_progress_is_read_from_the_log(run_body):
    shares = []
    script_text = r"printf 'Progress:inset+skin:1:100 \t0.250000%%\nProgress:export:9:9 \t0.750000%%\n'"
    run_body(f"[ $3 = -p ] || exit 1; {script_text}", progress=shares.append)
    assert shares == [0.75]
    run_body("[ $3 = -m1 ] || exit 1")


def test_engine_dies_with_its_caller(tmp_path, write_script):
    fifo = tmp_path / "fifo"
    engine = write_script(f"exec sleep 600 > {fifo}")
    code = (
        "import sys, pathlib\n"
        "from slicing.engine import EngineLimits, run_engine\n"
        f"limits = EngineLimits(1, 600)\n"
        f"run_engine(pathlib.Path({str(engine)!r}), pathlib.Path('none'), {{}}, {{}}, limits)"
    )
    with watch_writers(fifo) as has_ended:
        root = Path(engine_module.__file__).parents[1]
        environ = {"TMPDIR": str(tmp_path), "PYTHONPATH": str(root), "PATH": os.environ["PATH"]}
        worker = subprocess.Popen([sys.executable, "-c", code], env=environ)
        reader = os.open(fifo, os.O_RDONLY)  # this returns once the engine holds the other end
        os.close(reader)
        worker.send_signal(signal.SIGKILL)
        worker.wait()
        assert has_ended()


@pytest.mark.parametrize(
    ("version", "extruder", "is_valid"),
    [
        ("4.13.0", {"outer_inset_first": "False"}, True),
        ("5.0.0", {"inset_direction": "outside_in"}, True),
        ("4.13.0", {"inset_direction": "outside_in"}, False),
        ("5.0.0", {"outer_inset_first": "False"}, False),
        ("master", {"inset_direction": "outside_in"}, True),
    ],
)
def test_engine_and_settings_files_must_be_of_one_generation(tmp_path, version, extruder, is_valid):
    engine = tmp_path / "engine"
    engine.write_text(f"#!/bin/sh\necho Cura_SteamEngine version {version}\n")
    engine.chmod(0o755)
    if is_valid:
        check_versions(engine, extruder)
        return
    with pytest.raises(EngineMissing, match=f"{version}, but Cura's settings files are of version"):
        check_versions(engine, extruder)


def test_program_without_a_version_is_refused(tmp_path):
    with pytest.raises(EngineMissing, match="set FARM_CURA_ENGINE"):
        read_engine_version(Path("/bin/true"))
    with pytest.raises(EngineMissing, match="set FARM_CURA_ENGINE"):
        read_engine_version(tmp_path / "nothing")
