"""Reader of multipart forms with one file, chunk by chunk, without I/O.

Only this module imports python_multipart. Browsers and slicers write forms in different ways: with fields
before or after the file, with or without quotes around the boundary, with header names in upper or lower
case, and with file names in UTF-8 that is not escaped.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from python_multipart import MultipartParser
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import parse_options_header

from farm.errors import ErrorCode, FarmError

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

MAX_PARTS = 20
"""Limit on the number of parts of a form: its fields and its file."""
MAX_FIELD_BYTES = 64 * 1024
"""Limit on the total size of the values of all fields."""
_FORM_TYPE = b"multipart/form-data"

# python_multipart logs each malformed form as a warning, so anybody on the network could fill the log.
logging.getLogger("python_multipart").setLevel(logging.ERROR)


class BadForm(FarmError):
    """Error for a form that cannot be read."""

    code = ErrorCode.REFUSED


class FormReader:
    """Reader of a form with fields and one file.

    Parameters
    ----------
    content_type
        The request's header `Content-Type`, which contains the boundary between the parts of the form.

    Attributes
    ----------
    fields
        Values of the fields by name; of several fields with one name, the last counts.
    file_name
        Name of the file as the client wrote it; None until the file's part of the form begins.

    Raises
    ------
    BadForm
        If the header is not that of a multipart form.
    """

    def __init__(self, content_type: str) -> None:
        kind, options = parse_options_header(content_type)
        boundary = options.get(b"boundary")
        if kind != _FORM_TYPE or not boundary:
            raise BadForm("this is not a form (multipart/form-data) with a file in its field `file`")
        self.fields: dict[str, str] = {}
        self.file_name: str | None = None
        self._pieces: list[bytes] = []  # content of the file since the last call of `feed`
        self._header_name = self._header_value = self._disposition = b""
        self._field: str | None = None  # name of the current field; None for the file
        self._value = b""
        self._part_count = self._field_bytes = 0
        self._is_complete = False
        callbacks: MultipartCallbacks = {
            "on_part_begin": self._begin_part,
            "on_header_field": self._add_header_name,
            "on_header_value": self._add_header_value,
            "on_header_end": self._end_header,
            "on_headers_finished": self._begin_content,
            "on_part_data": self._add_content,
            "on_part_end": self._end_part,
            "on_end": self._end_form,
        }
        try:
            self._parser = MultipartParser(boundary, callbacks)
        except FormParserError as error:
            raise BadForm(f"this form cannot be read: {error}") from error

    def feed(self, chunk: bytes) -> list[bytes]:
        """Read a chunk of the form.

        Parameters
        ----------
        chunk
            The next bytes of the request's body.

        Returns
        -------
        list of bytes
            Content of the file in this chunk; `file_name` is known before the first content.

        Raises
        ------
        BadForm
            If the form is malformed, or has too many parts, fields that are too long, or a second file.
        """
        try:
            self._parser.write(chunk)
        except FormParserError as error:
            raise BadForm(f"this form cannot be read: {error}") from error
        pieces, self._pieces = self._pieces, []
        return pieces

    def finish(self) -> None:
        """Check that the form is complete and has a file. Raises BadForm."""
        if not self._is_complete:
            raise BadForm("the upload stopped before its end: send it again")
        if self.file_name is None:
            raise BadForm("the form has no file in its field `file`")

    def is_true(self, name: str) -> bool:
        """Return whether the value of a field means true, by the rules of OctoPrint."""
        return self.fields.get(name, "").strip().lower() in ("true", "yes", "y", "1")

    def _begin_part(self) -> None:
        self._part_count += 1
        if self._part_count > MAX_PARTS:
            raise BadForm(f"the form has more than {MAX_PARTS} parts")
        self._header_name = self._header_value = self._disposition = self._value = b""

    def _add_header_name(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]

    def _add_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]

    def _end_header(self) -> None:
        if self._header_name.lower() == b"content-disposition":
            self._disposition = self._header_value
        self._header_name = self._header_value = b""

    def _begin_content(self) -> None:
        _, options = parse_options_header(self._disposition)
        name, file_name = options.get(b"name"), options.get(b"filename")
        if file_name is None:
            self._field = _decode_text(name or b"")
            return
        if self.file_name is not None:
            raise BadForm("the form has two files: send them one after the other")
        self._field, self.file_name = None, _decode_text(file_name)

    def _add_content(self, data: bytes, start: int, end: int) -> None:
        content = data if end - start == len(data) else data[start:end]
        if self._field is None:
            self._pieces.append(content)
            return
        self._field_bytes += len(content)
        if self._field_bytes > MAX_FIELD_BYTES:
            raise BadForm(f"the fields of the form are longer than {MAX_FIELD_BYTES // 1024} KiB")
        self._value += content

    def _end_part(self) -> None:
        if self._field is not None:
            self.fields[self._field] = _decode_text(self._value)

    def _end_form(self) -> None:
        self._is_complete = True


def _decode_text(text: bytes) -> str:
    """Decode a name or a value as UTF-8, which all known clients write."""
    return text.decode("utf-8", "replace")
