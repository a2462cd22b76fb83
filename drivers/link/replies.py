"""Answers of a board, sorted into events. Pure.

The wording is that of docs/explanation/ultimaker2-serial.md, sections 1 and 3.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.errors import Fault
from drivers.firmware import Firmware

_DEGREES, _NUMBER = rb"\s*(-?[\d.]{1,12})", rb"(\d{1,12})"  # no board says more, but noise may
_REPORT = re.compile(rb"T:%b\s*/%b\s+B:%b\s*/%b(?![\d.])" % ((_DEGREES,) * 4))
_LAST_LINE = re.compile(rb"Last Line: %b\s*\Z" % _NUMBER)
_RESEND = re.compile(rb"Resend: ?%b\s*\Z" % _NUMBER)
_BEGINNINGS = re.compile(rb"(?=Error:|Resend:)")
_CARD_OK = b"echo:SD card ok"


@dataclass(frozen=True, slots=True)
class Up:
    """The board answers. `restarted`: it said ``start`` first; `banner` is what it said then."""

    restarted: bool
    banner: bytes


@dataclass(frozen=True, slots=True)
class Report:
    """An answer to M105, in degrees Celsius."""

    nozzle_c: float
    nozzle_target_c: float
    bed_c: float
    bed_target_c: float

    @property
    def off(self) -> bool:
        """Nothing is to be heated."""
        return self.nozzle_target_c == 0 and self.bed_target_c == 0


@dataclass(frozen=True, slots=True)
class Said:
    """A line that is neither an answer of the protocol nor trouble."""

    text: bytes


@dataclass(frozen=True, slots=True)
class Trouble:
    """The link has stopped sending. `text` is what the board said, or what it did not."""

    fault: Fault
    text: str


Event = Up | Report | Said | Trouble
Events = Sequence[Event]


def report(line: bytes) -> Report | None:
    """The temperatures of an answer to M105; None where it is garbled."""
    values = _REPORT.search(line)
    if values is not None:
        with suppress(ValueError):  # as "2.1.5" is
            return Report(*(float(value) for value in values.groups()))
    return None


def wanted(line: bytes) -> int | None:
    """The number that a ``Resend`` asks for."""
    found = _RESEND.search(line)
    return None if found is None else int(found[1])


def last_line(line: bytes, firmware: Firmware) -> int | None:
    """The number of the last line that was accepted, in an answer to `Firmware.last_line_query`."""
    found = _LAST_LINE.search(line) if line.startswith(firmware.last_line_answer) else None
    return None if found is None else int(found[1])


def refused(line: bytes) -> bool:
    """Whether this is why a line was refused; a ``Resend`` follows."""
    return line.startswith(b"Error:") and b"Last Line" in line


def acknowledged(words: bytes, firmware: Firmware) -> int | None:
    """The number of the line that an ok names; negative where it names none; None where this is no ok."""
    if words == b"ok":
        return -1
    found = None if firmware.ok_details is None else firmware.ok_details.fullmatch(words, 2)
    return None if found is None or not words.startswith(b"ok") else int(found[1] or -1)


def words(line: bytes, firmware: Firmware) -> list[bytes]:
    """The answers in a line: more than one where a newline was lost, or M119 left it out."""
    if acknowledged(line, firmware) is not None:
        return [line]
    found: list[bytes] = []
    for part in _BEGINNINGS.split(line):
        front, back = [], []
        if part.endswith(b"ok") and part != _CARD_OK:
            part, back = part[:-2], [b"ok"]
        if part.startswith(b"ok") and b"T:" not in part:
            front, part = [b"ok"], part[2:]
        found += [*front, *([part] if part else []), *back]
    return found


def trouble(line: bytes, firmware: Firmware) -> Trouble | None:
    """Read what a line says of the board's troubles; None where it says nothing of them."""
    fault = next((fault for mark, fault in firmware.troubles if mark in line), None)
    return None if fault is None else Trouble(fault, line.decode("ascii", "replace").strip())
