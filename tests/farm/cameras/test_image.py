"""Recognition of images by their first bytes and their header, without decoding."""

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.cameras.image import MAX_IMAGE_BYTES, InvalidImage, check_beginning, read_image
from hosts.fake_camera import make_jpeg, make_png


def test_jpeg_and_png_are_images():
    assert (read_image(make_jpeg()).media_type, read_image(make_jpeg()).suffix) == ("image/jpeg", ".jpg")
    assert (read_image(make_png()).media_type, read_image(make_png()).suffix) == ("image/png", ".png")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "cut off"),
        (b"\xff\xd8\xff", "cut off"),
        (make_png()[:20], "cut off"),
        (make_jpeg()[:28], "cut off"),
        (b"<!doctype html><h1>Login</h1>", "no JPEG or PNG"),
        (b"--boundary\r\nContent-Type: image/jpeg\r\n\r\n\xff\xd8\xff", "no JPEG or PNG"),
        (b"GIF89a" + bytes(100), "no JPEG or PNG"),
        (make_jpeg(10_000, 10_000), "10000 x 10000 pixels"),
        (make_png(10_000, 10_000), "10000 x 10000 pixels"),
        (make_jpeg(0, 480), "0 x 480 pixels"),
        (b"\xff\xd8\xff\xda" + bytes(100), "not a valid JPEG"),
        (b"\xff\xd8\xff\x00\x00\x02" + bytes(100), "not a valid JPEG"),
        (make_jpeg() + bytes(MAX_IMAGE_BYTES), "larger than 5 MB"),
    ],
)
def test_other_bytes_are_not_an_image(content, message):
    with pytest.raises(InvalidImage, match=message):
        read_image(content)


def test_number_of_segments_is_limited():
    segment = b"\xff\xe1" + struct.pack(">H", 2)
    with pytest.raises(InvalidImage, match="not a valid JPEG"):
        read_image(b"\xff\xd8" + segment * 1000 + make_jpeg()[2:])


@given(st.binary(max_size=200), st.sampled_from([b"", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"]))
def test_any_bytes_are_an_image_or_refused(body, magic):
    with contextlib.suppress(InvalidImage):
        assert read_image(magic + body).content == magic + body


@given(st.integers(0, 12))
def test_truncated_image_header_is_handled_at_any_length(length):
    check_beginning(make_png()[:length])
    check_beginning(make_jpeg()[:length])
