"""Frames of the connection to a host: kind, stream, length, payload. Pure."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from drivers.errors import MessageError

MAX_PAYLOAD_BYTES = 1024 * 1024
"""Maximum size of a payload: far more than the state of a host with a hundred printers."""
_HEADER = struct.Struct(">BII")


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
