"""The firmware's own words, byte for byte (docs/explanation/ultimaker2-serial.md, sections 1 and 3)."""

from __future__ import annotations

from drivers.emulator.firmware.planner import Limits
from drivers.printers import Profile

OK = b"ok\n"
START = b"start\n"
SD_FAIL = b"echo:SD init fail\n"
STOPPED = (
    b"Printer stopped due to errors. Fix the error and use M999 to restart. "
    b"(Temperature is reset. Set it after restarting)\n"
)
KILLED = b"Error:Printer halted. kill() called!\n"
NOZZLE_MAXTEMP = b"Error:0\n: Extruder switched off. MAXTEMP triggered !\n"
NOZZLE_MINTEMP = b"Error:0\n: Extruder switched off. MINTEMP triggered !\n"
BED_MAXTEMP = b"Error:Temperature heated bed switched off. MAXTEMP triggered !!\n"
NO_ENDSTOP = b"Error:Endstop not pressed after homing down. Endstop broken?\n"
STUCK_ENDSTOP = b"Error:Endstop still pressed after backing off. Endstop stuck?\n"
COLD_EXTRUSION = b"echo: cold extrusion prevented\n"
LONG_EXTRUSION = b"echo: too long extrusion prevented\n"
IDENTITY = (
    b"FIRMWARE_NAME:Marlin Ultimaker2; Sprinter/grbl mashup for gen6 "
    b"FIRMWARE_URL:http://github.com/Ultimaker PROTOCOL_VERSION:1.0 MACHINE_TYPE:Ultimaker EXTRUDER_COUNT:1\n"
)
LINE_NUMBER = b"Line Number is not Last Line Number+1"
CHECKSUM = b"checksum mismatch"
NO_CHECKSUM = b"No Checksum with line number"
NO_LINE_NUMBER = b"No Line Number with checksum"


def line_error(what: bytes, last_line: int) -> bytes:
    return b"Error:%b, Last Line: %d\n" % (what, last_line)


def unknown(line: bytes) -> bytes:
    return b'echo:Unknown command: "%b"\n' % line


def banner(profile: Profile, limits: Limits, levelled: int = 0) -> bytes:
    """Format what follows ``start`` at every boot; `levelled` as in `Faults`."""
    head = (
        "echo:Marlin 1.0.0\n"
        "echo: Last Updated: Mar 15 2018 13:04:08 | Author: Vers:_3.3.0"
        f"{profile.banner_suffix}\n"
        "Compiled: Mar 15 2018\n"
        "echo: Free Memory: 2055  PlannerBufferBytes: 1232\n"
        "echo:Stored settings retrieved\n"
    )
    return head.encode() + settings(limits, levelled)


def settings(limits: Limits, levelled: int = 0) -> bytes:
    """``M503``, and the end of the banner."""
    steps, feed, top = limits.steps_per_mm, limits.feedrate_mm_s, limits.acceleration_mm_s2
    return (
        "echo:Steps per unit:\n"
        f"echo:  M92 X{steps[0]:.2f} Y{steps[1]:.2f} Z{steps[2]:.2f} E{steps[3]:.2f}\n"
        "echo:Maximum feedrates (mm/s):\n"
        f"echo:  M203 X{feed[0]:.2f} Y{feed[1]:.2f} Z{feed[2]:.2f} E{feed[3]:.2f}\n"
        "echo:Maximum Acceleration (mm/s2):\n"
        f"echo:  M201 X{top[0]:.0f} Y{top[1]:.0f} Z{top[2]:.0f} E{top[3]:.0f}\n"
        "echo:Acceleration: S=acceleration, T=retract acceleration\n"
        f"echo:  M204 S{limits.print_mm_s2:.2f} T{limits.retract_mm_s2:.2f}\n"
        "echo:Advanced variables: S=Min feedrate (mm/s), T=Min travel feedrate (mm/s), "
        "B=minimum segment time (ms), X=maximum XY jerk (mm/s),  Z=maximum Z jerk (mm/s),  "
        "E=maximum E jerk (mm/s)\n"
        f"echo:  M205 S0.00 T0.00 B20000 X{limits.jerk_xy_mm_s:.2f} Z{limits.jerk_z_mm_s:.2f} "
        f"E{limits.jerk_e_mm_s:.2f}\n"
        "echo:Home offset (mm):\n"
        f"echo:  M206 X0.00 Y0.00 Z{-10 - levelled / 100:.2f}\n"
        "echo:PID settings:\n"
        "echo:   M301 P10.03 I1.50 D70.00\n"
    ).encode()
