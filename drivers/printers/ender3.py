"""The Creality Ender-3 with Marlin 2. Pure.

Bed, height, clips and head are from Cura's definition; rates, steps and the machine name are from Marlin's
example configuration (config/examples/Creality/Ender-3). All other values are [assumed], as nothing was
tested on a real printer.
"""

from __future__ import annotations

from drivers.firmware import MARLIN2
from drivers.printers.profile import HeaterModel, Profile, Rect

ENDER3 = Profile(
    model="creality_ender3",
    family="creality_ender3",
    title="Creality Ender-3",
    slicer_names=r"\b(creality )?ender[\s_-]*3\s*\Z",
    firmware=MARLIN2,
    machine_text=b"MACHINE_TYPE:Ender-3 EXTRUDER",  # not an Ender-3 V2, which has another bed
    bed_mm=(235.0, 235.0),
    height_mm=250.0,
    clips=(Rect(-117.5, 108.0, 117.5, 117.5), Rect(-117.5, -117.5, 117.5, -108.0)),
    home_mm=(0.0, 0.0, 0.0),
    max_position_mm=(235.0, 235.0, 250.0),
    steps_per_mm=(80.0, 80.0, 400.0, 93.0),
    max_feedrate_mm_s=(500.0, 500.0, 5.0, 25.0),
    max_acceleration_mm_s2=(500.0, 500.0, 100.0, 5000.0),
    acceleration_mm_s2=500.0,
    jerk_mm_s=(10.0, 0.3, 5.0),
    nozzle=HeaterModel(gain_c=320.0, tau_s=170.0),
    bed=HeaterModel(gain_c=90.0, tau_s=480.0),
    max_nozzle_c=250.0,  # the PTFE tube reaches into the hot end; the firmware stops above 275
    max_bed_c=100.0,  # the firmware stops above 125
    min_extrusion_c=170.0,
    gcode_flavor="RepRap (Marlin/Sprinter)",
    # The code heats before it homes, as the motors are released after 2 minutes without a move.
    start_code=(
        "G21",
        "G90",
        "M82",
        "M107",
        "M220 S100",
        "M221 S100",
        "M140 S{bed_c:g}",
        "M190 S{bed_c:g}",
        "M109 S{nozzle_c:g}",
        "G28",
        "G1 F300 Z15",
        "G1 F6000 X5 Y5",
        "G92 E0",
        "G1 F120 E{prime_mm:.1f}",
        "G92 E0",
        "G0 F6000 Y30",
    ),
    end_code=(
        "M104 S0",
        "M140 S0",
        "M107",
        "G91",
        "G1 F1500 E{park_mm:g}",
        "G1 F300 Z10",
        "G90",
        "G28 X0",
        "G1 F6000 Y220",
        "M84",
    ),
    start_position_mm=(5.0, 30.0, 15.0),
    prime_mm3=30.0,
    park_retraction_mm=8.0,
    pause_xy_mm=(5.0, 220.0),
    head_extent_mm=(-26.0, 32.0, -32.0, 34.0),
    retraction_mm=5.0,
    retraction_mm_s=25.0,
    head_above_nozzle_mm=3.0,
    leave_code=(),  # Z homes towards the bed, and would hit the part
)
