"""The record that describes one printer model. Pure.

Rectangles are relative to the centre of the bed; positions are in the firmware's coordinates. Sizes and clips
are those of Cura's machine definitions (``machine_width/depth/height``, ``machine_disallowed_areas``);
accelerations and feed rates are those that the firmware prints in its banner (``M201/M203/M204/M205``). The
heating figures are [assumed], not measured on a printer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.firmware import Firmware


@dataclass(frozen=True, slots=True)
class Rect:
    """An axis-aligned rectangle on the bed, in mm."""

    min_x_mm: float
    min_y_mm: float
    max_x_mm: float
    max_y_mm: float

    @property
    def width_mm(self) -> float:
        """Size along X."""
        return self.max_x_mm - self.min_x_mm

    @property
    def depth_mm(self) -> float:
        """Size along Y."""
        return self.max_y_mm - self.min_y_mm

    def overlaps(self, other: Rect) -> bool:
        """Return True if the interiors intersect; shared edges do not count."""
        return (
            self.min_x_mm < other.max_x_mm
            and other.min_x_mm < self.max_x_mm
            and self.min_y_mm < other.max_y_mm
            and other.min_y_mm < self.max_y_mm
        )

    def contains(self, other: Rect) -> bool:
        """Return True if the other rectangle is within this one, edges included."""
        return (
            self.min_x_mm <= other.min_x_mm
            and self.min_y_mm <= other.min_y_mm
            and self.max_x_mm >= other.max_x_mm
            and self.max_y_mm >= other.max_y_mm
        )

    def expand(self, margin_mm: float) -> Rect:
        """Return the rectangle with all edges moved outwards; a negative margin moves them inwards."""
        return Rect(
            self.min_x_mm - margin_mm,
            self.min_y_mm - margin_mm,
            self.max_x_mm + margin_mm,
            self.max_y_mm + margin_mm,
        )


@dataclass(frozen=True, slots=True)
class HeaterModel:
    """First-order model: full power heats to ``ambient + gain_c`` with the time constant ``tau_s``.

    [assumed] Not measured on a printer; chosen so that nozzle and bed heat about as fast as owners report.
    """

    gain_c: float
    tau_s: float

    def compute_heating_s(self, target_c: float, start_c: float = 21.0, ambient_c: float = 21.0) -> float:
        """Compute the seconds at full power from `start_c` to `target_c`; 0 if `target_c` is not higher."""
        top_c = ambient_c + self.gain_c
        if target_c <= start_c:
            return 0.0
        if target_c >= top_c:
            return math.inf
        return self.tau_s * math.log((top_c - start_c) / (top_c - target_c))


@dataclass(frozen=True, slots=True)
class Profile:
    """Properties of a printer model.

    Attributes
    ----------
    model
        Cura's definition id.
    family
        Model with the same feeder and hot end; its G-code also suits this model, except for the height.
    title
        Name in messages.
    slicer_names
        Pattern of the names that slicers use for the model, in lower case.
    firmware
        The model's firmware.
    bed_mm, height_mm
        The build volume.
    clips
        Bounding rectangles of the areas that the definition forbids.
    home_mm
        Firmware coordinates after G28.
    max_position_mm
        Largest coordinates that the firmware allows: X, Y, Z.
    steps_per_mm, max_feedrate_mm_s, max_acceleration_mm_s2
        Motor steps and limits of X, Y, Z and E.
    acceleration_mm_s2
        Acceleration of printing moves.
    jerk_mm_s
        Jerk of XY, Z and E.
    nozzle, bed
        Models of the two heaters.
    max_nozzle_c, max_bed_c
        Highest temperatures that a file may set.
    min_extrusion_c
        Nozzle temperature below which the firmware ignores extrusion.
    gcode_flavor
        Cura's name of the G-code flavour, in which E is in mm.
    start_code, end_code
        Templates: the start code has the fields `bed_c`, `nozzle_c` and `prime_mm`, the end code `park_mm`.
    start_position_mm
        Position of the head after the start code.
    prime_mm3
        Volume that the start code extrudes.
    park_retraction_mm
        Retraction of the filament after a print, even one that was started at the printer's menu.
    pause_xy_mm
        Position of the head in a pause: X and Y.
    head_extent_mm
        Extent of the head with its fans, relative to the nozzle: left, right, front, back.
    retraction_mm, retraction_mm_s
        Length and speed of G10.
    head_above_nozzle_mm
        Cura's ``machine_nozzle_head_distance``.
    leave_code
        Moves away from a part after a reset during a print, when the position is unknown; empty if they might
        hit the part.
    banner_suffix
        Suffix of the firmware's version in the banner.
    machine_text
        Text in the answer to `Firmware.identity_query`.
    """

    model: str
    family: str
    title: str
    slicer_names: str
    firmware: Firmware
    bed_mm: tuple[float, float]
    height_mm: float
    clips: tuple[Rect, ...]
    home_mm: tuple[float, float, float]
    max_position_mm: tuple[float, float, float]
    steps_per_mm: tuple[float, float, float, float]
    max_feedrate_mm_s: tuple[float, float, float, float]
    max_acceleration_mm_s2: tuple[float, float, float, float]
    acceleration_mm_s2: float
    jerk_mm_s: tuple[float, float, float]
    nozzle: HeaterModel
    bed: HeaterModel
    max_nozzle_c: float
    max_bed_c: float
    min_extrusion_c: float
    gcode_flavor: str
    start_code: tuple[str, ...]
    end_code: tuple[str, ...]
    start_position_mm: tuple[float, float, float]
    prime_mm3: float
    park_retraction_mm: float
    pause_xy_mm: tuple[float, float]
    head_extent_mm: tuple[float, float, float, float]
    retraction_mm: float
    retraction_mm_s: float
    head_above_nozzle_mm: float
    leave_code: tuple[bytes, ...]
    banner_suffix: str = ""
    machine_text: bytes = b""

    @property
    def top_mm(self) -> float:
        """Highest Z at which the head may wait: the Z endstop, if it is at the top."""
        return max(self.home_mm[2], self.height_mm)
