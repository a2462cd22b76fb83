"""The worker processes for decomposition and slicing: polite, bounded, and never outliving the daemon.

Each piece of work has a process to itself. It is ended (a person cancels its job, its time is over) by ending
that process, which a new one replaces; and a process that dies takes no other work with it.
"""

from __future__ import annotations

import asyncio
import ctypes
import logging
import multiprocessing
import os
import pickle
import resource
import shutil
import signal
import tempfile
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from farm.errors import ErrorCode, FarmError

log = logging.getLogger(__name__)

T = TypeVar("T")
Warm = Callable[[], None]

_PR_SET_PDEATHSIG = 1
_TRIES = 2
_GB = 2**30


@dataclass(frozen=True, slots=True)
class Limit:
    """How long a piece of work may take, in wall seconds from when a worker has it."""

    what: str
    seconds: float


CHECKING = Limit("reading and checking the model", 600.0)  # as long as the CLI waits for it
DECOMPOSING = Limit("decomposing", 1800.0)
SLICING = Limit("slicing a part", 2400.0)  # CuraEngine's own limit (slicing.plate) and what is around it


def memory_for_each(count: int, memory_gb: float | None) -> int:
    """What a worker may use, in bytes: a share of the machine, but enough for one large model.

    Parameters
    ----------
    count
        How many workers there are.
    memory_gb
        What a person gives each; None for the default.
    """
    if memory_gb is not None:
        return int(memory_gb * _GB)
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return int(max(0.8 * machine / count, min(4 * _GB, machine / 2)))


class Workers:
    """As many processes as cores. All methods are called on the event loop's thread.

    Parameters
    ----------
    scratch
        A folder of the pool's own: each worker has its temporary files in a folder there, which goes with it.
    count
        How many; as many as cores by default.
    memory_gb
        What each may use; see `memory_for_each`.
    warm
        What every worker does first: import what it will need, before somebody waits for it.
    """

    def __init__(
        self,
        scratch: Path,
        count: int | None = None,
        memory_gb: float | None = None,
        warm: Warm | None = None,
    ) -> None:
        count = count or len(os.sched_getaffinity(0))
        self._scratch = scratch
        self._memory = memory_for_each(count, memory_gb)
        self._warm = warm
        self._closed = False
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="worker")
        self._alive: set[_Worker] = set()
        self._idle: asyncio.Queue[_Worker] = asyncio.Queue()
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir(parents=True)
        for _ in range(count):
            self._start()

    @property
    def pids(self) -> frozenset[int]:
        """The processes that there are now."""
        return frozenset(worker.pid for worker in self._alive)

    async def run(self, work: Callable[..., T], *args: object, limit: Limit = CHECKING) -> T:
        """Run a function, which may be run more than once, in a worker; cancelled, the worker is ended.

        Raises
        ------
        FarmError
            What the work raised, or `limit` where its time or its memory did not suffice, or that its workers
            died.
        """
        ended = ""
        for _ in range(_TRIES):
            worker = await self._idle.get()
            fit = False
            try:
                async with asyncio.timeout(limit.seconds):
                    loop = asyncio.get_running_loop()
                    answer = await loop.run_in_executor(self._threads, worker.call, work, args)
                fit = not isinstance(answer, MemoryError)
            except TimeoutError:
                raise FarmError(
                    f"{limit.what} did not end within {limit.seconds / 60:g} min: scale the model down or "
                    "simplify its mesh",
                    ErrorCode.LIMIT,
                ) from None
            except EOFError:
                if self._closed:
                    raise FarmError(f"{limit.what} was given up: the daemon ends") from None
                ended = worker.wait()
                log.warning("worker %d ended by itself (%s)", worker.pid, ended)
                continue
            finally:
                self._release(worker, fit)
            if isinstance(answer, MemoryError):
                raise FarmError(
                    f"not enough memory for {limit.what} (a worker may use {self._memory / _GB:.1f} GB): "
                    "scale the model down, simplify its mesh, or raise `memory_gb` in fleet.yaml",
                    ErrorCode.LIMIT,
                )
            if isinstance(answer, _Raised):
                raise answer.error
            return answer  # type: ignore[no-any-return]
        raise FarmError(
            f"{limit.what} ended its worker process {_TRIES} times ({ended}): most often too little memory; "
            "scale the model down or simplify its mesh"
        )

    def close(self) -> None:
        """Give up whatever is being worked on; no process is left when this returns."""
        self._closed = True
        for worker in self._alive:
            worker.end()
        self._alive.clear()
        self._threads.shutdown(wait=False, cancel_futures=True)
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _start(self) -> None:
        worker = _Worker(self._scratch, self._memory, self._warm)
        self._alive.add(worker)
        self._idle.put_nowait(worker)

    def _release(self, worker: _Worker, fit: bool) -> None:
        """Give back a worker that is fit for more work, else put a new one in its place."""
        if self._closed:
            return
        if fit:
            self._idle.put_nowait(worker)
            return
        worker.end()
        self._alive.discard(worker)
        self._start()
        # An engine that dies with its worker may have written after the folder was removed: all at once.
        kept = {one.folder for one in self._alive}
        for left in self._scratch.iterdir():
            if left not in kept:
                shutil.rmtree(left, ignore_errors=True)


