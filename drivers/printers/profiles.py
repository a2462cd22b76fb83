"""Facts about each printer model, and the one function for the room that a part has on its bed.

Coordinates are bed-centred, in millimetres. Sizes and clips are those of Cura's machine definitions
(``machine_width/depth/height``, ``machine_disallowed_areas``); accelerations and feed rates are those that
the firmware prints in its banner (``M201/M203/M204/M205``). The heating figures are assumed, not measured on
a printer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations


@dataclass(frozen=True, slots=True)
class Rect:
    """An axis-aligned rectangle on the bed, in mm."""

    min_x_mm: float
    min_y_mm: float
    max_x_mm: float
    max_y_mm: float

    @property
    def width_mm(self) -> float:
        return self.max_x_mm - self.min_x_mm

    @property
    def depth_mm(self) -> float:
        return self.max_y_mm - self.min_y_mm

    def overlaps(self, other: Rect) -> bool:
        """Whether the open interiors meet."""
        return (
            self.min_x_mm < other.max_x_mm
            and other.min_x_mm < self.max_x_mm
            and self.min_y_mm < other.max_y_mm
            and other.min_y_mm < self.max_y_mm
        )

    def contains(self, other: Rect) -> bool:
        return (
            self.min_x_mm <= other.min_x_mm
            and self.min_y_mm <= other.min_y_mm
            and self.max_x_mm >= other.max_x_mm
            and self.max_y_mm >= other.max_y_mm
        )

    def grown(self, by_mm: float) -> Rect:
        return Rect(
            self.min_x_mm - by_mm, self.min_y_mm - by_mm, self.max_x_mm + by_mm, self.max_y_mm + by_mm
        )


@dataclass(frozen=True, slots=True)
class RoomBox:
    """One of the boxes that a part may fill: a rectangle of the bed and a height, in mm."""

    rect: Rect
    height_mm: float

    @property
    def size_mm(self) -> tuple[float, float, float]:
        return (self.rect.width_mm, self.rect.depth_mm, self.height_mm)


@dataclass(frozen=True, slots=True)
class HeaterModel:
    """A heater of first order: full power drives it to ``ambient + gain_c`` with time constant ``tau_s``.

    [assumed] Not measured on a printer; chosen so that nozzle and bed heat about as fast as owners report.
    """

    gain_c: float
    tau_s: float

    def seconds_to(self, target_c: float, start_c: float = 21.0, ambient_c: float = 21.0) -> float:
        """Seconds at full power from `start_c` to `target_c`; 0 where it is warmer already."""
        top_c = ambient_c + self.gain_c
        if target_c <= start_c:
            return 0.0
        if target_c >= top_c:
            return math.inf
        return self.tau_s * math.log((top_c - start_c) / (top_c - target_c))


_START_CODE = (
    "G21",
    "G90",
    "M82",
    "M107",
    "M220 S100",
    "M221 S100",
    "M140 S{bed_c:g}",
    "G28",
    "G1 F12000 X5 Y10",
    "M190 S{bed_c:g}",
    "M109 S{nozzle_c:g}",
    "G1 F2400 Z20",
    "G92 E0",
    "G1 F47 E{prime_mm:.1f}",
    "G92 E0",
    "G0 F3000 Y50",
)
_END_CODE = ("M104 S0", "M140 S0", "M107", "G91", "G1 F1500 E{park_mm:g}", "G90", "G28", "M84")


@dataclass(frozen=True, slots=True)
class Profile:
    """What is fixed for a printer model. `model` is Cura's definition id."""

    model: str
    title: str
    bed_mm: tuple[float, float]
    height_mm: float
    clips: tuple[Rect, ...]  # bounding rectangles of the areas that the definition forbids
    home_mm: tuple[float, float, float] = (0.0, 224.5, 215.0)  # firmware coordinates after G28
    max_feedrate_mm_s: tuple[float, float, float, float] = (300.0, 300.0, 40.0, 45.0)
    max_acceleration_mm_s2: tuple[float, float, float, float] = (9000.0, 9000.0, 100.0, 10000.0)
    acceleration_mm_s2: float = 3000.0
    jerk_mm_s: tuple[float, float, float] = (20.0, 0.4, 5.0)  # XY, Z, E
    nozzle: HeaterModel = HeaterModel(gain_c=380.0, tau_s=180.0)
    bed: HeaterModel = HeaterModel(gain_c=105.0, tau_s=520.0)
    max_nozzle_c: float = 260.0  # where the firmware's own menu ends
    max_bed_c: float = 115.0
    min_extrusion_c: float = 170.0  # colder, the firmware drops the filament (``EXTRUDE_MINTEMP``)
    gcode_flavor: str = "RepRap (Marlin/Sprinter)"  # Cura's name; E in mm
    start_code: tuple[str, ...] = _START_CODE  # with the fields bed_c, nozzle_c and prime_mm
    end_code: tuple[str, ...] = _END_CODE  # with the field park_mm
    ready_mm: tuple[float, float, float] = (5.0, 50.0, 20.0)  # where the start code leaves the head
    prime_mm3: float = 50.0  # the firmware's ``PRIMING_MM3``
    parked_mm: float = 20.0  # where a print leaves the filament (``END_OF_PRINT_RETRACTION``)
    head_mm: tuple[float, float, float, float] = (-44.0, 64.0, -34.0, 14.0)
    """Left, right, front and back of the head with its fans, from the nozzle: Cura's
    ``machine_head_with_fans_polygon`` of the 2+."""
    retraction_mm: float = 6.5  # of G10: Cura's figures, and the 2+ firmware's (a UM2's has 4.5 mm)
    retraction_mm_s: float = 25.0
    head_above_nozzle_mm: float = 5.0  # Cura's ``machine_nozzle_head_distance`` of the 2+
    banner_suffix: str = ""  # how the firmware's author line ends: "ex" on the Extended

    @property
    def kin(self) -> str:
        """What printers of one feeder and hot end share: G-code for one is right for all, but for height."""
        return self.model.replace("_extended", "")


