"""Client of an agent's socket, on this host or over ssh."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path

from pydantic import ValidationError

from drivers.errors import AgentError, AgentTooOld, MessageError
from drivers.log_file import rotate_log
from drivers.messages import (
    AGENT_SOCKET,
    PROTOCOL,
    Reply,
    Request,
    Snapshot,
    encode_for_protocol,
    from_agent_adapter,
)
from drivers.records import AGENT_LOG
from drivers.remote.process import RETRY_INTERVAL_S

Route = tuple[Sequence[str], bytes]
"""Connection to another host: a command that copies bytes (`build_ssh_command`), and its first input line."""
StreamOpener = Callable[[], Awaitable[tuple[asyncio.StreamReader, asyncio.StreamWriter]]]
"""Function that opens a stream to the agent on a connection that carries several. Raises AgentError."""
FIRST_MESSAGE_TIMEOUT_S = 45.0  # over ssh; the agent may have to be started first
_LINE_BYTES = 1024 * 1024


class AgentClient:
    """Connection to one agent.

    Call `connect`, then iterate over `receive_snapshots` in one task and call `request` from any task. When
    the iterator ends, the connection is closed, and `connect` opens a new one.

    Parameters
    ----------
    folder
        The agent's folder; for an agent on another host it only contains the log of ssh.
    route
        Connection to another host; None for an agent on this host.
    on_message
        Function that is called for every line from the agent. Even an unreadable line shows that the agent is
        alive.
    """

    def __init__(
        self,
        folder: Path,
        route: Route | StreamOpener | None = None,
        on_message: Callable[[], None] = lambda: None,
    ) -> None:
        self._on_message = on_message
        self._folder = folder
        self._route = route
        self._route_process: asyncio.subprocess.Process | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._read_task: asyncio.Task[None] | None = None
        self._pending_replies: dict[int, asyncio.Future[Reply]] = {}
        self._snapshots: asyncio.Queue[Snapshot | None] = asyncio.Queue()
        self._ids = count(1)
        self._protocol = PROTOCOL  # until the first snapshot has the agent's version

    @property
    def is_connected(self) -> bool:
        """True while requests can be sent."""
        return self._read_task is not None and not self._read_task.done()

    async def connect(self, timeout_s: float = 10.0) -> None:
        """Connect, waiting for an agent that is just starting.

        Parameters
        ----------
        timeout_s
            Wall seconds to wait.

        Raises
        ------
        AgentError
            No agent listened in time.
        """
        await self.close()
        if callable(self._route):
            reader, self._writer = await self._route()
            self._start_reading(reader)
            return
        if self._route is not None:
            await self._connect_by_route(*self._route)
            return
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + timeout_s
        while True:
            try:
                reader, self._writer = await self._open_socket()
                break
            except OSError as error:
                if loop.time() + RETRY_INTERVAL_S > deadline_s:
                    raise AgentError(f"{self._folder}: no agent answers ({error}); is it running?") from error
                await asyncio.sleep(RETRY_INTERVAL_S)
        self._start_reading(reader)

    async def _connect_by_route(self, command: Sequence[str], first_line: bytes) -> None:
        """Start the command that copies bytes; the first message shows that the whole route works."""
        self._folder.mkdir(parents=True, exist_ok=True)
        try:
            rotate_log(self._folder / AGENT_LOG)
            with (self._folder / AGENT_LOG).open("ab") as log:
                self._route_process = await asyncio.create_subprocess_exec(
                    *command,
                    stdin=asyncio.subprocess.PIPE,
                    stdout=asyncio.subprocess.PIPE,
                    stderr=log,
                    limit=_LINE_BYTES,
                    start_new_session=True,
                )
            reader, self._writer = self._route_process.stdout, self._route_process.stdin
            assert reader is not None and self._writer is not None
            self._writer.write(first_line)
            first = await asyncio.wait_for(reader.readline(), FIRST_MESSAGE_TIMEOUT_S)
        except (OSError, ValueError, TimeoutError) as error:
            raise AgentError(f"{command[0]}: no connection to the agent ({error or 'time-out'})") from error
        if not first:
            raise AgentError(f"no connection to the agent: {_read_last_line(self._folder / AGENT_LOG)}")
        self._start_reading(reader)
        with suppress(MessageError):
            message = read_line(first)
            if isinstance(message, Snapshot):
                self._protocol = message.protocol
                self._snapshots.put_nowait(message)

    def _start_reading(self, reader: asyncio.StreamReader) -> None:
        self._snapshots = asyncio.Queue()
        self._read_task = asyncio.create_task(self._read_messages(reader, self._snapshots))

    async def receive_snapshots(self) -> AsyncIterator[Snapshot]:
        """Yield the snapshots of the agent until the connection closes."""
        queue = self._snapshots
        while (snapshot := await queue.get()) is not None:
            yield snapshot

    async def request(self, request: Request, timeout_s: float = 30.0) -> Reply:
        """Send a request with a unique `id`, and wait for its reply.

        Raises
        ------
        AgentError
            There is no connection, it broke, or no reply arrived in time. The agent may have executed the
            request; it can be sent again, as requests are idempotent. A refusal is in `Reply.error`.
        AgentTooOld
            The agent has an older version that does not know this request; nothing was sent.
        """
        if self._writer is None or not self.is_connected:
            raise AgentError(f"{self._folder}: no agent is connected")
        number = next(self._ids)
        line = encode_for_protocol(request.model_copy(update={"id": number}), self._protocol)
        if line is None:
            raise AgentTooOld(f"{self._folder}: an agent of an older version does not know {request.do}")
        reply: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._pending_replies[number] = reply
        try:
            async with asyncio.timeout(timeout_s):
                self._writer.write(line.encode() + b"\n")
                await self._writer.drain()
                return await reply
        except (OSError, TimeoutError) as error:
            raise AgentError(f"{self._folder}: no reply to {request.do} ({error or 'time-out'})") from error
        finally:
            self._pending_replies.pop(number, None)

    async def close(self) -> None:
        """Disconnect; the agent continues."""
        if self._writer is not None:
            self._writer.close()
            with suppress(OSError):
                await self._writer.wait_closed()
            self._writer = None
        if self._route_process is not None:
            with suppress(ProcessLookupError):
                self._route_process.kill()  # the agent behind it has its own process session
            await self._route_process.wait()
            self._route_process = None
        if self._read_task is not None:
            await self._read_task
            self._read_task = None

    async def _open_socket(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        # The path of a socket is limited to 107 bytes, but the path of a state folder is not.
        descriptor = os.open(self._folder, os.O_PATH | os.O_DIRECTORY)
        try:
            path = f"/proc/self/fd/{descriptor}/{AGENT_SOCKET}"
            return await asyncio.open_unix_connection(path, limit=_LINE_BYTES)
        finally:
            os.close(descriptor)

    async def _read_messages(
        self, reader: asyncio.StreamReader, queue: asyncio.Queue[Snapshot | None]
    ) -> None:
        reason = "the connection to the agent is closed"
        try:
            while line := await reader.readline():
                self._on_message()
                message = read_line(line)
                if isinstance(message, Snapshot):
                    self._protocol = message.protocol
                    queue.put_nowait(message)
                    continue
                future = self._pending_replies.get(message.id)
                if future is not None and not future.done():
                    future.set_result(message)
        except (OSError, ValueError, MessageError) as error:
            reason = str(error)
        finally:
            queue.put_nowait(None)
            for future in self._pending_replies.values():
                if not future.done():
                    future.set_exception(AgentError(f"{self._folder}: {reason}"))


def _read_last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines() if log.exists() else []
    return lines[-1] if lines else "its log is empty"


def read_line(line: bytes) -> Snapshot | Reply:
    """Parse one line from an agent. Raises MessageError if it is not a message."""
    try:
        return from_agent_adapter.validate_json(line)
    except ValidationError as error:
        raise MessageError(f"not a message of an agent: {error.errors()[0]['msg']}") from error
