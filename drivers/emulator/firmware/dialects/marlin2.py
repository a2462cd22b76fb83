"""Behaviour and messages of Marlin 2 (gcode/queue.cpp, gcode/gcode.cpp, MarlinCore.cpp). Pure.

A command is acknowledged after execution, and a move once it is in the planner; until then, the firmware
reads up to four lines ahead. A fault ends in ``kill()``, and the board then needs a reset.
"""

from __future__ import annotations

import math
from functools import partial

from drivers.emulator.firmware.commands import (
    SHARED_G,
    SHARED_M,
    Commands,
    ResumeTimes,
)
from drivers.emulator.firmware.dialects.dialect import Dialect
from drivers.emulator.firmware.machine import Machine, read_value
from drivers.emulator.firmware.planner import Limits
from drivers.emulator.firmware.reports import format_temperatures
from drivers.emulator.firmware.wording import FaultMessages
from drivers.printers import Profile

CLEANING_DURATION_S = 1.0  # ``Planner::quick_stop`` drops all moves during this time
_IDENTITY = (
    b"FIRMWARE_NAME:Marlin 2.0.9.1 (Jul  1 2021 12:00:00) SOURCE_CODE_URL:github.com/MarlinFirmware/Marlin "
    b"PROTOCOL_VERSION:1.0 %b_COUNT:1 UUID:cede2a2f-41a2-4748-9b12-c55c62f367ff\n"
    b"Cap:EEPROM:1\nCap:AUTOREPORT_TEMP:1\nCap:EMERGENCY_PARSER:0\nCap:THERMAL_PROTECTION:1\n"
)


def format_banner(profile: Profile, limits: Limits, home_offset_hundredths_mm: int = 0) -> bytes:
    """Format the text after ``start`` at every boot; `home_offset_hundredths_mm` as in `Faults`."""
    head = (
        b"echo:Marlin 2.0.9.1\n"
        b"echo: Last Updated: 2021-07-01 | Author: (none, default config)\n"
        b"echo:Compiled: Jul  1 2021\n"
        b"echo: Free Memory: 2417  PlannerBufferBytes: 1344\n"
        b"echo:V83 stored settings retrieved (583 bytes; crc 51963)\n"
    )
    return head + format_settings(limits, home_offset_hundredths_mm)


def format_settings(limits: Limits, home_offset_hundredths_mm: int = 0) -> bytes:
    """Format the answer to ``M503``, also sent at boot (``MarlinSettings::report``)."""
    steps, feed, accel = limits.steps_per_mm, limits.feedrate_mm_s, limits.acceleration_mm_s2
    return (
        "echo:  G21    ; Units in mm (mm)\n"
        "echo:Filament settings: Disabled\n"
        "echo:Steps per unit:\n"
        f"echo: M92 X{steps[0]:.2f} Y{steps[1]:.2f} Z{steps[2]:.2f} E{steps[3]:.2f}\n"
        "echo:Maximum feedrates (units/s):\n"
        f"echo:  M203 X{feed[0]:.2f} Y{feed[1]:.2f} Z{feed[2]:.2f} E{feed[3]:.2f}\n"
        "echo:Maximum Acceleration (units/s2):\n"
        f"echo:  M201 X{accel[0]:.2f} Y{accel[1]:.2f} Z{accel[2]:.2f} E{accel[3]:.2f}\n"
        "echo:Acceleration (units/s2): P<print_accel> R<retract_accel> T<travel_accel>\n"
        f"echo:  M204 P{limits.print_acceleration_mm_s2:.2f} R{limits.retract_acceleration_mm_s2:.2f} "
        f"T{limits.print_acceleration_mm_s2:.2f}\n"
        "echo:Home offset:\n"
        f"echo:  M206 X0.00 Y0.00 Z{-home_offset_hundredths_mm / 100:.2f}\n"
        "echo:PID settings:\n"
        "echo:  M301 P21.73 I1.54 D76.55\n"
    ).encode()


def _report_position(machine: Machine, line: bytes, now_s: float) -> None:
    """Answer ``M114``: the end of the planned moves, in mm and in steps."""
    x, y, z, e = (value + 0.0 if abs(value) >= 0.005 else 0.0 for value in machine.position_mm)
    counts = [
        round(value * steps) for value, steps in zip((x, y, z), machine.limits.steps_per_mm, strict=False)
    ]
    machine.send(b"X:%.2f Y:%.2f Z:%.2f E:%.2f Count X:%d Y:%d Z:%d\n" % (x, y, z, e, *counts))


def _report_settings(machine: Machine, line: bytes, now_s: float) -> None:
    machine.send(format_settings(machine.limits, machine.board.faults.home_offset_hundredths_mm))


def _identify(machine: Machine, line: bytes, now_s: float) -> None:
    machine.send(_IDENTITY % machine.board.profile.machine_text)


def _set_mode(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``G90`` or ``G91`` for all axes including the feeder, overriding M82 and M83."""
    machine.is_relative = machine.is_e_relative = read_value(line, b"G") == 91


def _stop_moves(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    machine.quick_stop(now_s)
    yield now_s + CLEANING_DURATION_S


def _set_keep_alive(machine: Machine, line: bytes, now_s: float) -> None:
    machine.keep_alive_interval_s = read_value(line, b"S") or math.inf


def _halt(machine: Machine, line: bytes, now_s: float) -> None:
    machine.stop(b"", now_s)


def _find_last_activity_s(machine: Machine) -> float:
    """Return the time of the last move, or of the last M85 (``manage_inactivity``)."""
    planner = machine.planner
    return max(machine.dead_man_armed_at_s, planner.end_s if len(planner) else planner.idle_since_s)


MARLIN2 = Dialect(
    # Codes without effect here (fan, SD card, text) and unknown ones: plain ok.
    commands=Commands(
        g={
            **SHARED_G,
            90: _set_mode,
            91: _set_mode,
        },
        m={
            **SHARED_M,
            112: _halt,
            113: _set_keep_alive,
            114: _report_position,
            115: _identify,
            410: _stop_moves,
            503: _report_settings,
        },
    ),
    fault_messages=FaultMessages(
        nozzle_maxtemp=b"Error:MAXTEMP triggered, system stopped! Heater_ID: 0\n",
        nozzle_mintemp=b"Error:MINTEMP triggered, system stopped! Heater_ID: 0\n",
        bed_maxtemp=b"Error:MAXTEMP triggered, system stopped! Heater_ID: bed\n",
        dead_heater=b"Error:Heating failed, system stopped! Heater_ID: 0\n",
        no_endstop=b"echo:Homing Failed\n",
        stuck_endstop=b"echo:Homing Failed\n",
    ),
    urgent_commands={
        112: lambda machine, now_s: machine.stop(b"", now_s),
        410: lambda machine, now_s: machine.quick_stop(now_s),
    },
    format_banner=format_banner,
    late_banner=b"echo:No media\n",
    format_report=partial(format_temperatures, decimals=2),
    buffer_lines=4,
    line_ends=b"\n\r",
    comment_spans_lines=False,
    checksum_needs_number=False,
    reads_while_busy=True,
    acknowledges_read_moves=False,
    advanced_ok=True,
    busy_message=b"echo:busy: processing\n",
    find_inactivity_start_s=_find_last_activity_s,
    halts=True,
)