_UM2_PLUS_CLIPS = (
    Rect(-115.0, 102.5, -78.0, 112.5),
    Rect(103.0, 102.5, 115.0, 112.5),
    Rect(-115.0, -112.5, -82.0, -104.5),
    Rect(108.0, -112.5, 115.0, -104.5),
)

_UM2_CLIPS = (
    Rect(-115.0, 102.5, -82.0, 112.5),
    Rect(108.0, 102.5, 115.0, 112.5),
    Rect(-115.0, -112.5, -82.0, -104.5),
    Rect(108.0, -112.5, 115.0, -104.5),
)
_GO_CLIPS = (
    Rect(-60.0, 52.0, -33.0, 60.0),
    Rect(33.0, 52.0, 60.0, 60.0),
    Rect(-60.0, -60.0, -33.0, -52.0),
    Rect(33.0, -60.0, 60.0, -52.0),
)

# The plain models have the serial code of the 2+ and another feeder, which their firmware allows for.
# That their firmware's banner tells the Extended as that of the 2+ does is [assumed].
PROFILES: dict[str, Profile] = {
    profile.model: profile
    for profile in (
        Profile("ultimaker2_plus", "Ultimaker 2+", (223.0, 223.0), 205.0, _UM2_PLUS_CLIPS),
        Profile(
            "ultimaker2_extended_plus",
            "Ultimaker 2 Extended+",
            (223.0, 223.0),
            305.0,
            _UM2_PLUS_CLIPS,
            home_mm=(0.0, 224.5, 315.0),
            banner_suffix="ex",
        ),
        Profile("ultimaker2", "Ultimaker 2", (223.0, 223.0), 205.0, _UM2_CLIPS, home_mm=(0.0, 224.5, 220.0)),
        Profile(
            "ultimaker2_extended",
            "Ultimaker 2 Extended",
            (223.0, 223.0),
            305.0,
            _UM2_CLIPS,
            home_mm=(0.0, 224.5, 320.0),
            banner_suffix="ex",
        ),
    )
}
"""The printers that can be driven."""

