"""Tasks for worker processes that fail, in a module that they can import."""

import os
import signal
import tempfile
from pathlib import Path

from farm.errors import FarmError
from slicing.engine import EngineLimits, run_engine


def die_once(marker):
    """Die as a process killed for its memory does, the first time."""
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def die(signal_number=signal.SIGKILL):
    os.kill(os.getpid(), signal_number)


def raise_error():
    raise FarmError("no such thing")


class UnpicklableError(Exception):
    """An exception that pickle cannot make again."""

    def __init__(self, first, second):
        super().__init__(first + second)


def raise_unpicklable_error():
    raise UnpicklableError("this cannot ", "travel")


def allocate_memory(gigabytes):
    return len(bytes(int(gigabytes * 2**30)))


def pause():
    signal.pause()


def whoami():
    return os.getpid()


def read_oom_score():
    """Return the kernel's score for killing this process when memory runs out."""
    return int(Path("/proc/self/oom_score_adj").read_text())


def slice_rod(folder):
    """The layers of a rod."""
    from farm.planning.local.slice_file import (  # here: the other work does without it
        SliceOptions,
        slice_to_file,
    )

    options = SliceOptions("ultimaker2_plus", "glue", "generic_pla", 0.4, {"layer_height": "0.2"})
    report = slice_to_file(folder / "rod.stl", folder / "rod.gcode", options)
    return report["layers"]


def start_after(fifo, first, report):
    """Prepare a worker: the first one reports a step, and waits until somebody writes into the FIFO."""
    try:
        first.mkdir()
    except FileExistsError:
        return
    report("compiling")
    fifo.read_text()


def temporary_folder():
    return Path(tempfile.gettempdir())


def speak(fifo, message):
    """Write a line once a reader opens the file."""
    fifo.write_text(message)
    return message


def hang(folder):
    """Run an engine that never ends and holds a FIFO open; what it says first is its process id."""
    engine = folder / "engine"
    engine.write_text(f"#!/bin/sh\nexec 3>{folder / 'fifo'}\necho $$ >&3\nexec sleep 1000\n")
    engine.chmod(0o755)
    (folder / "part.stl").touch()
    run_engine(engine, folder / "part.stl", {}, {}, EngineLimits(1, 1000.0))
