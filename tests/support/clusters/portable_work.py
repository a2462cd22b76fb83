"""Tasks with files for a cluster, in a module that every process can import."""

import os
import signal
from pathlib import Path

from farm.compute import DeferredFunction, TaskFiles
from farm.errors import FarmError


def list_files(source, folder, *_):
    return TaskFiles(input_files=(source,), output_folders=(folder,), live_files=(folder / "progress.json",))


def _copy(source, folder):
    folder.mkdir(exist_ok=True)
    (folder / "copy.txt").write_bytes(source.read_bytes())
    (folder / "deep").mkdir(exist_ok=True)
    (folder / "deep" / "size.txt").write_text(str(source.stat().st_size))
    return {"copy": folder / "copy.txt", "elsewhere": Path("/elsewhere/file")}


def _fail(source, folder):
    raise FarmError("this model is hollow")


def _allocate(source, folder, gigabytes):
    return len(bytes(int(gigabytes * 2**30)))


def _hold(source, folder, pid_file):
    """Write the process id to a file, and wait until the process is killed."""
    folder.mkdir(exist_ok=True)
    with Path(pid_file).open("a") as file:
        file.write(f"{os.getpid()}\n")
    (folder / "progress.json").write_text("held")  # last, because tests wait for this file
    signal.pause()


def _hold_once(source, folder, pid_file):
    """Wait to be killed in the first call; return the number of the call in later ones."""
    call_number = Path(pid_file).read_text().count("\n") + 1 if Path(pid_file).exists() else 1
    if call_number == 1:
        _hold(source, folder, pid_file)
    return call_number


allocate = DeferredFunction("clusters.portable_work:_allocate", list_files)
copy = DeferredFunction("clusters.portable_work:_copy", list_files)
fail = DeferredFunction("clusters.portable_work:_fail", list_files)
hold = DeferredFunction("clusters.portable_work:_hold", list_files)
hold_once = DeferredFunction("clusters.portable_work:_hold_once", list_files)
