"""The daemon's end of an agent's socket, and the starting of agents."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO

from pydantic import ValidationError

import drivers
from drivers.clock import Clock
from drivers.errors import AgentError, AgentTooOld, MessageError
from drivers.locks import AGENT_LOCK, held, holder, kill_holder
from drivers.messages import PROTOCOL, Reply, Request, Snapshot, for_protocol, from_agent_adapter
from drivers.records import StartFile

SOCKET = "agent.sock"
LOG = "agent.log"
UNIT = "FARM_AGENT_UNIT"
RETRY_S = 0.25
FIRST_WORD_S = 45.0  # over ssh, to an agent that may have to be started
_LINE_BYTES = 1024 * 1024


class AgentClient:
    """A connection to one agent.

    `connect` it, then iterate over `snapshots` in one task and call `request` from any; when the iterator
    ends the connection is gone, and `connect` starts another.

    Parameters
    ----------
    folder
        The agent's folder; where the agent is on another host, only the log of the way there is in it.
    over
        The way to another host: words that start a program which carries bytes, and what it is told first.
    heard
        Called at every line of the agent's, also at one of another version that cannot be read: it lives.
    """

    def __init__(
        self,
        folder: Path,
        over: tuple[Sequence[str], bytes] | None = None,
        heard: Callable[[], None] = lambda: None,
    ) -> None:
        self._heard = heard
        self._folder = folder
        self._over = over
        self._carrier: asyncio.subprocess.Process | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None
        self._waiting: dict[int, asyncio.Future[Reply]] = {}
        self._snapshots: asyncio.Queue[Snapshot | None] = asyncio.Queue()
        self._ids = count(1)
        self._protocol = PROTOCOL  # until the agent has said its own, first of all

    @property
    def connected(self) -> bool:
        """Whether requests can be sent."""
        return self._reading is not None and not self._reading.done()

    async def connect(self, timeout_s: float = 10.0) -> None:
        """Connect, and wait for an agent that is just starting.

        Raises
        ------
        AgentError
            Nobody listened in `timeout_s` wall seconds.
        """
        await self.close()
        if self._over is not None:
            await self._connect_over(*self._over)
            return
        loop = asyncio.get_running_loop()
        until_s = loop.time() + timeout_s
        while True:
            try:
                reader, self._writer = await self._open()
                break
            except OSError as error:
                if loop.time() + RETRY_S > until_s:
                    raise AgentError(f"{self._folder}: no agent answers ({error}); is it running?") from error
                await asyncio.sleep(RETRY_S)
        self._listen(reader)

    async def _connect_over(self, words: Sequence[str], errand: bytes) -> None:
        """Start the program that carries bytes; the first word of the agent says that all of it stands."""
        self._folder.mkdir(parents=True, exist_ok=True)
        try:
            with (self._folder / LOG).open("ab") as log:
                self._carrier = await asyncio.create_subprocess_exec(
                    *words,
                    stdin=asyncio.subprocess.PIPE,
                    stdout=asyncio.subprocess.PIPE,
                    stderr=log,
                    limit=_LINE_BYTES,
                    start_new_session=True,
                )
            reader, self._writer = self._carrier.stdout, self._carrier.stdin
            assert reader is not None and self._writer is not None
            self._writer.write(errand)
            first = await asyncio.wait_for(reader.readline(), FIRST_WORD_S)
        except (OSError, ValueError, TimeoutError) as error:
            raise AgentError(f"{words[0]}: no way to the agent ({error or 'time-out'})") from error
        if not first:
            raise AgentError(f"no way to the agent: {_last_line(self._folder / LOG)}")
        self._listen(reader)
        with suppress(MessageError):
            said = read_line(first)
            if isinstance(said, Snapshot):
                self._protocol = said.protocol
                self._snapshots.put_nowait(said)

    def _listen(self, reader: asyncio.StreamReader) -> None:
        self._snapshots = asyncio.Queue()
        self._reading = asyncio.create_task(self._read(reader, self._snapshots))

    async def snapshots(self) -> AsyncIterator[Snapshot]:
        """Yield what the agent pushes, until the connection is gone."""
        queue = self._snapshots
        while (snapshot := await queue.get()) is not None:
            yield snapshot

    async def request(self, request: Request, timeout_s: float = 30.0) -> Reply:
        """Send one request, and wait for its reply. Its `id` is given here, whatever it was.

        Raises
        ------
        AgentError
            There is no connection, it broke, or no reply came in time. The agent may have obeyed: requests
            are idempotent, send it again. A refusal is no error: see `Reply.error`.
        AgentTooOld
            The agent is of an older version that does not know this request; nothing was sent.
        """
        if self._writer is None or not self.connected:
            raise AgentError(f"{self._folder}: no agent is connected")
        number = next(self._ids)
        line = for_protocol(request.model_copy(update={"id": number}), self._protocol)
        if line is None:
            raise AgentTooOld(f"{self._folder}: an agent of an older version does not know {request.do}")
        reply: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._waiting[number] = reply
        try:
            async with asyncio.timeout(timeout_s):
                self._writer.write(line.encode() + b"\n")
                await self._writer.drain()
                return await reply
        except (OSError, TimeoutError) as error:
            raise AgentError(f"{self._folder}: no reply to {request.do} ({error or 'time-out'})") from error
        finally:
            self._waiting.pop(number, None)

    async def close(self) -> None:
        """Leave; the agent goes on."""
        if self._writer is not None:
            self._writer.close()
            with suppress(OSError):
                await self._writer.wait_closed()
            self._writer = None
        if self._carrier is not None:
            with suppress(ProcessLookupError):
                self._carrier.kill()  # what it carries to is in a session of its own
            await self._carrier.wait()
            self._carrier = None
        if self._reading is not None:
            await self._reading
            self._reading = None

    async def _open(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        # A socket's path is limited to 107 bytes, and a state folder's is not.
        descriptor = os.open(self._folder, os.O_PATH | os.O_DIRECTORY)
        try:
            path = f"/proc/self/fd/{descriptor}/{SOCKET}"
            return await asyncio.open_unix_connection(path, limit=_LINE_BYTES)
        finally:
            os.close(descriptor)

    async def _read(self, reader: asyncio.StreamReader, queue: asyncio.Queue[Snapshot | None]) -> None:
        reason = "the connection to the agent is gone"
        try:
            while line := await reader.readline():
                self._heard()
                said = read_line(line)
                if isinstance(said, Snapshot):
                    self._protocol = said.protocol
                    queue.put_nowait(said)
                    continue
                waiting = self._waiting.get(said.id)
                if waiting is not None and not waiting.done():
                    waiting.set_result(said)
        except (OSError, ValueError, MessageError) as error:
            reason = str(error)
        finally:
            queue.put_nowait(None)
            for waiting in self._waiting.values():
                if not waiting.done():
                    waiting.set_exception(AgentError(f"{self._folder}: {reason}"))


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines() if log.exists() else []
    return lines[-1] if lines else "it said nothing"


def read_line(line: bytes) -> Snapshot | Reply:
    """Read one line of an agent. Raises MessageError where that is no message."""
    try:
        return from_agent_adapter.validate_json(line)
    except ValidationError as error:
        raise MessageError(f"an agent said what is no message: {error.errors()[0]['msg']}") from error


def spawn(
    printer: str, model: str, port: str, folder: Path, clock: Clock, power_off_cmd: str | None = None
) -> subprocess.Popen[bytes]:
    """Start an agent in a session of its own: it outlives whoever started it.

    Where the environment names a unit of systemd's (`FARM_AGENT_UNIT`, with %i for the printer), that is
    started instead, and what is returned ends when systemd has done so.

    Parameters
    ----------
    printer, model, port, power_off_cmd
        As `fleet.yaml` has them.
    folder
        The agent's folder, made if missing; its log goes to `agent.log` there.
    clock
        The farm's clock.

    Returns
    -------
    subprocess.Popen
        To be polled now and then, so that its end leaves no zombie.

    Raises
    ------
    AgentError
        The process cannot be started.
    """
    start = StartFile(printer, model, port, clock.scale, clock.anchor_s, power_off_cmd)
    unit = os.environ.get(UNIT)
    words = [sys.executable, "-m", "drivers.agent", "--folder", str(folder.absolute())]
    if unit:
        words = ["systemctl", "start", unit.replace("%i", printer)]
    try:
        start.write(folder)
        with _log(folder) as log:
            return subprocess.Popen(
                words,
                cwd=Path(drivers.__file__).parents[1],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
    except OSError as error:
        raise AgentError(f"{printer}: its agent does not start ({error}); see {folder / LOG}") from error


def _log(folder: Path) -> BinaryIO:
    """Open an agent's log; none where the disk takes nothing: it may have to end the last one's heat."""
    try:
        return (folder / LOG).open("ab")
    except OSError:
        return Path(os.devnull).open("ab")


def as_units() -> bool:
    """Whether agents are started as units of systemd's."""
    return bool(os.environ.get(UNIT))


def alive(folder: Path) -> bool:
    """Whether an agent of this folder lives: whether its lock is held."""
    return held(folder / AGENT_LOCK)


def kill(folder: Path) -> bool:
    """Kill the agent of this folder, which cannot be told any more; True where none lives then."""
    return kill_holder(folder / AGENT_LOCK)


def pid(folder: Path) -> int | None:
    """The process of the agent of this folder; None where none lives."""
    return holder(folder / AGENT_LOCK)
