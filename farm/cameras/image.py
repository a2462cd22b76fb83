"""Checks of an image that a camera has sent: only a JPEG or PNG within limits on its size is accepted. Pure.

The image is not decoded, because its header states its size.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

MAX_IMAGE_BYTES = 5_000_000
MAX_PIXELS = 50_000_000
"""Limit on width times height: a browser decodes all pixels, of which even a small file may have many."""
_PNG_MAGIC, _JPEG_MAGIC = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_PNG_SIZE = struct.Struct(">II")  # PNG: width, height, in the first chunk (IHDR)
_PNG_SIZE_OFFSET = 16
_SEGMENT_HEADER = struct.Struct(">BBH")  # JPEG: 0xFF, marker, length including its own two bytes
_FRAME_SIZE = struct.Struct(">HH")  # JPEG: height, width
_FRAME_SIZE_OFFSET = 5  # after the marker, the length, and the sample precision
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # markers that begin a frame
_SCAN_MARKER, _MARKER_PREFIX = 0xDA, 0xFF
_MAX_SEGMENTS = 500  # number of segments before the frame, so that a malicious file cannot block the daemon


class CameraError(Exception):
    """Error when a camera sends no valid still; the message gives the reason without the camera's address."""


class InvalidImage(Exception):
    """Error for bytes that are not an accepted image; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class Image:
    """Image that was checked: its bytes, its media type, and the suffix of a file name for it."""

    content: bytes
    media_type: str
    suffix: str


def check_beginning(first_bytes: bytes) -> None:
    """Check that a body, which may be incomplete, begins like a JPEG or PNG. Raises InvalidImage."""
    for magic in (_JPEG_MAGIC, _PNG_MAGIC):
        if first_bytes[: len(magic)] == magic[: len(first_bytes)]:
            return
    raise InvalidImage(
        "it sends no JPEG or PNG: `camera` needs the address of a still, not of a page or a stream"
    )


def read_image(content: bytes) -> Image:
    """Read the image in a response body.

    Raises
    ------
    InvalidImage
        If it is not a complete JPEG or PNG, or is too large.
    """
    check_beginning(content)
    if len(content) > MAX_IMAGE_BYTES:
        raise InvalidImage(f"its still is larger than {MAX_IMAGE_BYTES / 1e6:g} MB: lower its resolution")
    is_png = content.startswith(_PNG_MAGIC)
    try:
        size = _PNG_SIZE.unpack_from(content, _PNG_SIZE_OFFSET) if is_png else _read_jpeg_size(content)
    except struct.error:
        raise InvalidImage("its still is cut off") from None
    if not 0 < size[0] * size[1] <= MAX_PIXELS:
        raise InvalidImage(
            f"its still has {size[0]} x {size[1]} pixels; {MAX_PIXELS / 1e6:g} million at most: "
            "lower its resolution"
        )
    return Image(content, "image/png", ".png") if is_png else Image(content, "image/jpeg", ".jpg")


def _read_jpeg_size(content: bytes) -> tuple[int, int]:
    """Read width and height of a JPEG. Raises struct.error if it is cut off, InvalidImage if invalid."""
    offset = 2
    for _ in range(_MAX_SEGMENTS):
        start, marker, length = _SEGMENT_HEADER.unpack_from(content, offset)
        if start != _MARKER_PREFIX or marker == _SCAN_MARKER:
            raise InvalidImage("its still is not a valid JPEG")
        if marker in _FRAME_MARKERS:
            height, width = _FRAME_SIZE.unpack_from(content, offset + _FRAME_SIZE_OFFSET)
            return width, height
        offset += 1 if marker == _MARKER_PREFIX else 2 + max(2, length)  # 0xFF before a marker is a fill byte
    raise InvalidImage("its still is not a valid JPEG")
