"""Parser that turns answers of a board into events. Pure.

The answers are described in docs/explanation/ultimaker2-serial.md, sections 1 and 3.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.errors import Fault
from drivers.firmware import Firmware

_DEGREES, _NUMBER = rb"\s*(-?[\d.]{1,12})", rb"(\d{1,12})"  # no board sends more digits, but noise may
_REPORT = re.compile(rb"T:%b\s*/%b\s+B:%b\s*/%b(?![\d.])" % ((_DEGREES,) * 4))
_LAST_LINE = re.compile(rb"Last Line: %b\s*\Z" % _NUMBER)
_RESEND = re.compile(rb"Resend: ?%b\s*\Z" % _NUMBER)
_ANSWER_STARTS = re.compile(rb"(?=Error:|Resend:)")
_CARD_OK = b"echo:SD card ok"


@dataclass(frozen=True, slots=True)
class BoardConnected:
    """The board answers. `has_restarted` is true if it sent ``start`` first, followed by `banner`."""

    has_restarted: bool
    banner: bytes


@dataclass(frozen=True, slots=True)
class Report:
    """An answer to M105, in degrees Celsius."""

    nozzle_c: float
    nozzle_target_c: float
    bed_c: float
    bed_target_c: float

    @property
    def targets_off(self) -> bool:
        """True if both targets are 0."""
        return self.nozzle_target_c == 0 and self.bed_target_c == 0


@dataclass(frozen=True, slots=True)
class UnknownLine:
    """A line that is neither an answer of the protocol nor a fault."""

    text: bytes


@dataclass(frozen=True, slots=True)
class LinkFault:
    """A fault that stopped the link. `text` is the board's message, or describes the fault."""

    fault: Fault
    text: str


Event = BoardConnected | Report | UnknownLine | LinkFault
Events = Sequence[Event]


def parse_report(line: bytes) -> Report | None:
    """Parse an answer to M105; None if it is garbled."""
    values = _REPORT.search(line)
    if values is not None:
        with suppress(ValueError):  # not a number, such as "2.1.5"
            return Report(*(float(value) for value in values.groups()))
    return None


def parse_resend(line: bytes) -> int | None:
    """Parse the number in a ``Resend``."""
    match = _RESEND.search(line)
    return None if match is None else int(match[1])


def parse_last_line(line: bytes, firmware: Firmware) -> int | None:
    """Parse the number of the last accepted line in an answer to `Firmware.last_line_query`."""
    match = _LAST_LINE.search(line) if line.startswith(firmware.last_line_answer) else None
    return None if match is None else int(match[1])


def is_refusal(line: bytes) -> bool:
    """Return True if this message explains a refusal; a ``Resend`` follows."""
    return line.startswith(b"Error:") and b"Last Line" in line


def parse_ok(answer: bytes, firmware: Firmware) -> int | None:
    """Parse the line number in an ok; negative if it has no number; None if `answer` is not an ok."""
    if answer == b"ok":
        return -1
    match = None if firmware.ok_details is None else firmware.ok_details.fullmatch(answer, 2)
    return None if match is None or not answer.startswith(b"ok") else int(match[1] or -1)


def split_answers(line: bytes, firmware: Firmware) -> list[bytes]:
    """Split a line into its answers: several if a newline was lost, or is missing as after M119."""
    if parse_ok(line, firmware) is not None:
        return [line]
    answers: list[bytes] = []
    for part in _ANSWER_STARTS.split(line):
        before, after = [], []
        if part.endswith(b"ok") and part != _CARD_OK:
            part, after = part[:-2], [b"ok"]
        if part.startswith(b"ok") and b"T:" not in part:
            before, part = [b"ok"], part[2:]
        answers += [*before, *([part] if part else []), *after]
    return answers


def parse_fault(line: bytes, firmware: Firmware) -> LinkFault | None:
    """Parse a fault that a line reports; None if it reports none."""
    fault = next((fault for mark, fault in firmware.fault_texts if mark in line), None)
    return None if fault is None else LinkFault(fault, line.decode("ascii", "replace").strip())
