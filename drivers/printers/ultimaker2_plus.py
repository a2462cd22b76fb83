"""The Ultimaker 2+; the other models of its family are variants. Pure."""

from __future__ import annotations

from drivers.firmware import ULTIMAKER2 as FIRMWARE
from drivers.printers.profile import HeaterModel, Profile, Rect

ULTIMAKER2_PLUS = Profile(
    model="ultimaker2_plus",
    family="ultimaker2_plus",
    title="Ultimaker 2+",
    slicer_names=r"\b(um|ultimaker)[\s_-]*2[\s_-]*(e|extended)?[\s_-]*(\+|plus)\s*\Z",
    firmware=FIRMWARE,
    bed_mm=(223.0, 223.0),
    height_mm=205.0,
    clips=(
        Rect(-115.0, 102.5, -78.0, 112.5),
        Rect(103.0, 102.5, 115.0, 112.5),
        Rect(-115.0, -112.5, -82.0, -104.5),
        Rect(108.0, -112.5, 115.0, -104.5),
    ),
    home_mm=(0.0, 224.5, 215.0),
    max_position_mm=(230.0, 224.5, 225.0),
    steps_per_mm=(80.0, 80.0, 200.0, 369.0),
    max_feedrate_mm_s=(300.0, 300.0, 40.0, 45.0),
    max_acceleration_mm_s2=(9000.0, 9000.0, 100.0, 10000.0),
    acceleration_mm_s2=3000.0,
    jerk_mm_s=(20.0, 0.4, 5.0),
    nozzle=HeaterModel(gain_c=380.0, tau_s=180.0),
    bed=HeaterModel(gain_c=105.0, tau_s=520.0),
    max_nozzle_c=260.0,  # limit of the firmware's own menu; the firmware stops above 275
    max_bed_c=115.0,  # the firmware stops above 130
    min_extrusion_c=170.0,  # ``EXTRUDE_MINTEMP``
    gcode_flavor="RepRap (Marlin/Sprinter)",
    start_code=(
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
    ),
    end_code=("M104 S0", "M140 S0", "M107", "G91", "G1 F1500 E{park_mm:g}", "G90", "G28", "M84"),
    start_position_mm=(5.0, 50.0, 20.0),
    prime_mm3=50.0,  # the firmware's ``PRIMING_MM3``
    park_retraction_mm=20.0,  # ``END_OF_PRINT_RETRACTION``
    pause_xy_mm=(10.0, 200.0),  # docs/explanation/ultimaker2-serial.md, section 5
    head_extent_mm=(-44.0, 64.0, -34.0, 14.0),  # Cura's ``machine_head_with_fans_polygon``
    retraction_mm=6.5,  # length and speed in Cura and in the firmware
    retraction_mm_s=25.0,
    head_above_nozzle_mm=5.0,
    leave_code=(b"G28 Z0", b"G28 X0 Y0"),  # lower the bed to its endstop before the head moves
)
