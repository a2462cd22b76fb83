"""Behaviour and exact messages of the Ultimaker 2 (docs/explanation/ultimaker2-serial.md). Pure."""

from __future__ import annotations

from drivers.emulator.firmware.commands import (
    SHARED_G,
    SHARED_M,
    Commands,
    beep,
    park,
    retract,
    set_axis_mode,
    stop_moves,
)
from drivers.emulator.firmware.dialects.dialect import Dialect
from drivers.emulator.firmware.machine import Machine
from drivers.emulator.firmware.planner import Limits
from drivers.emulator.firmware.reports import format_temperatures, report_endstops, report_position
from drivers.emulator.firmware.wording import FaultMessages
from drivers.printers import Profile

IDENTITY = (
    b"FIRMWARE_NAME:Marlin Ultimaker2; Sprinter/grbl mashup for gen6 "
    b"FIRMWARE_URL:http://github.com/Ultimaker PROTOCOL_VERSION:1.0 MACHINE_TYPE:Ultimaker EXTRUDER_COUNT:1\n"
)


def format_banner(profile: Profile, limits: Limits, home_offset_hundredths_mm: int = 0) -> bytes:
    """Format the text after ``start`` at every boot; `home_offset_hundredths_mm` as in `Faults`."""
    head = (
        "echo:Marlin 1.0.0\n"
        "echo: Last Updated: Mar 15 2018 13:04:08 | Author: Vers:_3.3.0"
        f"{profile.banner_suffix}\n"
        "Compiled: Mar 15 2018\n"
        "echo: Free Memory: 2055  PlannerBufferBytes: 1232\n"
        "echo:Stored settings retrieved\n"
    )
    return head.encode() + format_settings(limits, home_offset_hundredths_mm)


def format_settings(limits: Limits, home_offset_hundredths_mm: int = 0) -> bytes:
    """Format the answer to ``M503``, which also ends the banner."""
    steps, feed, accel = limits.steps_per_mm, limits.feedrate_mm_s, limits.acceleration_mm_s2
    return (
        "echo:Steps per unit:\n"
        f"echo:  M92 X{steps[0]:.2f} Y{steps[1]:.2f} Z{steps[2]:.2f} E{steps[3]:.2f}\n"
        "echo:Maximum feedrates (mm/s):\n"
        f"echo:  M203 X{feed[0]:.2f} Y{feed[1]:.2f} Z{feed[2]:.2f} E{feed[3]:.2f}\n"
        "echo:Maximum Acceleration (mm/s2):\n"
        f"echo:  M201 X{accel[0]:.0f} Y{accel[1]:.0f} Z{accel[2]:.0f} E{accel[3]:.0f}\n"
        "echo:Acceleration: S=acceleration, T=retract acceleration\n"
        f"echo:  M204 S{limits.print_acceleration_mm_s2:.2f} T{limits.retract_acceleration_mm_s2:.2f}\n"
        "echo:Advanced variables: S=Min feedrate (mm/s), T=Min travel feedrate (mm/s), "
        "B=minimum segment time (ms), X=maximum XY jerk (mm/s),  Z=maximum Z jerk (mm/s),  "
        "E=maximum E jerk (mm/s)\n"
        f"echo:  M205 S0.00 T0.00 B20000 X{limits.jerk_xy_mm_s:.2f} Z{limits.jerk_z_mm_s:.2f} "
        f"E{limits.jerk_e_mm_s:.2f}\n"
        "echo:Home offset (mm):\n"
        f"echo:  M206 X0.00 Y0.00 Z{-10 - home_offset_hundredths_mm / 100:.2f}\n"
        "echo:PID settings:\n"
        "echo:   M301 P10.03 I1.50 D70.00\n"
    ).encode()


def identify(machine: Machine, line: bytes, now_s: float) -> None:
    """Answer ``M115``."""
    machine.send(IDENTITY)


def report_settings(machine: Machine, line: bytes, now_s: float) -> None:
    """Answer ``M503``."""
    machine.send(format_settings(machine.limits, machine.board.faults.home_offset_hundredths_mm))


ULTIMAKER2 = Dialect(
    # Codes without effect here (fan, light, SD card, text) and unknown ones: plain ok.
    commands=Commands(
        g={
            **SHARED_G,
            10: retract,
            11: retract,
            90: set_axis_mode,
            91: set_axis_mode,
        },
        m={
            **SHARED_M,
            114: report_position,
            115: identify,
            119: report_endstops,
            300: beep,
            401: stop_moves,
            503: report_settings,
            601: park,
        },
    ),
    fault_messages=FaultMessages(
        nozzle_maxtemp=b"Error:0\n: Extruder switched off. MAXTEMP triggered !\n",
        nozzle_mintemp=b"Error:0\n: Extruder switched off. MINTEMP triggered !\n",
        bed_maxtemp=b"Error:Temperature heated bed switched off. MAXTEMP triggered !!\n",
        dead_heater=b"",
        no_endstop=b"Error:Endstop not pressed after homing down. Endstop broken?\n",
        stuck_endstop=b"Error:Endstop still pressed after backing off. Endstop stuck?\n",
    ),
    urgent_commands={},
    format_banner=format_banner,
    late_banner=b"echo:SD init fail\n",
    format_report=format_temperatures,
    buffer_lines=8,
    line_ends=b"\n\r:",
    comment_spans_lines=True,
    checksum_needs_number=True,
    reads_while_busy=False,
    acknowledges_read_moves=True,
    advanced_ok=False,
    busy_message=b"",
    find_inactivity_start_s=lambda machine: machine.last_command_at_s,
    halts=False,
)
