"""The one place that calls CuraEngine."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

from slicing.errors import EngineFailed, EngineMissing, EngineTimeout

MEMORY_BYTES = 4 * 2**30
"""What a run may use beside its threads' stacks; a part that fills a bed needs about 0.4 GB."""
LAYER_BYTES = 10 * 2**20
"""Address space that it reserves for each layer (8.7 MiB measured, a stack; next to none of it is used)."""
_LOG_BYTES = 2 * 2**20
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True, slots=True)
class EngineRun:
    """What CuraEngine wrote: the G-code, and its log (both output streams)."""

    gcode: str
    log: str


def run_engine(
    engine: Path,
    stl: Path,
    global_: Mapping[str, str],
    extruder: Mapping[str, str],
    *,
    layers: int,
    timeout_s: float,
) -> EngineRun:
    """Slice an STL with settings that are resolved.

    The settings go as flat JSON files whose values are strings: the engine cuts JSON numbers to six digits.
    The extruder's come after ``-e0``, and all before ``-l``: elsewhere the engine ignores them in silence.

    Parameters
    ----------
    layers
        How many there will be at most; the memory limit depends on it.
    timeout_s
        Wall seconds before the run is stopped, with all of its processes.

    Raises
    ------
    EngineMissing
        Where the program cannot be started.
    EngineFailed, EngineTimeout
        Where it ends with an error, or does not end.
    """
    with tempfile.TemporaryDirectory(prefix="farm-engine-") as name:
        # It runs in its own folder with short names, for the paths that it writes into the G-code.
        folder = Path(name)
        (folder / "part.stl").symlink_to(stl.resolve())
        for scope, values in (("global", global_), ("extruder", extruder)):
            settings = {"settings": {key: {"default_value": value} for key, value in values.items()}}
            (folder / f"{scope}.json").write_text(json.dumps(settings), encoding="utf-8")
        arguments = ["slice", "-v", "-m1", "-j", "global.json", "-e0", "-j", "extruder.json"]
        arguments += ["-o", "part.gcode", "-l", "part.stl"]
        log = _call(engine, arguments, folder, MEMORY_BYTES + layers * LAYER_BYTES, timeout_s)
        written = folder / "part.gcode"
        return EngineRun(written.read_text(encoding="utf-8") if written.is_file() else "", log)


def _call(engine: Path, arguments: list[str], folder: Path, memory_bytes: int, timeout_s: float) -> str:
    with (folder / "log").open("w+b") as sink:
        try:
            process = subprocess.Popen(
                [str(engine), *arguments],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=partial(_restrain, memory_bytes),
            )
        except OSError as error:
            raise EngineMissing(
                f"{engine} cannot be started: {error.strerror}; set FARM_CURA_ENGINE"
            ) from error
        try:
            code = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise EngineTimeout(
                f"CuraEngine did not finish within {timeout_s:g} s; scale the model down or simplify its mesh"
            ) from None
        finally:
            if process.returncode is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        sink.seek(0)
        log = sink.read(_LOG_BYTES).decode("utf-8", errors="replace")
    if code != 0:
        ended = f"exit code {code}" if code > 0 else f"signal {signal.Signals(-code).name}"
        said = [line for line in log.splitlines() if "ERROR" in line or "xception" in line]
        raise EngineFailed(
            f"CuraEngine failed ({ended}): {(said or log.splitlines() or ['no output'])[-1].strip()}"
        )
    return log


def _restrain(memory_bytes: int) -> None:
    """In the child: last in line for the processor, bounded memory, and never outliving who asked."""
    os.nice(19)
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    # Who asked may have a limit of its own, in which the stacks would count in full.
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


@lru_cache(maxsize=4)
def engine_version(engine: Path) -> str:
    """What the program calls itself, like ``Cura_SteamEngine version 4.13.0``; raises EngineMissing."""
    try:
        shown = subprocess.run([str(engine), "help"], capture_output=True, text=True, timeout=30, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise EngineMissing(f"{engine} cannot be run: {error}; set FARM_CURA_ENGINE") from error
    lines = [line.strip() for line in (shown.stdout + shown.stderr).splitlines()]
    named = next((line for line in lines if "version" in line), None)
    if named is None:
        raise EngineMissing(f"{engine} does not say its version: not CuraEngine; set FARM_CURA_ENGINE")
    return named
