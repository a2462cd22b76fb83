"""What goes wrong on request: named faults, and the dice that they are drawn from.

A new fault is a field of `Faults` (its name is its name in the url) and one place that asks for it: `Dice`
for what happens to lines, `Board` for what is broken physically, `Firmware` for what the board does by
itself.
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import dataclass, fields
from urllib.parse import parse_qsl, urlsplit

from drivers.errors import PortError
from drivers.profiles import PROFILES, Profile


@dataclass(frozen=True, slots=True)
class Faults:
    """Everything that may be asked for; the default is a printer in good health.

    Counts are of lines that the firmware accepted since power on; each of them happens once.
    """

    checksum: float = 0.0  # probability that a byte of a received line is flipped
    drop_ok: float = 0.0  # probability that an ok is lost on its way to the host
    reset_after: int = 0  # the board resets by itself (brown-out)
    stop_after: int = 0  # the nozzle's sensor opens: MAXTEMP, and the firmware stops
    silent_after: int = 0  # the board hears and says nothing more until it is reset; its heaters stay on
    dead_nozzle: bool = False  # the element gives no heat
    dead_bed: bool = False
    wire: bool = False  # not a fault: bytes take the time that 250000 baud cost

    @property
    def on_lines(self) -> bool:
        """Whether every single line has to be looked at."""
        return bool(self.checksum or self.drop_ok or self.reset_after or self.stop_after or self.silent_after)


class Dice:
    """The faults that are drawn, from a generator of their own."""

    def __init__(self, faults: Faults, rng: random.Random) -> None:
        self._faults = faults
        self._rng = rng

    def disturb(self, line: bytes) -> bytes:
        """The line as it arrives: as sent, or with one bit of one byte flipped."""
        if line and self._faults.checksum and self._rng.random() < self._faults.checksum:
            at = self._rng.randrange(len(line))
            flipped = line[at] ^ (1 << self._rng.randrange(7))
            return line[:at] + bytes((flipped,)) + line[at + 1 :]
        return line

    def ok_is_lost(self) -> bool:
        return bool(self._faults.drop_ok) and self._rng.random() < self._faults.drop_ok


@dataclass(frozen=True, slots=True)
class SimUrl:
    """A port that is an emulator: ``sim://MODEL?checksum=0.01&dead_bed=1&seed=7``.

    ``fault=NAME`` and ``fault=NAME:VALUE`` (comma-separated) say the same as ``NAME=1`` and ``NAME=VALUE``.
    """

    profile: Profile
    faults: Faults
    seed: int
    words: tuple[str, ...]  # the faults as NAME=VALUE, for a command line


def parse_url(url: str) -> SimUrl:
    """Read a ``sim://`` url.

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
    words: list[str] = []
    seed = 0
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        if key == "seed":
            try:
                seed = int(value)
            except ValueError:
                raise PortError(f"{url}: seed {value!r} is not a whole number") from None
        elif key == "fault":
            words += [word.replace(":", "=", 1) for word in value.split(",") if word]
        else:
            words.append(f"{key}={value}")
    return SimUrl(profile, parse_faults(words, url), seed, tuple(words))


_KINDS: dict[str, type[float] | type[int] | type[bool]] = {"float": float, "int": int, "bool": bool}


def parse_faults(words: Iterable[str], where: str = "--fault") -> Faults:
    """Faults from words ``NAME`` or ``NAME=VALUE``; raises PortError as `parse_url` does."""
    kinds = {field.name: _KINDS[str(field.type)] for field in fields(Faults)}
    chosen: dict[str, float | int | bool] = {}
    for word in words:
        name, _, value = word.partition("=")
        kind = kinds.get(name)
        if kind is None:
            raise PortError(f"{where}: no fault {name!r}; use one of {', '.join(sorted(kinds))}")
        try:
            number = float(value or "1")
        except ValueError:
            raise PortError(f"{where}: {name} needs a number, not {value!r}") from None
        if number < 0 or (kind is float and number > 1) or (kind is int and number != int(number)):
            wanted = "a probability from 0 to 1" if kind is float else "a whole number from 0"
            raise PortError(f"{where}: {name} needs {wanted}, not {value!r}")
        chosen[name] = kind(number)
    return Faults(**chosen)  # type: ignore[arg-type]