BEDS: dict[str, Profile] = {
    **PROFILES,
    # Its bed has no heater, which the session wants to see off; nothing is known of its firmware's answers.
    "ultimaker2_go": Profile("ultimaker2_go", "Ultimaker 2 Go", (120.0, 120.0), 115.0, _GO_CLIPS),
}
"""The printers that can be sliced for."""


def part_room(
    profile: Profile, brim_mm: float, volume_mm: tuple[float, float, float] | None = None
) -> tuple[RoomBox, ...]:
    """The boxes that a part with a brim may fill on this printer.

    A part fits when it fits one of them. They are the largest rectangles of the bed that, grown by the brim,
    stay on the bed and off the clips, each with the printer's height.

    Parameters
    ----------
    profile
        The printer model.
    brim_mm
        Width of the brim (or skirt) that is printed around the part.
    volume_mm
        A person's own limit (x, y, z) for this printer; the smaller of it and the model's counts.

    Returns
    -------
    tuple of RoomBox
        Largest first by volume; empty where the brim leaves no room.
    """
    width, depth = profile.bed_mm
    height = profile.height_mm
    if volume_mm is not None:
        width, depth, height = min(width, volume_mm[0]), min(depth, volume_mm[1]), min(height, volume_mm[2])
    bed = Rect(-width / 2, -depth / 2, width / 2, depth / 2).grown(-brim_mm)
    clips = [clip.grown(brim_mm) for clip in profile.clips]
    xs = sorted({bed.min_x_mm, bed.max_x_mm, *(x for c in clips for x in (c.min_x_mm, c.max_x_mm))})
    ys = sorted({bed.min_y_mm, bed.max_y_mm, *(y for c in clips for y in (c.min_y_mm, c.max_y_mm))})
    free = [
        rect
        for x0, x1 in combinations(xs, 2)
        for y0, y1 in combinations(ys, 2)
        if bed.contains(rect := Rect(x0, y0, x1, y1)) and not any(rect.overlaps(clip) for clip in clips)
    ]
    largest = [r for r in free if not any(o is not r and o.contains(r) for o in free)]
    largest.sort(key=lambda r: r.width_mm * r.depth_mm, reverse=True)
    return tuple(RoomBox(rect, height) for rect in largest)


FIT_TOLERANCE_MM = 1e-3
"""An STL is in single precision: a part cut to the very size of its room may read a little larger."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a part's bounding-box centre goes on the bed, and whether it is turned by 90 degrees about Z."""

    x_mm: float
    y_mm: float
    turned: bool


def place(extents_mm: tuple[float, float, float], room: tuple[RoomBox, ...]) -> Placement | None:
    """Where a part of these extents (x, y, z) goes, near the bed's centre; None where it does not fit."""
    best: tuple[float, bool, float, float] | None = None
    for box in room:
        for turned in (False, True):
            dx, dy = (extents_mm[1], extents_mm[0]) if turned else (extents_mm[0], extents_mm[1])
            slack = FIT_TOLERANCE_MM
            if dx > box.rect.width_mm + slack or dy > box.rect.depth_mm + slack:
                continue
            if extents_mm[2] > box.height_mm + slack:
                continue
            x = min(max(0.0, box.rect.min_x_mm + dx / 2), box.rect.max_x_mm - dx / 2)
            y = min(max(0.0, box.rect.min_y_mm + dy / 2), box.rect.max_y_mm - dy / 2)
            key = (math.hypot(x, y), turned, x, y)
            if best is None or key < best:
                best = key
    return None if best is None else Placement(best[2], best[3], best[1])