@dataclass(frozen=True, slots=True)
class _Raised:
    error: Exception


class _Worker:
    """One process, which does one thing at a time. It has to be started on the daemon's main thread: the
    kernel ends it when the thread that started it ends."""

    def __init__(self, scratch: Path, memory_bytes: int, warm: Warm | None) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="worker-", dir=scratch))
        context = multiprocessing.get_context("spawn")  # the daemon has threads: a fork could hang
        self._pipe, theirs = context.Pipe()
        arguments = (theirs, os.getpid(), self.folder, memory_bytes, warm)
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        self.pid = self._process.pid or 0
        theirs.close()  # so that its end is seen

    def call(self, work: Callable[..., Any], args: tuple[object, ...]) -> Any:
        """What the work returned, `_Raised`, or a MemoryError; blocks. EOFError where the process ends."""
        try:
            self._pipe.send_bytes(pickle.dumps((work, args)))
            return pickle.loads(self._pipe.recv_bytes())
        except OSError as error:
            raise EOFError from error

    def wait(self) -> str:
        """How the process, which has closed its pipe, ended."""
        self._process.join()
        code = self._process.exitcode or 0
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"

    def end(self) -> None:
        """End the process now, and with it (see slicing.engine) the engine that it runs."""
        self._process.kill()
        self._process.join()
        # The pipe closes when the thread that may still read from it has seen its end.
        shutil.rmtree(self.folder, ignore_errors=True)


def _serve(pipe: Connection, daemon: int, folder: Path, memory_bytes: int, warm: Warm | None) -> None:
    """What a worker process does: answer one call after another."""
    _prepare(daemon, folder, memory_bytes)
    if warm is not None:
        try:
            warm()
        except Exception:
            traceback.print_exc()  # whoever needs it will meet it again, and be told
    while True:
        try:
            request = pipe.recv_bytes()
        except EOFError:
            return
        pipe.send_bytes(_answer(request))


def _answer(request: bytes) -> bytes:
    try:
        work, args = pickle.loads(request)
        return pickle.dumps(work(*args))
    except MemoryError:
        return pickle.dumps(MemoryError())
    except SystemExit as error:
        return pickle.dumps(_Raised(FarmError(f"a library ended the work: {error}")))
    except Exception as error:
        error.add_note("".join(traceback.format_exception(error)))  # of this process, for the daemon's log
        try:
            answer = pickle.dumps(_Raised(error))
            pickle.loads(answer)
        except Exception:  # not every exception can travel
            answer = pickle.dumps(_Raised(FarmError(f"{type(error).__name__}: {error}")))
        return answer


def _prepare(daemon: int, folder: Path, memory_bytes: int) -> None:
    """Run politely, within the limit, with temporary files of its own, and die with the daemon (Linux)."""
    os.nice(19)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != daemon:
        os._exit(1)  # it died before the kernel was asked
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
    # The soft limit alone: CuraEngine has one of its own kind (slicing.engine), and asks for it.
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    soft = memory_bytes if hard == resource.RLIM_INFINITY else min(memory_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
