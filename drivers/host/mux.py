"""Several streams of bytes on one connection, each with its own flow control. Without I/O.

Each end may send `WINDOW_BYTES` on a stream, and then as many further bytes as the other end has consumed: a
stream that nobody reads stops, and the others continue. Streams with data to send take turns, one frame each.
A frame has a kind, the number of its stream, a length and a payload.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum

from drivers.errors import MessageError

WINDOW_BYTES = 256 * 1024
"""Maximum number of bytes in flight on a stream."""
FRAME_BYTES = 16 * 1024
"""Maximum payload of a frame with data: a stream waits for at most this many bytes of every other stream."""
MAX_PAYLOAD_BYTES = 1024 * 1024
"""Maximum size of any payload: far more than the state of a host with a hundred printers."""
_HEADER = struct.Struct(">BII")
_CREDIT = struct.Struct(">I")


class FrameKind(IntEnum):
    """Kind of a frame. The numbers are fixed, as hosts of other versions use them."""

    MESSAGE = 0  # JSON about the host itself; its stream is 0
    OPEN = 1  # the payload names the printer
    DATA = 2
    CREDIT = 3  # additional bytes that the other end may send on this stream
    CLOSE = 4  # the payload is the reason, if any


@dataclass(frozen=True, slots=True)
class Frame:
    """Frame of the connection: its kind, its stream, and its payload."""

    kind: FrameKind
    stream_number: int
    payload: bytes = b""

    def encode(self) -> bytes:
        """Encode the frame as bytes on the wire."""
        return _HEADER.pack(self.kind, self.stream_number, len(self.payload)) + self.payload


class FrameReader:
    """Splitter of received bytes into frames; a frame may arrive in several pieces."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that these bytes complete.

        Raises
        ------
        MessageError
            The bytes are not frames: the connection can no longer be used.
        """
        buffer, frames, offset = self._buffer, [], 0
        buffer += data
        while len(buffer) - offset >= _HEADER.size:
            kind, stream, size = _HEADER.unpack_from(buffer, offset)
            if kind not in FrameKind.__members__.values() or size > MAX_PAYLOAD_BYTES:
                raise MessageError(f"not a frame: kind {kind}, {size} bytes; is it farm's host service?")
            end = offset + _HEADER.size + size
            if end > len(buffer):
                break
            frames.append(Frame(FrameKind(kind), stream, bytes(buffer[offset + _HEADER.size : end])))
            offset = end
        del buffer[:offset]
        return frames


@dataclass(frozen=True, slots=True)
class StreamOpened:
    """The other end has opened a stream."""

    number: int
    name: str


@dataclass(frozen=True, slots=True)
class DataReceived:
    """Bytes have arrived on a stream; call `Mux.consume` to allow as many more."""

    number: int
    data: bytes


@dataclass(frozen=True, slots=True)
class StreamClosed:
    """The other end has closed a stream, after all of its bytes."""

    number: int
    reason: str


@dataclass(frozen=True, slots=True)
class Message:
    """A message about the host itself has arrived."""

    data: bytes


MuxEvent = StreamOpened | DataReceived | StreamClosed | Message


@dataclass(slots=True)
class _Stream:
    """State of one stream, at this end."""

    outgoing_bytes: bytearray = field(default_factory=bytearray)
    send_credit_bytes: int = WINDOW_BYTES  # bytes that may still be sent
    receive_credit_bytes: int = WINDOW_BYTES  # bytes that the other end may still send
    consumed_bytes: int = 0  # taken from the stream since the last CREDIT frame
    close_reason: bytes | None = None  # to be sent after `outgoing_bytes`

    @property
    def is_ready(self) -> bool:
        """True if a frame can be sent."""
        return bool(self.outgoing_bytes and self.send_credit_bytes > 0) or (
            not self.outgoing_bytes and self.close_reason is not None
        )


class Mux:
    """One end of a connection with several streams. Only one of the two ends opens streams."""

    def __init__(self) -> None:
        self._reader = FrameReader()
        self._streams: dict[int, _Stream] = {}
        self._priority_frames: deque[Frame] = deque()  # sent before all data
        self._ready_numbers: deque[int] = deque()  # numbers of the streams that have a frame to send
        self._last_number = 0

    def open(self, name: str) -> int:
        """Open a stream to the printer of this name; return its number."""
        self._last_number += 1
        self._streams[self._last_number] = _Stream()
        self._priority_frames.append(Frame(FrameKind.OPEN, self._last_number, name.encode()))
        return self._last_number

    def write(self, number: int, data: bytes) -> None:
        """Append bytes to a stream; they are dropped if it is closed."""
        stream = self._streams.get(number)
        if stream is not None and stream.close_reason is None:
            stream.outgoing_bytes += data
            self._queue_stream(number, stream)

    def count_unsent_bytes(self, number: int) -> int:
        """Count the unsent bytes of a stream."""
        stream = self._streams.get(number)
        return 0 if stream is None else len(stream.outgoing_bytes)

    def close(self, number: int, reason: str = "") -> None:
        """Close a stream after its unsent bytes."""
        stream = self._streams.get(number)
        if stream is not None and stream.close_reason is None:
            stream.close_reason = reason.encode()[:FRAME_BYTES]
            self._queue_stream(number, stream)

    def consume(self, number: int, count: int) -> None:
        """Allow the other end to send `count` more bytes, because as many were taken from the stream."""
        stream = self._streams.get(number)
        if stream is None:
            return
        stream.consumed_bytes += count
        if stream.consumed_bytes >= WINDOW_BYTES // 4:  # one frame per piece would double the traffic
            stream.receive_credit_bytes += stream.consumed_bytes
            self._priority_frames.append(Frame(FrameKind.CREDIT, number, _CREDIT.pack(stream.consumed_bytes)))
            stream.consumed_bytes = 0

    def send_message(self, data: bytes) -> None:
        """Send a message about the host itself."""
        if len(data) > MAX_PAYLOAD_BYTES:
            raise MessageError(f"a message of {len(data)} bytes is too long")
        self._priority_frames.append(Frame(FrameKind.MESSAGE, 0, data))

    def take(self, target_bytes: int = 4 * FRAME_BYTES) -> bytes:
        """Return the next bytes for the connection, about `target_bytes`; empty if there are none now."""
        data = bytearray()
        while len(data) < target_bytes:
            frame = self._priority_frames.popleft() if self._priority_frames else self._take_data()
            if frame is None:
                break
            data += frame.encode()
        return bytes(data)

    def receive(self, data: bytes) -> Iterator[MuxEvent]:
        """Yield the events of received bytes.

        Raises
        ------
        MessageError
            The other end breaks the protocol.
        """
        for frame in self._reader.feed(data):
            event = self._handle_frame(frame)
            if event is not None:
                yield event

    def _queue_stream(self, number: int, stream: _Stream) -> None:
        if stream.is_ready and number not in self._ready_numbers:
            self._ready_numbers.append(number)

    def _take_data(self) -> Frame | None:
        if not self._ready_numbers:
            return None
        number = self._ready_numbers.popleft()
        stream = self._streams[number]
        if not stream.outgoing_bytes:
            del self._streams[number]
            return Frame(FrameKind.CLOSE, number, stream.close_reason or b"")
        size = min(FRAME_BYTES, stream.send_credit_bytes, len(stream.outgoing_bytes))
        payload = bytes(stream.outgoing_bytes[:size])
        del stream.outgoing_bytes[:size]
        stream.send_credit_bytes -= size
        self._queue_stream(number, stream)
        return Frame(FrameKind.DATA, number, payload)

    def _handle_frame(self, frame: Frame) -> MuxEvent | None:
        number = frame.stream_number
        if frame.kind is FrameKind.MESSAGE:
            return Message(frame.payload)
        if frame.kind is FrameKind.OPEN:
            if number in self._streams:
                raise MessageError(f"stream {number} is open already")
            self._streams[number] = _Stream()
            return StreamOpened(number, frame.payload.decode(errors="replace"))
        stream = self._streams.get(number)
        if stream is None:
            return None  # closed here while the frame was in transit
        if frame.kind is FrameKind.CLOSE:
            self._forget_stream(number)
            return StreamClosed(number, frame.payload.decode(errors="replace"))
        if frame.kind is FrameKind.CREDIT:
            if len(frame.payload) != _CREDIT.size:
                raise MessageError(f"a CREDIT frame has {len(frame.payload)} bytes, not {_CREDIT.size}")
            stream.send_credit_bytes += _CREDIT.unpack(frame.payload)[0]
            self._queue_stream(number, stream)
            return None
        stream.receive_credit_bytes -= len(frame.payload)
        if stream.receive_credit_bytes < 0:
            raise MessageError(f"stream {number} has sent more than it may")
        return DataReceived(number, frame.payload)

    def _forget_stream(self, number: int) -> None:
        del self._streams[number]
        if number in self._ready_numbers:
            self._ready_numbers.remove(number)
