"""Connection between a daemon and a host: a `Mux` between a reader and a writer of asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

from drivers.errors import AgentError
from drivers.host.mux import DataReceived, Message, Mux, StreamClosed, StreamOpened

MAX_LINE_BYTES = 1024 * 1024
"""Maximum length of a line from an agent."""
_READ_BYTES = 128 * 1024
# A writer pauses above the first number of unsent bytes of its stream, and resumes at the second.
_HIGH_WATER_BYTES, _LOW_WATER_BYTES = 128 * 1024, 32 * 1024


class MuxStream(asyncio.Transport):
    """One stream as a transport for asyncio's reader and writer."""

    def __init__(self, owner: MuxConnection, number: int) -> None:
        super().__init__()
        self._owner, self._number = owner, number
        self._reader = asyncio.StreamReader(MAX_LINE_BYTES)
        self._protocol = asyncio.StreamReaderProtocol(self._reader)
        self._protocol.connection_made(self)
        self._is_closing = self._is_reading_paused = self._is_writing_paused = False
        self._unconsumed_bytes = 0

    def make_pair(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Return the reader and the writer of this stream."""
        loop = asyncio.get_running_loop()
        return self._reader, asyncio.StreamWriter(self, self._protocol, self._reader, loop)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Queue bytes for sending."""
        self._owner.write(self._number, bytes(data))
        if not self._is_writing_paused and self._owner.count_unsent_bytes(self._number) > _HIGH_WATER_BYTES:
            self._is_writing_paused = True
            self._protocol.pause_writing()

    def on_sent(self) -> None:
        """Resume the writer after bytes were sent."""
        if self._is_writing_paused and self._owner.count_unsent_bytes(self._number) <= _LOW_WATER_BYTES:
            self._is_writing_paused = False
            self._protocol.resume_writing()

    def on_data(self, data: bytes) -> None:
        """Pass received bytes to the reader."""
        self._protocol.data_received(data)
        if self._is_reading_paused:
            self._unconsumed_bytes += len(data)
        else:
            self._owner.consume(self._number, len(data))

    def on_closed(self, reason: str) -> None:
        """End the reader: the other end has closed the stream, or the connection is lost."""
        self._is_closing = True
        self._protocol.connection_lost(ConnectionError(reason) if reason else None)

    def pause_reading(self) -> None:
        """Stop the flow of bytes from the other end."""
        self._is_reading_paused = True

    def resume_reading(self) -> None:
        """Resume the flow of bytes from the other end."""
        self._is_reading_paused = False
        self._owner.consume(self._number, self._unconsumed_bytes)
        self._unconsumed_bytes = 0

    def is_closing(self) -> bool:
        """Return whether the stream is closed."""
        return self._is_closing

    def close(self, reason: str = "") -> None:
        """Close the stream after its unsent bytes, and send the reason to the other end."""
        if not self._is_closing:
            self._is_closing = True
            self._owner.close_stream(self._number, reason)
            asyncio.get_running_loop().call_soon(self._protocol.connection_lost, None)


class MuxConnection:
    """Connection that carries streams and messages until it breaks.

    Parameters
    ----------
    reader, writer
        Reader and writer of the connection.
    on_message
        Function that is called with each message about the host itself.
    on_stream
        Function that is called with each stream that the other end opens, and with the stream's name; None
        if the other end opens no streams.
    """

    def __init__(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        on_message: Callable[[bytes], None],
        on_stream: Callable[[MuxStream, str], None] | None = None,
    ) -> None:
        self._reader, self._writer = reader, writer
        self._on_message, self._on_stream = on_message, on_stream
        self._mux = Mux()
        self._streams: dict[int, MuxStream] = {}
        self._output_event = asyncio.Event()
        self.is_lost = False

    def open(self, name: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Open a stream to the agent of a printer. Raises AgentError if the connection is lost."""
        if self.is_lost:
            raise AgentError("the connection to its host is lost")
        number = self._mux.open(name)
        stream = self._streams[number] = MuxStream(self, number)
        self._output_event.set()
        return stream.make_pair()

    def send_message(self, data: bytes) -> None:
        """Send a message about the host itself."""
        self._mux.send_message(data)
        self._output_event.set()

    async def run(self) -> None:
        """Carry bytes until the connection ends. Raises OSError or MessageError."""
        send_task = asyncio.create_task(self._send_bytes())
        try:
            while data := await self._reader.read(_READ_BYTES):
                self._receive_bytes(data)
        finally:
            self.is_lost = True
            send_task.cancel()
            await asyncio.gather(send_task, return_exceptions=True)
            self._writer.close()
            with suppress(OSError):
                await self._writer.wait_closed()
            for stream in list(self._streams.values()):
                stream.on_closed("the connection to its host is lost")
            self._streams.clear()

    async def _send_bytes(self) -> None:
        with suppress(OSError):  # the reader of this connection ends too
            while True:
                await self._output_event.wait()
                self._output_event.clear()
                while data := self._mux.take():
                    self._writer.write(data)
                    await self._writer.drain()
                    for stream in list(self._streams.values()):
                        stream.on_sent()

    def _receive_bytes(self, data: bytes) -> None:
        for event in self._mux.receive(data):
            match event:
                case Message():
                    self._on_message(event.data)
                case StreamOpened():
                    self._accept_stream(event)
                case DataReceived():
                    if event.number in self._streams:
                        self._streams[event.number].on_data(event.data)
                case StreamClosed():
                    stream = self._streams.pop(event.number, None)
                    if stream is not None:
                        stream.on_closed(event.reason)
        self._output_event.set()  # credit may have been received, or may be due

    def _accept_stream(self, event: StreamOpened) -> None:
        if self._on_stream is None:
            self._mux.close(event.number, "no streams are opened in this direction")
            return
        stream = self._streams[event.number] = MuxStream(self, event.number)
        self._on_stream(stream, event.name)

    # -- called by the streams --------------------------------------------------------------------------

    def write(self, number: int, data: bytes) -> None:
        """Send bytes on a stream."""
        self._mux.write(number, data)
        self._output_event.set()

    def count_unsent_bytes(self, number: int) -> int:
        """Count the unsent bytes of a stream."""
        return self._mux.count_unsent_bytes(number)

    def consume(self, number: int, count: int) -> None:
        """Allow the other end to send `count` more bytes on a stream."""
        self._mux.consume(number, count)
        self._output_event.set()

    def close_stream(self, number: int, reason: str) -> None:
        """Close a stream."""
        self._streams.pop(number, None)
        self._mux.close(number, reason)
        self._output_event.set()
