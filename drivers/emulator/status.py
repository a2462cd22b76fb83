"""Status of an emulator: `status.json` in its folder, replaced in one step."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from drivers.errors import PortError

STATUS_FILE = "status.json"
# Names in the file, by field.
_JSON_NAMES = {"starvation_s": "starved_s", "damaged_byte_count": "damaged", "altered_line_count": "altered"}


@dataclass(frozen=True, slots=True)
class EmulatorStatus:
    """State of the printer at one moment. Times are farm seconds; counts are since power-on.

    Attributes
    ----------
    tty
        Device file of the pty's slave at this time; the link `tty` in the folder points to it.
    link_open
        True while a host has the port open.
    phase
        Phase of the board's processor (`firmware.Phase`).
    time_s
        Farm time of this status, in seconds since the epoch.
    position_mm
        True position of the head (x, y, z).
    filament_mm
        Net filament through the feeder.
    filament_end_mm
        Position of the filament's tip relative to the nozzle's tip; negative if it is retracted.
    starvation_s
        Seconds of a print in which the planner was empty for lack of lines, minus the transmission time.
    errors
        Number of `Error` lines sent.
    resets
        Number of resets since power-on, including those caused by opening the port.
    printing_s
        Total duration of the finished moves, in seconds.
    damaged_byte_count
        Number of bytes that noise changed, in both directions.
    altered_line_count
        Number of lines executed although they were changed, because their checksums matched.
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
    starvation_s: float
    moves: int
    lines: int
    errors: int
    resets: int
    printing_s: float
    damaged_byte_count: int = 0
    altered_line_count: int = 0


def write_status(folder: Path, status: EmulatorStatus) -> None:
    """Replace the status file in one step."""
    temporary = folder / f".{STATUS_FILE}.new"
    values = {_JSON_NAMES.get(name, name): value for name, value in asdict(status).items()}
    temporary.write_text(json.dumps(values))
    temporary.replace(folder / STATUS_FILE)


def read_status(folder: Path) -> EmulatorStatus:
    """Read the last status of this folder's emulator, which may have ended since.

    Raises
    ------
    PortError
        The file is missing or not a status of an emulator.
    """
    path = folder / STATUS_FILE
    try:
        raw = json.loads(path.read_text())
        raw["position_mm"] = tuple(raw["position_mm"])
        names = {_JSON_NAMES.get(field.name, field.name): field.name for field in fields(EmulatorStatus)}
        return EmulatorStatus(**{names[name]: value for name, value in raw.items() if name in names})
    except FileNotFoundError:
        raise PortError(f"{path}: no emulator has run here; start one with launch()") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PortError(f"{path}: not an emulator's status ({error}); stop it and start it again") from None
