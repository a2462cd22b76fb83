"""Status of an emulator for others: `status.json` in its folder, never half written."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from drivers.errors import PortError

FILE = "status.json"


@dataclass(frozen=True, slots=True)
class EmulatorStatus:
    """One look at the printer. Times are farm seconds; counts are since power on.

    Attributes
    ----------
    tty
        The pty's slave at this time; `tty` in the folder points to it.
    link_open
        Whether a host has the port open.
    phase
        What the board's processor does (`firmware.Phase`).
    time_s
        Farm time of this look, seconds since the epoch.
    position_mm
        Where the head really is (x, y, z).
    filament_mm
        Net filament through the feeder.
    filament_end_mm
        The filament's end relative to the nozzle: -20 parked, 0 at the nozzle.
    starved_s
        How long the planner stood empty in a print for want of a line, beyond what a real wire costs.
    errors
        `Error` lines said.
    resets
        Boots of the board after the one at power on, an opened port's included.
    printing_s
        How long head or feeder moved, by moves that ended.
    damaged
        Bytes that a bad wire changed, both ways.
    altered
        Lines that were carried out otherwise than they were sent, as their checksums matched.
    """

    pid: int
    model: str
    tty: str
    link_open: bool
    phase: str
    time_s: float
    nozzle_c: float
    nozzle_target_c: float
    bed_c: float
    bed_target_c: float
    position_mm: tuple[float, float, float]
    homed: bool
    filament_mm: float
    filament_end_mm: float
    bed_clear: bool
    starved_s: float
    moves: int
    lines: int
    errors: int
    resets: int
    printing_s: float
    damaged: int = 0
    altered: int = 0


def write_status(folder: Path, status: EmulatorStatus) -> None:
    """Put the status in place in one step."""
    spare = folder / f".{FILE}.new"
    spare.write_text(json.dumps(asdict(status)))
    spare.replace(folder / FILE)


def read_status(folder: Path) -> EmulatorStatus:
    """The last status of the emulator of this folder, which may have ended since.

    Raises
    ------
    PortError
        There is none, or it is not one of ours.
    """
    path = folder / FILE
    try:
        raw = json.loads(path.read_text())
        raw["position_mm"] = tuple(raw["position_mm"])
        known = {field.name for field in fields(EmulatorStatus)}
        return EmulatorStatus(**{name: value for name, value in raw.items() if name in known})
    except FileNotFoundError:
        raise PortError(f"{path}: no emulator has run here; start one with launch()") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PortError(f"{path}: not an emulator's status ({error}); stop it and start it again") from None
