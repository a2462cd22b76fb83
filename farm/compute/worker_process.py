"""Worker process, which runs the calls received through its pipe one after another until it is killed."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import pickle
import resource
import shutil
import signal
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from farm.errors import FarmError

WarmUp = Callable[[Callable[[str], object]], None]
"""Function that prepares a process for its tasks; its argument reports the step, as text."""

_PR_SET_PDEATHSIG = 1
_EXIT_TIMEOUT_S = 2.0  # maximum wall seconds from the closing of the pipe to the exit of the process
_START_NICE, _WORK_NICE = 5, 19
"""Niceness while a process starts, and while it works. With the niceness of its work, a process would take
minutes to start on a busy host."""
_STEP_FILE = "step"


@dataclass(frozen=True, slots=True)
class RaisedError:
    """Exception that a function raised in the process."""

    error: Exception


class Worker:
    """Handle to a process, which runs one call at a time.

    Create it on the daemon's main thread, because the kernel kills the process when the thread that
    started it ends.

    Parameters
    ----------
    scratch
        Folder in which the process gets a folder for its temporary files.
    memory_bytes
        Limit on its data memory (RLIMIT_DATA).
    warm_up
        Function that the process calls first; None if there is none.
    """

    def __init__(self, scratch: Path, memory_bytes: int, warm_up: WarmUp | None) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="worker-", dir=scratch))
        (self.folder / _STEP_FILE).write_text("loading the planning code")
        context = multiprocessing.get_context("spawn")  # the daemon has threads, so a fork could hang
        self._pipe, child_pipe = context.Pipe()
        arguments = (child_pipe, os.getpid(), self.folder, memory_bytes, warm_up)
        self._process = context.Process(target=_serve_calls, args=arguments, daemon=True)
        self._process.start()
        self.pid = self._process.pid or 0
        child_pipe.close()  # otherwise the end of the process would not close the pipe

    @property
    def start_step(self) -> str | None:
        """Current step in starting the process, as text; None once it is ready."""
        try:
            return (self.folder / _STEP_FILE).read_text() or "starting"
        except OSError:
            return None

    def call(self, work: Callable[..., Any], args: tuple[object, ...]) -> Any:
        """Run a function in the process, and wait for it.

        Returns
        -------
        Any
            The result of the function, a `RaisedError`, or a MemoryError.

        Raises
        ------
        EOFError
            If the process ended.
        """
        try:
            self._pipe.send_bytes(pickle.dumps((work, args)))
            return pickle.loads(self._pipe.recv_bytes())
        except OSError as error:
            raise EOFError from error

    def wait_for_exit(self) -> str:
        """Wait for the exit of the process, which has closed its pipe, and return the exit code as text."""
        self._process.join(_EXIT_TIMEOUT_S)
        code = self._process.exitcode
        return signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"

    def end(self) -> None:
        """Kill the process, and with it a CuraEngine that it has started (see `slicing.engine`)."""
        self._process.kill()
        self._process.join()
        # The pipe is closed once the thread that may still read from it has seen the end of file.
        shutil.rmtree(self.folder, ignore_errors=True)


def _serve_calls(
    pipe: Connection, daemon_pid: int, folder: Path, memory_bytes: int, warm_up: WarmUp | None
) -> None:
    """Serve calls one after another, as the main function of the process."""
    _prepare_process(daemon_pid, folder, memory_bytes)
    if warm_up is not None:
        try:
            warm_up((folder / _STEP_FILE).write_text)
        except Exception:
            traceback.print_exc()  # a task that needs what could not be loaded fails with a message
    os.nice(_WORK_NICE - _START_NICE)
    (folder / _STEP_FILE).unlink(missing_ok=True)
    while True:
        try:
            request = pipe.recv_bytes()
        except EOFError:
            return
        pipe.send_bytes(_run_call(request))


def _run_call(request: bytes) -> bytes:
    try:
        work, args = pickle.loads(request)
        return pickle.dumps(work(*args))
    except MemoryError:
        return pickle.dumps(MemoryError())
    except SystemExit as error:
        return pickle.dumps(RaisedError(FarmError(f"a library ended the task: {error}")))
    except Exception as error:
        # the daemon's log shows the traceback of this process
        error.add_note("".join(traceback.format_exception(error)))
        try:
            answer = pickle.dumps(RaisedError(error))
            pickle.loads(answer)
        except Exception:  # not every exception can be pickled
            answer = pickle.dumps(RaisedError(FarmError(f"{type(error).__name__}: {error}")))
        return answer


def _prepare_process(daemon_pid: int, folder: Path, memory_bytes: int) -> None:
    """Lower the priority, limit memory, set the temporary folder, and tie the process to the daemon.

    The kernel kills the process when the daemon's thread that started it ends.
    """
    os.nice(_START_NICE)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != daemon_pid:
        os._exit(1)  # the daemon died before prctl took effect
    with contextlib.suppress(OSError):  # if memory runs out, the kernel ends this process, not the daemon
        Path("/proc/self/oom_score_adj").write_text("800")
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
    # Set only the soft limit: slicing.engine raises it for CuraEngine, which has a limit of its own.
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    soft = memory_bytes if hard == resource.RLIM_INFINITY else min(memory_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
