"""Faults to inject, by name, and the sampler that decides at random when they happen.

A new fault needs a field of `Faults`, named as in the url, and code that applies it: in `FaultSampler` for
faults of lines, in `EmulatedBoard` for physical faults, in `EmulatedFirmware` for faults of the board's
program.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterable
from dataclasses import dataclass, fields
from urllib.parse import parse_qsl, urlsplit

from drivers.errors import PortError
from drivers.printers import PROFILES, Profile


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults to inject; the default is a printer without faults.

    ``*_after`` is the number of lines, accepted since power-on, after which a fault happens once.
    """

    # on the wire, in both directions; probabilities per byte
    noise: float = 0.0  # one bit of the byte is flipped
    lost: float = 0.0
    doubled: float = 0.0
    bytewise: bool = False  # the board sends its answers two bytes at a time
    wire: bool = False  # not a fault: bytes arrive after their transmission time at the port's baud rate
    slowdown: bool = False  # not a fault: short moves are slowed down while few are queued
    # when lines are read or answered; probabilities per line
    checksum: float = 0.0  # one bit of a received line is flipped
    no_number: float = 0.0  # a received line lacks its number, and is refused without a Resend
    no_checksum: float = 0.0  # a received line lacks its checksum
    wrong_number: float = 0.0  # a received line has the number of the one before
    drop_ok: float = 0.0  # an ok is lost on its way to the host
    garble_ok: float = 0.0  # an ok arrives garbled
    swallow: float = 0.0  # a line is neither executed nor answered
    resend: float = 0.0  # a correct line is refused
    mute_resend: bool = False  # Resend is sent without its ok
    # in the board's processor
    reset_after: int = 0  # resets (brown-out)
    silent_after: int = 0  # reads and sends nothing until it is reset; its heaters stay on
    sleep_after: int = 0  # does nothing for `SLEEP_DURATION_S`, and then continues
    stuck_after: int = 0  # requests the same line endlessly
    kill_after: int = 0  # calls kill(), as when its dead-man timer expires
    zero_after: int = 0  # silently sets the nozzle's target to 0
    # heaters and sensors
    dead_nozzle: bool = False  # the heating element produces no heat
    dead_bed: bool = False
    weak_nozzle: bool = False  # gets no warmer than `WEAK_NOZZLE_C`
    weak_bed: bool = False  # gets no warmer than `WEAK_BED_C`
    nozzle_dies_after: int = 0
    bed_dies_after: int = 0
    nozzle_burns_after: int = 0  # its MOSFET is shorted: full power at any target
    bed_burns_after: int = 0
    stop_after: int = 0  # the nozzle's sensor is open: the firmware reports MAXTEMP and stops
    nozzle_short_after: int = 0  # the nozzle's sensor is shorted: MINTEMP
    bed_open_after: int = 0  # the bed's sensor is open: MAXTEMP
    bed_short_after: int = 0  # the bed's sensor is shorted: reads cold, without an error
    # endstops
    no_endstop: int = 0  # 1, 2 or 3: the endstop of X, Y or Z is never pressed
    stuck_endstop: bool = False  # the endstop of Z stays pressed
    # between host and board
    no_reset: bool = False  # DTR is not connected: neither opening the port nor a pulse resets the board
    # not faults: an option of some firmwares, and a difference between two printers
    advanced_ok: bool = False  # an ok has the line number and the free space of both buffers
    home_offset_hundredths_mm: int = (
        0  # distance by which the reported home offset of Z (M206) is below its usual value
    )

    @property
    def affects_lines(self) -> bool:
        """True if a fault may act on a line."""
        probabilities = (
            self.checksum, self.no_number, self.no_checksum, self.wrong_number,
            self.drop_ok, self.garble_ok, self.swallow, self.resend,
        )  # fmt: skip
        return bool(any(probabilities) or self.stuck_after or self.line_counts)

    @property
    def affects_bytes(self) -> bool:
        """True if a fault may act on a byte."""
        return bool(self.noise or self.lost or self.doubled)

    @property
    def line_counts(self) -> dict[str, int]:
        """Line counts of the faults that happen once, by name."""
        fields_and_values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: line for name, line in fields_and_values if name.endswith("_after") and line}


SLEEP_DURATION_S = 25.0  # duration of `Faults.sleep_after`
_NUMBER = re.compile(rb"N(\d+) ?")
WEAK_NOZZLE_C, WEAK_BED_C = 140.0, 45.0


COUNTED_FAULTS = tuple(field.name for field in fields(Faults) if field.name.endswith("_after"))


