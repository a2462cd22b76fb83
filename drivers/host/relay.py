"""Relay between one stream of the daemon's connection and the socket of an agent."""

from __future__ import annotations

import asyncio
import os
import time
from contextlib import suppress
from pathlib import Path

from drivers.host.connection import MAX_LINE_BYTES, MuxStream
from drivers.host.supervision import ReportFilter
from drivers.messages import AGENT_SOCKET
from drivers.records import AGENT_LOG
from drivers.remote import RETRY_INTERVAL_S

_CONNECT_TIMEOUT_S = 30.0
_READ_BYTES = 64 * 1024


async def relay_stream(stream: MuxStream, folder: Path, report_interval_s: float) -> None:
    """Relay lines from the agent, and bytes to it, until one end closes.

    Parameters
    ----------
    stream
        The stream from the daemon.
    folder
        The agent's folder.
    report_interval_s
        See `ReportFilter`.
    """
    reader, writer = stream.make_pair()
    agent_streams = await _connect_to_agent(folder)
    if agent_streams is None:
        stream.close(f"no agent answers; see {folder / AGENT_LOG} there")
        return
    agent_reader, agent_writer = agent_streams
    to_daemon = asyncio.create_task(_relay_lines(agent_reader, writer, report_interval_s))
    to_agent = asyncio.create_task(_relay_bytes(reader, agent_writer))
    try:
        await asyncio.wait((to_daemon, to_agent), return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (to_daemon, to_agent):
            task.cancel()
        await asyncio.gather(to_daemon, to_agent, return_exceptions=True)
        stream.close()
        agent_writer.close()
        with suppress(OSError):
            await agent_writer.wait_closed()


async def _connect_to_agent(folder: Path) -> tuple[asyncio.StreamReader, asyncio.StreamWriter] | None:
    """Connect to an agent that may just be starting; None if none answers in time."""
    deadline_s = time.monotonic() + _CONNECT_TIMEOUT_S
    while time.monotonic() < deadline_s:
        with suppress(OSError):
            descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY)
            try:
                path = f"/proc/self/fd/{descriptor}/{AGENT_SOCKET}"
                return await asyncio.open_unix_connection(path, limit=MAX_LINE_BYTES)
            finally:
                os.close(descriptor)
        await asyncio.sleep(RETRY_INTERVAL_S)
    return None


async def _relay_lines(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, report_interval_s: float
) -> None:
    report_filter = ReportFilter(report_interval_s)
    with suppress(OSError, ValueError):  # ValueError: a line was too long; the daemon will connect again
        while line := await reader.readline():
            if report_filter.passes(line, time.monotonic()):
                writer.write(line)
                await writer.drain()


async def _relay_bytes(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(_READ_BYTES):
            writer.write(data)
            await writer.drain()
