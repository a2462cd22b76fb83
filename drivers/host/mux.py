"""Several streams of bytes on one connection, each with its own flow control. Without I/O.

Each end may send `WINDOW_BYTES` on a stream, and then as many further bytes as the other end has consumed: a
stream that nobody reads stops, and the others continue. Streams with data to send take turns, one frame each.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from drivers.errors import MessageError
from drivers.host.frames import MAX_PAYLOAD_BYTES, Frame, FrameKind, FrameReader

WINDOW_BYTES = 256 * 1024
"""Maximum number of bytes in flight on a stream."""
FRAME_BYTES = 16 * 1024
"""Maximum payload of a frame with data: a stream waits for at most this many bytes of every other stream."""
_CREDIT = struct.Struct(">I")


@dataclass(frozen=True, slots=True)
class Opened:
    """The other end has opened a stream."""

    stream: int
    name: str


@dataclass(frozen=True, slots=True)
class Received:
    """Bytes have arrived on a stream; call `Mux.consume` to allow as many more."""

    stream: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Closed:
    """The other end has closed a stream, after all of its bytes."""

    stream: int
    reason: str


@dataclass(frozen=True, slots=True)
class Message:
    """A message about the host itself has arrived."""

    data: bytes


MuxEvent = Opened | Received | Closed | Message


@dataclass(slots=True)
class _Stream:
    outgoing: bytearray = field(default_factory=bytearray)
    send_credit: int = WINDOW_BYTES  # bytes that may still be sent
    receive_credit: int = WINDOW_BYTES  # bytes that the other end may still send
    consumed: int = 0  # bytes taken from the stream since the last CREDIT frame
    closing: bytes | None = None  # the reason, to be sent after `outgoing`

    @property
    def is_ready(self) -> bool:
        """True if a frame can be sent."""
        return bool(self.outgoing and self.send_credit > 0) or (
            not self.outgoing and self.closing is not None
        )


class Mux:
    """One end of a connection with several streams. Only one of the two ends opens streams."""

    def __init__(self) -> None:
        self._reader = FrameReader()
        self._streams: dict[int, _Stream] = {}
        self._priority_frames: deque[Frame] = deque()  # sent before all data
        self._ready_streams: deque[int] = deque()  # numbers of the streams with a frame to send, each once
        self._last_number = 0

    def open(self, name: str) -> int:
        """Open a stream to the printer of this name; return its number."""
        self._last_number += 1
        self._streams[self._last_number] = _Stream()
        self._priority_frames.append(Frame(FrameKind.OPEN, self._last_number, name.encode()))
        return self._last_number

    def write(self, stream: int, data: bytes) -> None:
        """Append bytes to a stream; they are dropped if it is closed."""
        state = self._streams.get(stream)
        if state is not None and state.closing is None:
            state.outgoing += data
            self._queue(stream, state)

    def count_waiting(self, stream: int) -> int:
        """Count the unsent bytes of a stream."""
        state = self._streams.get(stream)
        return 0 if state is None else len(state.outgoing)

    def close(self, stream: int, reason: str = "") -> None:
        """Close a stream after its unsent bytes."""
        state = self._streams.get(stream)
        if state is not None and state.closing is None:
            state.closing = reason.encode()[:FRAME_BYTES]
            self._queue(stream, state)

    def consume(self, stream: int, count: int) -> None:
        """Allow the other end to send `count` more bytes, because as many were taken from the stream."""
        state = self._streams.get(stream)
        if state is None:
            return
        state.consumed += count
        if state.consumed >= WINDOW_BYTES // 4:  # one frame per piece would double the traffic
            state.receive_credit += state.consumed
            self._priority_frames.append(Frame(FrameKind.CREDIT, stream, _CREDIT.pack(state.consumed)))
            state.consumed = 0

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
            event = self._read(frame)
            if event is not None:
                yield event

    def _queue(self, stream: int, state: _Stream) -> None:
        if state.is_ready and stream not in self._ready_streams:
            self._ready_streams.append(stream)

    def _take_data(self) -> Frame | None:
        if not self._ready_streams:
            return None
        number = self._ready_streams.popleft()
        stream = self._streams[number]
        if not stream.outgoing:
            del self._streams[number]
            return Frame(FrameKind.CLOSE, number, stream.closing or b"")
        size = min(FRAME_BYTES, stream.send_credit, len(stream.outgoing))
        payload = bytes(stream.outgoing[:size])
        del stream.outgoing[:size]
        stream.send_credit -= size
        self._queue(number, stream)
        return Frame(FrameKind.DATA, number, payload)

    def _read(self, frame: Frame) -> MuxEvent | None:
        number = frame.stream
        if frame.kind is FrameKind.MESSAGE:
            return Message(frame.payload)
        if frame.kind is FrameKind.OPEN:
            if number in self._streams:
                raise MessageError(f"stream {number} is open already")
            self._streams[number] = _Stream()
            return Opened(number, frame.payload.decode(errors="replace"))
        stream = self._streams.get(number)
        if stream is None:
            return None  # closed here while the frame was in transit
        if frame.kind is FrameKind.CLOSE:
            self._forget(number)
            return Closed(number, frame.payload.decode(errors="replace"))
        if frame.kind is FrameKind.CREDIT:
            if len(frame.payload) != _CREDIT.size:
                raise MessageError("not a number of bytes")
            stream.send_credit += _CREDIT.unpack(frame.payload)[0]
            self._queue(number, stream)
            return None
        stream.receive_credit -= len(frame.payload)
        if stream.receive_credit < 0:
            raise MessageError(f"stream {number} has sent more than it may")
        return Received(number, frame.payload)

    def _forget(self, number: int) -> None:
        del self._streams[number]
        if number in self._ready_streams:
            self._ready_streams.remove(number)
