"""Emulated commands by their code, with their effect on the machine.

Commands that take time are generators: each value that they yield is the time at which they continue.
While one of them runs, the firmware reads no further line; its main loop advances the planner at each step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from drivers.emulator.firmware import wording
from drivers.emulator.firmware.machine import Machine, read_positive_number, read_value
from drivers.emulator.firmware.reports import list_sd_files, report_sd_progress

ResumeTimes = Iterator[float]
"""Times at which a command that takes time continues."""

WINDOW_C = 1.0  # TEMP_WINDOW
HYSTERESIS_C = 3.0  # TEMP_HYSTERESIS
RESIDENCY_S = 3.0  # TEMP_RESIDENCY_TIME
REPORT_INTERVAL_S = 1.0  # seconds between two reports of M109 and M190
HOMING_SPEED_MM_S = (100.0, 100.0, 40.0)
BUMP_DURATION_S = (0.75, 0.7)  # seconds of the second, slow approach to the endstops: X and Y together, and Z
RETRACTION_MM, RETRACTION_MM_S = 6.5, 25.0
ARC_SEGMENT_MM = 1.0
MAX_ARC_CHORDS = 4096  # more than the longest arc over the bed needs


Command = Callable[[Machine, bytes, float], ResumeTimes | None]
"""Function that executes a line on a machine at a time in seconds; see `execute`."""


@dataclass(frozen=True, slots=True)
class Commands:
    """Commands of a firmware by number; a command in neither table is answered with a plain ok."""

    g: Mapping[int, Command]
    m: Mapping[int, Command]


def execute(commands: Commands, machine: Machine, line: bytes, now_s: float) -> ResumeTimes | None:
    """Execute any line except G0 and G1.

    Parameters
    ----------
    commands
        Commands of the firmware.
    machine
        State of the firmware, which the command changes.
    line
        The line, with its number and checksum if it has them.
    now_s
        Time at which it is executed.

    Returns
    -------
    ResumeTimes or None
        Times at which an unfinished command continues; None if it is finished.
    """
    for letter, table in ((b"G", commands.g), (b"M", commands.m)):
        code = read_value(line, letter)
        if code is not None:
            command = table.get(int(code))
            return command(machine, line, now_s) if command is not None else None
    extruder = read_value(line, b"T")
    if extruder is None:
        machine.send(wording.format_unknown_command(line))
    elif extruder == 0:
        machine.send(b"echo:Active Extruder: 0\n")
    else:
        machine.send(b"echo:T%cInvalid extruder\n" % (int(extruder) & 0xFF))
    return None


def wait_for_moves(machine: Machine) -> ResumeTimes:
    """Wait until the planner is empty (``st_synchronize``); the main loop advances it at each step."""
    while len(machine.planner):
        yield machine.planner.end_s


def dwell(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``G4``: wait for the end of all moves, then for a time."""
    yield from wait_for_moves(machine)
    begin_s = max(now_s, machine.planner.idle_since_s)
    pause_s = (read_value(line, b"P") or 0.0) / 1000.0
    seconds = read_value(line, b"S")
    machine.last_command_at_s = begin_s
    yield begin_s + max(0.0, seconds if seconds is not None else pause_s)