class FaultSampler:
    """Sampler of random faults, with its own generator."""

    def __init__(self, faults: Faults, rng: random.Random) -> None:
        self._faults = faults
        self._rng = rng

    def disturb_line(self, line: bytes) -> bytes:
        """Return the line as received: unchanged, or with a flipped bit, a wrong number or a missing part."""
        faults = self._faults
        if b"M110" not in line:
            if faults.no_number and self._rng.random() < faults.no_number:
                return _NUMBER.sub(b"", line, count=1)
            if faults.no_checksum and self._rng.random() < faults.no_checksum:
                return line.partition(b"*")[0]
            if faults.wrong_number and self._rng.random() < faults.wrong_number:
                return _NUMBER.sub(lambda n: b"N%d " % (int(n[1]) - 1), line, count=1)
        if line and faults.checksum and self._rng.random() < faults.checksum:
            index = self._rng.randrange(len(line))
            flipped_byte = line[index] ^ (1 << self._rng.randrange(7))
            return line[:index] + bytes((flipped_byte,)) + line[index + 1 :]
        return line

    def garble_ok(self, text: bytes) -> bytes:
        """Return an ok as sent: unchanged, empty, or with another first letter."""
        faults = self._faults
        if faults.drop_ok and self._rng.random() < faults.drop_ok:
            return b""
        if faults.garble_ok and self._rng.random() < faults.garble_ok:
            return bytes((text[0] ^ 1 << self._rng.randrange(6),)) + text[1:]
        return text

    def swallows_line(self) -> bool:
        """Decide at random whether a received line is neither executed nor answered."""
        return bool(self._faults.swallow) and self._rng.random() < self._faults.swallow

    def refuses_line(self) -> bool:
        """Decide at random whether a correct line is refused."""
        return bool(self._faults.resend) and self._rng.random() < self._faults.resend


@dataclass(frozen=True, slots=True)
class SimUrl:
    """Url of an emulated printer: ``sim://MODEL?checksum=0.01&dead_bed=1&seed=7``.

    ``fault=NAME`` and ``fault=NAME:VALUE`` (comma-separated) mean ``NAME=1`` and ``NAME=VALUE``.
    """

    profile: Profile
    faults: Faults
    seed: int
    fault_arguments: tuple[str, ...]  # the faults as NAME=VALUE, for a command line


def parse_url(url: str) -> SimUrl:
    """Parse a ``sim://`` url.

    Raises
    ------
    PortError
        The model or a fault is not known, or a value is not a number.
    """
    parts = urlsplit(url)
    if parts.scheme != "sim":
        raise PortError(
            f"{url}: not an emulator's url; write sim://MODEL, for instance sim://ultimaker2_plus"
        )
    profile = PROFILES.get(parts.netloc)
    if profile is None:
        raise PortError(f"{url}: no printer model {parts.netloc!r}; use one of {', '.join(sorted(PROFILES))}")
    fault_arguments: list[str] = []
    seed = 0
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        if key == "seed":
            try:
                seed = int(value)
            except ValueError:
                raise PortError(f"{url}: seed {value!r} is not a whole number") from None
        elif key == "fault":
            fault_arguments += [word.replace(":", "=", 1) for word in value.split(",") if word]
        else:
            fault_arguments.append(f"{key}={value}")
    return SimUrl(profile, parse_faults(fault_arguments, url), seed, tuple(fault_arguments))


_TYPES_BY_NAME: dict[str, type[float] | type[int] | type[bool]] = {"float": float, "int": int, "bool": bool}


def parse_faults(fault_arguments: Iterable[str], source: str = "--fault") -> Faults:
    """Parse faults of the form ``NAME`` or ``NAME=VALUE``. Raises PortError as `parse_url` does."""
    types = {field.name: _TYPES_BY_NAME[str(field.type)] for field in fields(Faults)}
    values: dict[str, float | int | bool] = {}
    for argument in fault_arguments:
        name, _, value = argument.partition("=")
        value_type = types.get(name)
        if value_type is None:
            raise PortError(f"{source}: no fault {name!r}; use one of {', '.join(sorted(types))}")
        try:
            number = float(value or "1")
        except ValueError:
            raise PortError(f"{source}: {name} needs a number, not {value!r}") from None
        if (
            number < 0
            or (value_type is float and number > 1)
            or (value_type is int and number != int(number))
        ):
            expected_value = "a probability from 0 to 1" if value_type is float else "a whole number from 0"
            raise PortError(f"{source}: {name} needs {expected_value}, not {value!r}")
        values[name] = value_type(number)
    return Faults(**values)  # type: ignore[arg-type]
