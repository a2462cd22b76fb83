"""Tasks that fail in worker processes, in a module that these can import."""

import os
import signal
import tempfile
from pathlib import Path

from farm.errors import FarmError
from slicing.engine import EngineLimits, run_engine


def die_once(marker):
    """Kill this process in the first call, as the kernel does when memory runs out."""
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def die(signal_number=signal.SIGKILL):
    os.kill(os.getpid(), signal_number)


def raise_error():
    raise FarmError("no such file")


class UnpicklableError(Exception):
    """An exception that pickle cannot restore."""

    def __init__(self, first_text, second_text):
        super().__init__(first_text + second_text)


def raise_unpicklable_error():
    raise UnpicklableError("this cannot ", "travel")


def allocate_memory(gigabytes):
    return len(bytes(int(gigabytes * 2**30)))


def pause():
    signal.pause()


def get_pid():
    return os.getpid()


def read_oom_score():
    """Return the kernel's score for killing this process when memory runs out."""
    return int(Path("/proc/self/oom_score_adj").read_text())


def slice_rod(folder):
    """Slice a rod and return its number of layers."""
    from farm.planning.local.slice_file import (  # imported here because no other task needs it
        SliceOptions,
        slice_to_file,
    )

    options = SliceOptions("ultimaker2_plus", "glue", "generic_pla", 0.4, {"layer_height": "0.2"})
    report = slice_to_file(folder / "rod.stl", folder / "rod.gcode", options)
    return report["layers"]


def prepare_worker(fifo, marker, report):
    """Prepare a worker: the first one reports a step, and waits for data in the FIFO."""
    try:
        marker.mkdir()
    except FileExistsError:
        return
    report("compiling")
    fifo.read_text()


def find_temporary_folder():
    return Path(tempfile.gettempdir())


def write_line(fifo, message):
    """Write a message to a FIFO as soon as a reader opens it; return the message."""
    fifo.write_text(message)
    return message


def run_hanging_engine(folder):
    """Run an engine that never ends and holds a FIFO open, into which it writes its process id."""
    engine = folder / "engine"
    engine.write_text(f"#!/bin/sh\nexec 3>{folder / 'fifo'}\necho $$ >&3\nexec sleep 1000\n")
    engine.chmod(0o755)
    (folder / "part.stl").touch()
    run_engine(engine, folder / "part.stl", {}, {}, EngineLimits(1, 1000.0))
