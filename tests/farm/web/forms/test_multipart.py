"""Forms of slicers, in every field order and with any split."""

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farm.web.forms.multipart import MAX_FIELD_BYTES, MAX_PARTS, BadForm, FormReader

CONTENT = b"G28\r\n--boundary!\r\n--bound\r\n-\r\n" * 3
CURL_CONTENT_TYPE = "multipart/form-data; boundary=boundary"


def write_form(parts, boundary="boundary", end="--\r\n"):
    """Write a form of (headers, content) parts."""
    lines = [f"--{boundary}\r\n{head}\r\n\r\n".encode() + content + b"\r\n" for head, content in parts]
    return b"".join(lines) + f"--{boundary}{end}".encode()


def write_field(name, value):
    return f'Content-Disposition: form-data; name="{name}"', value.encode()


def write_file_field(name="a.gcode", content=CONTENT, header="Content-Disposition"):
    disposition = f'{header}: form-data; name="file"; filename="{name}"'
    return f"{disposition}\r\nContent-Type: application/octet-stream", content


def read_form(form, *cuts, content_type=CURL_CONTENT_TYPE):
    """Read a form that is split at some offsets."""
    reader, pieces = FormReader(content_type), []
    for begin, end in zip((0, *cuts), (*cuts, len(form)), strict=True):
        pieces += reader.feed(form[begin:end])
    reader.finish()
    return reader, b"".join(pieces)


PRUSA_FORM = write_form([write_field("print", "true"), write_field("path", "x/y"), write_file_field()])
CURA_FORM = write_form(
    [
        write_field("path", "x/y"),
        write_file_field(),
        write_field("select", "true"),
        write_field("print", "true"),
    ]
)


@pytest.mark.parametrize("form", [PRUSA_FORM, CURA_FORM], ids=["options first", "options last"])
@settings(deadline=None)
@given(data=st.data())
def test_form_is_read_independently_of_its_chunks(form, data):
    cuts = sorted(data.draw(st.lists(st.integers(0, len(form)), max_size=5)))
    reader, content = read_form(form, *cuts)
    assert content == CONTENT
    assert (reader.file_name, reader.fields["path"], reader.is_true("print")) == ("a.gcode", "x/y", True)


def test_form_is_read_byte_by_byte():
    reader, content = read_form(PRUSA_FORM, *range(1, len(PRUSA_FORM)))
    assert (reader.file_name, content) == ("a.gcode", CONTENT)


@pytest.mark.parametrize("boundary", ["boundary_.oOo._a/b+c==", "------------------------1234567890abcdef"])
@pytest.mark.parametrize("quote", ['"', ""])
def test_boundaries_of_qt_and_of_curl_are_read_quoted_or_not(boundary, quote):
    form = write_form(
        [write_file_field("Größe \N{OLD ITALIC LETTER A}.gcode", header="content-disposition")], boundary
    )
    reader, content = read_form(form, content_type=f"multipart/form-data; boundary={quote}{boundary}{quote}")
    assert (reader.file_name, content) == ("Größe \N{OLD ITALIC LETTER A}.gcode", CONTENT)


def test_truncated_form_is_never_complete():
    min_length = len(PRUSA_FORM) - 2  # the last line break may be missing
    for end in range(min_length):
        with pytest.raises(BadForm, match="stopped before its end"):
            read_form(PRUSA_FORM[:end])
    read_form(PRUSA_FORM[:min_length])


@pytest.mark.parametrize(
    ("form", "reason"),
    [
        (write_form([write_field("print", "true")]), "no file"),
        (write_form([write_file_field(), write_file_field("b.gcode")]), "two files"),
        (
            write_form([write_field(str(n), "x") for n in range(MAX_PARTS)] + [write_file_field()]),
            "more than 20 parts",
        ),
        (
            write_form([write_field("path", "x" * (MAX_FIELD_BYTES + 1)), write_file_field()]),
            "longer than 64 KiB",
        ),
        (write_form([("X" * 10_000 + ": y", b"")]), "cannot be read"),
        (write_form([(f"X{n}: y", b"") for n in range(1)] + [("\x00: y", b"")]), "cannot be read"),
        (b"no form at all", "cannot be read"),
    ],
)
def test_malformed_form_is_refused_with_the_reason(form, reason):
    with pytest.raises(BadForm, match=reason):
        read_form(form)


@pytest.mark.parametrize(
    "content_type",
    [
        "",
        "text/plain",
        "multipart/form-data",
        f"multipart/form-data; boundary={'x' * 300}",
        "multipart/mixed; boundary=x",
    ],
)
def test_invalid_form_is_refused(content_type):
    with pytest.raises(BadForm):
        FormReader(content_type)


@settings(deadline=None)
@given(st.binary(max_size=300), st.integers(0, 300))
def test_any_bytes_are_read_or_refused(noise, offset):
    form = PRUSA_FORM[: offset % len(PRUSA_FORM)] + noise + PRUSA_FORM[offset % len(PRUSA_FORM) :]
    with suppress(BadForm):
        read_form(form, offset % (len(form) + 1))


@pytest.mark.parametrize(
    ("value", "is_true"), [("true", True), ("True ", True), ("1", True), ("", False), ("false", False)]
)
def test_every_form_of_true_is_read(value, is_true):
    assert (
        read_form(write_form([write_field("print", value), write_file_field()]))[0].is_true("print")
        is is_true
    )
