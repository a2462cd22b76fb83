"""CuraEngine as a process with limits on time, memory and output.

A run that is killed with its worker leaves its folder ``farm-engine-*`` in the temporary folder. The process
that ends the worker removes it (the daemon gives each worker its own temporary folder).
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import resource
import selectors
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

from slicing.errors import EngineCrashed, EngineFailed, EngineMissing, EngineOutOfMemory, EngineTimeout

MEMORY_BYTES = 4 * 2**30
"""Memory of a run besides its threads' stacks; a part that fills a bed needs about 0.4 GB."""
LAYER_BYTES = 10 * 2**20
"""Address space that CuraEngine reserves for each layer: a stack, 8.7 MiB measured, nearly all unused."""
OUTPUT_BYTES = 2 * 2**30
"""Maximum size of a file that CuraEngine may write; a part that fills a bed has 0.07 GB of G-code."""
_LOG_BYTES = 2**20
"""Number of bytes to keep of the beginning, and of the end, of a long log."""
_PR_SET_PDEATHSIG = 1
_UNKNOWN_ERROR = "Unknown exception"
_PROGRESS = re.compile(rb"Progress:[^:\n]+:\d+:\d+ *\t([\d.]+)%")
_ADVICE = "scale the model down or simplify its mesh"
_libc = ctypes.CDLL(None, use_errno=True)

ProgressCallback = Callable[[float], None]
"""Callback for the completed share of the work, 0 to 1."""


@dataclass(frozen=True, slots=True)
class EngineLimits:
    """Limits of one run.

    Attributes
    ----------
    max_layers
        Maximum number of layers; each takes `LAYER_BYTES` of address space.
    timeout_s
        Wall-clock seconds after which the run is stopped, with all of its processes.
    memory_bytes
        Memory besides the memory of the layers.
    """

    max_layers: int
    timeout_s: float
    memory_bytes: int = MEMORY_BYTES

    @property
    def address_space_bytes(self) -> int:
        """Limit on the address space of the process."""
        return self.memory_bytes + self.max_layers * LAYER_BYTES


@dataclass(frozen=True, slots=True)
class EngineOutput:
    """Output of CuraEngine: the G-code, and its log (both output streams)."""

    gcode: bytes
    log: str


def run_engine(
    engine: Path,
    stl: Path,
    global_: Mapping[str, str],
    extruder: Mapping[str, str],
    limits: EngineLimits,
    progress: ProgressCallback | None = None,
) -> EngineOutput:
    """Slice an STL with resolved settings.

    Parameters
    ----------
    engine
        The program.
    stl
        Binary STL in its printing pose.
    global_, extruder
        Every setting of both scopes, as text.
    limits
        Limits on time and memory.
    progress
        Function that is called from time to time with the completed share of the work, 0 to 1.

    Raises
    ------
    EngineMissing
        If the program cannot be started.
    EngineTimeout, EngineOutOfMemory, EngineCrashed, EngineFailed
        If it does not end, or ends with an error.
    """
    with tempfile.TemporaryDirectory(prefix="farm-engine-") as name:
        # The engine writes the paths of its arguments into the G-code, so it runs in its own folder with
        # short names.
        folder = Path(name)
        (folder / "part.stl").symlink_to(stl.resolve())
        _write_settings(folder / "global.json", global_)
        _write_settings(folder / "extruder.json", extruder)
        command = _build_command(engine, reports_progress=progress is not None)
        exit_code, log = _run_process(command, folder, limits, progress)
        # This error was seen on a machine under load, where a second run succeeded.
        if exit_code > 0 and _UNKNOWN_ERROR in log:
            exit_code, log = _run_process(command, folder, limits, progress)
        if exit_code != 0:
            raise _build_engine_error(exit_code, log, limits.memory_bytes)
        gcode = folder / "part.gcode"
        return EngineOutput(gcode.read_bytes() if gcode.is_file() else b"", log)


def _write_settings(path: Path, values: Mapping[str, str]) -> None:
    """Write a flat JSON file with text values, because the engine truncates JSON numbers to six digits."""
    settings = {"settings": {key: {"default_value": value} for key, value in values.items()}}
    path.write_text(json.dumps(settings), encoding="utf-8")


def _build_command(engine: Path, *, reports_progress: bool) -> list[str]:
    """Build the command that slices the files of a folder.

    Settings of the extruder come after ``-e0``, and all settings before ``-l``, because the engine ignores
    them elsewhere.
    """
    options = ["-v", *(["-p"] if reports_progress else []), "-m1"]
    arguments = ["slice", *options, "-j", "global.json", "-e0", "-j", "extruder.json"]
    return [str(engine), *arguments, "-o", "part.gcode", "-l", "part.stl"]


def _run_process(
    command: list[str], folder: Path, limits: EngineLimits, progress: ProgressCallback | None
) -> tuple[int, str]:
    """Run a command until it ends; return its exit code and its log."""
    try:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,
            start_new_session=True,
            preexec_fn=partial(_limit_child, limits.address_space_bytes, os.getpid()),
        )
    except OSError as error:
        raise EngineMissing(
            f"{command[0]} cannot be started: {error.strerror}; set FARM_CURA_ENGINE"
        ) from error
    try:
        log = _read_log(process, limits.timeout_s, progress)
    finally:
        # The process is not reaped yet, so its group id cannot have been reused; its children are killed too.
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        assert process.stdout is not None
        process.stdout.close()
    return process.returncode, log


