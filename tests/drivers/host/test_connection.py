"""Streams between two ends in one process."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from drivers.errors import AgentError
from drivers.host.connection import MuxConnection, MuxStream
from drivers.host.mux import WINDOW_BYTES


def run_pair(
    scenario: Callable[[MuxConnection, MuxConnection], Awaitable[None]],
    on_stream: Callable[[MuxStream, str], None],
    messages: list[bytes] | None = None,
) -> None:
    """Run a scenario with both ends of a connection, that of the daemon and that of the host."""

    async def run_ends() -> None:
        ends: list[MuxConnection] = []
        connection: asyncio.Future[tuple[asyncio.StreamReader, asyncio.StreamWriter]]
        connection = asyncio.get_running_loop().create_future()

        async def accept_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            connection.set_result((reader, writer))

        server = await asyncio.start_server(accept_connection, "127.0.0.1", 0)
        near_end = await asyncio.open_connection(*server.sockets[0].getsockname())
        far_end = await connection
        ends.append(MuxConnection(*near_end, ([] if messages is None else messages).append))
        ends.append(MuxConnection(*far_end, lambda _: None, on_stream))
        tasks = [asyncio.create_task(end.run()) for end in ends]
        try:
            async with asyncio.timeout(30):
                await scenario(*ends)
        finally:
            near_end[1].close()
            await asyncio.gather(*tasks, return_exceptions=True)
            server.close()

    asyncio.run(run_ends())


def test_several_streams_and_a_message_arrive_unchanged():
    messages: list[bytes] = []

    async def echo_stream(stream: MuxStream) -> None:
        reader, writer = stream.make_pair()
        while data := await reader.read(5000):
            writer.write(data)
            await writer.drain()
        writer.close()

    tasks = set()

    async def run_scenario(daemon: MuxConnection, host: MuxConnection) -> None:
        async def ask_agent(name: str) -> None:
            reader, writer = daemon.open(name)
            text = name.encode() * 60_000
            writer.write(text)
            assert await reader.readexactly(len(text)) == text
            writer.close()

        await asyncio.gather(*(ask_agent(name) for name in ("um2-01", "um2-02", "um2-03")))
        host.send_message(b"{}")
        while not messages:
            await asyncio.sleep(0)
        assert messages == [b"{}"]

    run_pair(run_scenario, lambda s, _: tasks.add(asyncio.create_task(echo_stream(s))), messages)


def test_only_the_writer_of_an_unread_stream_waits():
    streams: dict[str, tuple[asyncio.StreamReader, asyncio.StreamWriter]] = {}

    async def run_scenario(daemon: MuxConnection, _: MuxConnection) -> None:
        slow_pair, fast_pair = daemon.open("slow"), daemon.open("fast")
        fast_pair[1].write(b"hello\n")
        while len(streams) < 2:
            await asyncio.sleep(0)
        sent_bytes = 0

        async def fill_stream() -> None:
            nonlocal sent_bytes
            while True:
                slow_pair[1].write(bytes(65536))
                await slow_pair[1].drain()
                sent_bytes += 65536

        fill_task = asyncio.create_task(fill_stream())
        assert await streams["fast"][0].readline() == b"hello\n"
        old_sent_bytes = -1
        while old_sent_bytes != sent_bytes:  # until the writer waits
            old_sent_bytes = sent_bytes
            fast_pair[1].write(b"hello\n")
            assert await streams["fast"][0].readline() == b"hello\n"
            for _ in range(200):
                await asyncio.sleep(0)
        assert sent_bytes < 2 * 1024 * 1024 + 3 * WINDOW_BYTES
        await streams["slow"][0].readexactly(sent_bytes)
        while sent_bytes == old_sent_bytes:
            await asyncio.sleep(0)
        fill_task.cancel()
        for _, writer in (slow_pair, fast_pair, *streams.values()):
            writer.close()

    run_pair(run_scenario, lambda s, name: streams.update({name: s.make_pair()}))


def test_reader_raises_the_reason_that_the_other_end_gives():
    async def run_scenario(daemon: MuxConnection, _: MuxConnection) -> None:
        reader, _writer = daemon.open("um2-09")
        with pytest.raises(ConnectionError, match="no printer um2-09"):
            await reader.readline()

    run_pair(run_scenario, lambda s, name: s.close(f"no printer {name}"))


def test_lost_connection_ends_all_streams_and_opens_no_more():
    streams: list[MuxStream] = []

    async def run_scenario(daemon: MuxConnection, host: MuxConnection) -> None:
        reader, _writer = daemon.open("a")
        while not streams:
            await asyncio.sleep(0)
        host._writer.transport.abort()
        with pytest.raises(ConnectionError):
            await reader.readline()
        with pytest.raises(AgentError, match="host is lost"):
            daemon.open("a")

    run_pair(run_scenario, lambda s, _: streams.append(s))