def home(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``G28``: move the named axes, or all, to their endstops."""
    yield from wait_for_moves(machine)
    begin_s = max(now_s, machine.planner.idle_since_s)
    named_axes = [letter in line for letter in (b"X", b"Y", b"Z")]
    is_homing = named_axes if any(named_axes) else [True, True, True]
    home_mm = machine.board.profile.home_mm
    x, y, z, e = machine.planner.target_mm
    position_mm = [x, y, z]
    travel_s = [abs(h - p) / v for h, p, v in zip(home_mm, position_mm, HOMING_SPEED_MM_S, strict=True)]
    duration_s = 0.0
    if is_homing[0] or is_homing[1]:
        duration_s += max(travel_s[axis] for axis in (0, 1) if is_homing[axis]) + BUMP_DURATION_S[0]
    if is_homing[2]:
        duration_s += travel_s[2] + BUMP_DURATION_S[1]
    yield begin_s + duration_s
    faults = machine.board.faults
    if faults.no_endstop and is_homing[faults.no_endstop - 1]:
        machine.stop(machine.fault_messages.no_endstop, begin_s + duration_s)
        return
    if faults.stuck_endstop and is_homing[2]:
        machine.stop(machine.fault_messages.stuck_endstop, begin_s + duration_s)
        return
    for i in range(3):
        if is_homing[i]:
            position_mm[i] = machine.position_mm[i] = home_mm[i]
            machine.shift_mm[i] = 0.0
            machine.homed_axes[i] = True
    machine.is_homed = all(machine.homed_axes)
    machine.planner.set_position((position_mm[0], position_mm[1], position_mm[2], e), begin_s + duration_s)
    machine.board.change_count += 1


def move_arc(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``G2`` or ``G3`` with I and J: queue the arc as chords of 1 mm (``mc_arc``)."""
    f, i, j = read_value(line, b"F"), read_value(line, b"I") or 0.0, read_value(line, b"J") or 0.0
    if f is not None and f > 0.0:
        machine.feedrate_mm_s = f / 60.0
    start_mm = tuple(machine.position_mm)
    target_mm = list(start_mm)
    for axis, letter in enumerate((b"X", b"Y", b"Z", b"E")):
        number = read_value(line, letter)
        if number is not None:
            relative = machine.is_relative or (axis == 3 and machine.is_e_relative)
            target_mm[axis] = start_mm[axis] + number if relative else number
    centre_x, centre_y = start_mm[0] + i, start_mm[1] + j
    to_x, to_y = target_mm[0] - centre_x, target_mm[1] - centre_y
    angle_rad = math.atan2(-i * to_y + j * to_x, -i * to_x - j * to_y)
    if read_value(line, b"G") == 2:
        angle_rad = angle_rad - 2 * math.pi if angle_rad >= 0 else angle_rad
    else:
        angle_rad = angle_rad + 2 * math.pi if angle_rad <= 0 else angle_rad
    radius_mm = math.hypot(i, j)
    distance_mm = math.hypot(angle_rad * radius_mm, target_mm[2] - start_mm[2])
    chord_count = max(1, min(MAX_ARC_CHORDS, int(distance_mm / ARC_SEGMENT_MM)))
    start_angle_rad = math.atan2(-j, -i)
    modes, machine.is_relative, machine.is_e_relative = (
        (machine.is_relative, machine.is_e_relative),
        False,
        False,
    )
    for k in range(1, chord_count):
        fraction = k / chord_count
        machine.queue_linear_move(
            None,
            centre_x + radius_mm * math.cos(start_angle_rad + angle_rad * fraction),
            centre_y + radius_mm * math.sin(start_angle_rad + angle_rad * fraction),
            start_mm[2] + (target_mm[2] - start_mm[2]) * fraction,
            start_mm[3] + (target_mm[3] - start_mm[3]) * fraction,
            now_s,
        )
    machine.queue_linear_move(None, target_mm[0], target_mm[1], target_mm[2], target_mm[3], now_s)
    machine.is_relative, machine.is_e_relative = modes


def retract(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``G10`` or ``G11``: retract the filament, or push it back."""
    is_retraction = read_value(line, b"G") == 10
    if is_retraction == bool(machine.retracted_mm):
        return
    machine.retracted_mm = RETRACTION_MM if is_retraction else 0.0
    x, y, z, _ = machine.position_mm
    distance_mm = -RETRACTION_MM if is_retraction else RETRACTION_MM
    machine.shift_mm[3] += distance_mm  # the host's coordinates stay the same
    machine.queue(x, y, z, distance_mm, RETRACTION_MM_S, now_s)


def set_axis_mode(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``G90`` or ``G91``: select absolute or relative coordinates."""
    machine.is_relative = read_value(line, b"G") == 91


def set_extruder_mode(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M82`` or ``M83``: select absolute or relative extrusion."""
    machine.is_e_relative = read_value(line, b"M") == 83


def set_position(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``G92``: set the coordinates of the current position."""
    if b"E" not in line:
        yield from wait_for_moves(machine)
    for axis, letter in enumerate((b"X", b"Y", b"Z", b"E")):
        number = read_value(line, letter)
        if number is not None:
            machine.shift_mm[axis] += machine.position_mm[axis] - number
            machine.position_mm[axis] = number


def hang(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``M0`` or ``M1``, neither of which returns over USB."""
    while True:
        yield math.inf


def switch_motors_off(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``M18`` or ``M84``: wait for all moves, then switch the motors off."""
    if b"S" not in line:
        yield from wait_for_moves(machine)
        machine.is_streaming = False


def finish_moves(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``M400``: wait for the end of all moves."""
    yield from wait_for_moves(machine)
    machine.is_streaming = False


def stop_moves(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M401``: stop at once, and drop all queued moves."""
    machine.quick_stop(now_s)


def set_dead_man_timer(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M85``: arm or disarm the dead-man timer."""
    seconds = read_value(line, b"S")
    if seconds is not None:
        machine.dead_man_armed_at_s = now_s
        machine.dead_man_timeout_s = seconds if seconds > 0.0 else math.inf


def set_nozzle_target(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M104``: set the nozzle's target."""
    target_c = read_value(line, b"S")
    if target_c is not None:
        machine.heat_nozzle(target_c, now_s)


def set_bed_target(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M140``: set the bed's target."""
    target_c = read_value(line, b"S")
    if target_c is not None:
        machine.heat_bed(target_c, now_s)


def wait_for_nozzle(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``M109``: reach the target, then stay within 3 degrees for 3 s; report every second."""
    nozzle = machine.board.nozzle
    set_nozzle_target(machine, line, now_s)
    is_heating = nozzle.compute_temperature_c(now_s) < nozzle.target_c
    report_s, arrival_s = now_s + REPORT_INTERVAL_S, math.inf
    while True:
        reading_c, target_c = nozzle.compute_temperature_c(now_s), nozzle.target_c
        if arrival_s == math.inf:
            is_reached = reading_c >= target_c - WINDOW_C if is_heating else reading_c <= target_c + WINDOW_C
            if is_reached:
                arrival_s = now_s
        elif target_c > 0.0 and abs(reading_c - target_c) > HYSTERESIS_C:
            arrival_s = now_s
        if now_s >= arrival_s + RESIDENCY_S:
            break
        if now_s >= report_s:
            seconds_left = b"?" if arrival_s == math.inf else b"%d" % int(arrival_s + RESIDENCY_S - now_s)
            machine.send(b"T:%.1f E:0 W:%b\n" % (reading_c, seconds_left))
            report_s = now_s + REPORT_INTERVAL_S
        if arrival_s < math.inf:
            next_s = arrival_s + RESIDENCY_S
        elif is_heating:
            next_s = now_s + nozzle.compute_heating_s(target_c - WINDOW_C, now_s)
        else:
            next_s = now_s + nozzle.compute_cooling_s(target_c + WINDOW_C, now_s)
        now_s = min(report_s, max(next_s, now_s + 0.001))
        yield now_s


def wait_for_bed(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``M190``: heat to the target, or end at once if the bed is hotter; report every second."""
    bed = machine.board.bed
    set_bed_target(machine, line, now_s)
    report_s = now_s + REPORT_INTERVAL_S
    while machine.board.read_bed_c(now_s) < bed.target_c - WINDOW_C:
        if now_s >= report_s:
            nozzle_c = machine.board.nozzle.compute_temperature_c(now_s)
            machine.send(b"T:%.2f E:0 B:%.1f\n" % (nozzle_c, machine.board.read_bed_c(now_s)))
            report_s = now_s + REPORT_INTERVAL_S
        arrival_s = now_s + bed.compute_heating_s(bed.target_c - WINDOW_C, now_s)
        now_s = min(report_s, max(arrival_s, now_s + 0.001))
        yield now_s


def init_card(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``M21``, which fails after 2 s."""
    yield now_s + 2.0
    machine.send(b"echo:SD init fail\n")


def beep(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``M300``: wait for the duration of the tone."""
    yield now_s + read_positive_number(line, b"P", 0.0) / 1000.0


def park(machine: Machine, line: bytes, now_s: float) -> ResumeTimes:
    """Execute ``M601`` outside an SD print: move the bed down and the head aside, and wait for no person."""
    yield from wait_for_moves(machine)
    now_s = max(now_s, machine.planner.idle_since_s)
    x, y, z, e = machine.position_mm
    z = min(z + 20.0, machine.max_position_mm[2])
    machine.position_mm = [10.0, 10.0, z, e]
    machine.queue(x, y, z, 0.0, 35.0, now_s)
    machine.queue(10.0, 10.0, z, 0.0, 150.0, now_s)
    yield from wait_for_moves(machine)


def set_limits(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M92``, ``M201``, ``M203``, ``M204`` or ``M205``: set steps, limits and jerk."""
    limits, code = machine.limits, int(read_value(line, b"M") or 0)
    per_axis = {92: limits.steps_per_mm, 201: limits.acceleration_mm_s2, 203: limits.feedrate_mm_s}
    if code in per_axis:
        for axis, letter in enumerate((b"X", b"Y", b"Z", b"E")):
            per_axis[code][axis] = read_positive_number(line, letter, per_axis[code][axis])
    elif code == 204:
        limits.print_acceleration_mm_s2 = read_positive_number(line, b"S", limits.print_acceleration_mm_s2)
        limits.retract_acceleration_mm_s2 = read_positive_number(
            line, b"T", limits.retract_acceleration_mm_s2
        )
    else:
        limits.jerk_xy_mm_s = read_positive_number(line, b"X", limits.jerk_xy_mm_s)
        limits.jerk_z_mm_s = read_positive_number(line, b"Z", limits.jerk_z_mm_s)
        limits.jerk_e_mm_s = read_positive_number(line, b"E", limits.jerk_e_mm_s)


def set_feed_factor(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M220``: set the feed rate factor, in percent."""
    machine.feed_factor = read_positive_number(line, b"S", 100.0 * machine.feed_factor) / 100.0


def set_flow_factor(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M221``: set the flow factor, in percent."""
    machine.flow_factor = read_positive_number(line, b"S", 100.0 * machine.flow_factor) / 100.0


def allow_cold_extrusion(machine: Machine, line: bytes, now_s: float) -> None:
    """Execute ``M302``: set the temperature below which extrusion is ignored."""
    machine.min_extrusion_c = read_value(line, b"S") or 0.0


SHARED_G: Mapping[int, Command] = {2: move_arc, 3: move_arc, 4: dwell, 28: home, 92: set_position}
"""G codes that all emulated firmwares execute in the same way."""

SHARED_M: Mapping[int, Command] = {
    0: hang,
    1: hang,
    18: switch_motors_off,
    20: list_sd_files,
    21: init_card,
    27: report_sd_progress,
    82: set_extruder_mode,
    83: set_extruder_mode,
    84: switch_motors_off,
    85: set_dead_man_timer,
    92: set_limits,
    104: set_nozzle_target,
    109: wait_for_nozzle,
    140: set_bed_target,
    190: wait_for_bed,
    201: set_limits,
    203: set_limits,
    204: set_limits,
    205: set_limits,
    220: set_feed_factor,
    221: set_flow_factor,
    302: allow_cold_extrusion,
    400: finish_moves,
}
"""M codes that all emulated firmwares execute in the same way."""