def _read_log(process: subprocess.Popen[bytes], timeout_s: float, progress: ProgressCallback | None) -> str:
    """Read the log of a process until it ends; only the beginning and the end of a long log are kept."""
    assert process.stdout is not None
    pipe, exit_fd = process.stdout.fileno(), os.pidfd_open(process.pid)
    os.set_blocking(pipe, False)
    deadline_s = time.monotonic() + timeout_s
    log = bytearray()
    with selectors.DefaultSelector() as selector:
        selector.register(exit_fd, selectors.EVENT_READ)
        selector.register(pipe, selectors.EVENT_READ)
        try:
            is_running = True
            while is_running:
                ready = [key.fd for key, _ in selector.select(max(0.0, deadline_s - time.monotonic()))]
                # The pipe holds the rest of the log of a process that has ended.
                is_running = exit_fd not in ready
                if is_running and time.monotonic() >= deadline_s:
                    raise EngineTimeout(f"CuraEngine did not finish within {timeout_s:g} s; {_ADVICE}")
                message = _read_pipe(pipe)
                if message == b"" and pipe in ready:
                    selector.unregister(pipe)  # the process has closed its streams, but is still running
                log += message
                if len(log) > 4 * _LOG_BYTES:
                    del log[_LOG_BYTES:-_LOG_BYTES]
                if progress is not None and (shares := _PROGRESS.findall(message)):
                    progress(min(1.0, float(shares[-1])))
        finally:
            os.close(exit_fd)
    return log.decode("utf-8", errors="replace")


def _read_pipe(pipe: int) -> bytes:
    """Read at most 64 KiB from a pipe; return no bytes if it is empty or closed."""
    try:
        return os.read(pipe, 1 << 16)
    except BlockingIOError:
        return b""


def _build_engine_error(exit_code: int, log: str, memory_bytes: int) -> EngineFailed:
    """Build the error for an exit code and a log; a signal is a negative code."""
    lines = log.splitlines()
    message = next((line.strip() for line in reversed(lines) if "ERROR" in line or "xception" in line), None)
    message = message or (lines[-1].strip() if lines else "its log is empty")
    name = "" if exit_code > 0 else signal.Signals(-exit_code).name
    if "bad_alloc" in log or "memory exhausted" in log:
        return EngineOutOfMemory(f"CuraEngine needs more than {memory_bytes / 2**30:.1f} GB; {_ADVICE}")
    if exit_code == -signal.SIGKILL:
        return EngineOutOfMemory(
            f"CuraEngine was killed ({name}), which happens when a computer runs out of memory; "
            "slice with fewer workers at a time"
        )
    if exit_code == -signal.SIGXFSZ:
        return EngineCrashed(f"CuraEngine wrote more than {OUTPUT_BYTES / 2**30:.0f} GB; {_ADVICE}")
    if exit_code < 0:
        return EngineCrashed(f"CuraEngine crashed ({name}): {message}; repair the mesh, or {_ADVICE}")
    if _UNKNOWN_ERROR in message:
        return EngineOutOfMemory(
            f"CuraEngine failed twice ({message}), which happens if {memory_bytes / 2**30:.1f} GB of memory "
            f"are not enough, or with a model many metres long; {_ADVICE}"
        )
    if "no value given" in message:
        message += "; it needs the settings files of its own version: set FARM_CURA_RESOURCES"
    return EngineFailed(f"CuraEngine failed (exit code {exit_code}): {message}")


def _limit_child(memory_bytes: int, parent_pid: int) -> None:
    """Limit the child process: lowest priority, limited memory and output, killed if its parent ends."""
    os.nice(19)
    # The parent may have its own limit, against which the stacks of threads would count in full.
    data_limit = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (data_limit, data_limit))
    for limit, maximum in (
        (resource.RLIMIT_AS, memory_bytes),
        (resource.RLIMIT_FSIZE, OUTPUT_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        hard_limit = resource.getrlimit(limit)[1]
        maximum = maximum if hard_limit == resource.RLIM_INFINITY else min(maximum, hard_limit)
        resource.setrlimit(limit, (maximum, maximum))
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:  # the parent ended before the signal was set up
        os._exit(1)


@lru_cache(maxsize=4)
def read_engine_version(engine: Path) -> str:
    """Read the program's version, such as ``Cura_SteamEngine version 4.13.0``.

    Raises
    ------
    EngineMissing
        If the program cannot be run, or does not print a version.
    """
    try:
        output = subprocess.run(
            [str(engine), "help"], capture_output=True, text=True, timeout=30, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise EngineMissing(f"{engine} cannot be run: {error}; set FARM_CURA_ENGINE") from error
    lines = [line.strip() for line in (output.stdout + output.stderr).splitlines()]
    version_line = next((line for line in lines if "version" in line), None)
    if version_line is None:
        raise EngineMissing(
            f"{engine} does not print its version, so it is not CuraEngine; set FARM_CURA_ENGINE"
        )
    return version_line


def check_versions(engine: Path, extruder: Mapping[str, str]) -> None:
    """Raise EngineMissing if Cura's settings files and the engine are not of the same generation.

    Cura 5 draws walls of variable width: it has ``inset_direction`` where Cura 4 has ``outer_inset_first``.
    """
    version = read_engine_version(engine)
    match = re.search(r"version (\d+)\.", version)
    if match is None:  # a build without a version number
        return
    files_version = 5 if "inset_direction" in extruder else 4
    if (int(match[1]) >= 5) != (files_version >= 5):
        raise EngineMissing(
            f"{engine} is {version}, but Cura's settings files are of version {files_version}: "
            "set FARM_CURA_ENGINE and FARM_CURA_RESOURCES to the same version"
        )
