"""Scripts that move filament and head between two prints and in a pause. Pure.

The filament is either parked, retracted by `Profile.park_retraction_mm`, or at the nozzle, retracted only
as far as the file retracts it. While it moves between the two, its position is unknown.
"""

from __future__ import annotations

import math

from drivers.errors import Fault, UnreadableFile
from drivers.gcode import HeatCommand, HeaterName, MotionState, Point, Program, measure_retraction_mm
from drivers.messages import Filament, PrintPhase
from drivers.session.commands import (
    PAUSE_DEAD_MAN_TIMEOUT_S,
    PRINTING_DEAD_MAN_TIMEOUT_S,
    arm_dead_man_timer,
    send,
)
from drivers.session.context import PrintEnded, Script, SessionContext
from drivers.session.heat import allows_extrusion, heat, set_target

PARKED_TOLERANCE_MM = 0.25
LIFT_MM = 10.0
LAST_EXTRUSION_MM = 6.5  # extruded only when the head is back, as a full nozzle oozes while it travels
PAUSE_TIMEOUT_S = 7200.0
# After each command the display shows "Printing with USB" for 5 s, which deters people from an SD print.
PAUSE_COMMAND_INTERVAL_S = 4.0


def unpark(context: SessionContext) -> Script:
    """Move parked filament to the nozzle."""
    context.filament = Filament.UNKNOWN
    push_command = b"G1 F300 E%g" % context.profile.park_retraction_mm
    yield from send(context, b"M82", b"G92 E0", push_command, b"G92 E0", context.firmware.wait_command)
    context.filament = Filament.AT_NOZZLE


def park(context: SessionContext, retracted_mm: float, can_extrude: bool) -> Script:
    """Retract the filament to its parked position.

    Parameters
    ----------
    context
        State of the session.
    retracted_mm
        Distance from the nozzle's tip back to the filament's tip; NaN if it is unknown.
    can_extrude
        True if the nozzle is warm enough to move the filament.
    """
    park_retraction_mm = context.profile.park_retraction_mm
    if math.isnan(retracted_mm):
        context.filament = Filament.UNKNOWN
    elif abs(park_retraction_mm - retracted_mm) <= PARKED_TOLERANCE_MM:
        context.filament = Filament.PARKED
    elif can_extrude:
        context.filament = Filament.UNKNOWN
        pull_command = b"G1 F1500 E%.3f" % (retracted_mm - park_retraction_mm)
        if (yield from send(context, b"G91", pull_command, b"G90", context.firmware.wait_command)):
            context.filament = Filament.PARKED
    elif retracted_mm > PARKED_TOLERANCE_MM:
        context.filament = Filament.UNKNOWN


def try_measure_retraction_mm(
    program: Program, done_line_count: int, stop_point: Point | None = None
) -> float:
    """Compute the retraction of the filament in mm; NaN if the file can no longer be read.

    The parameters are those of `measure_retraction_mm`.
    """
    try:
        return measure_retraction_mm(program, done_line_count, stop_point)
    except UnreadableFile:
        return math.nan


def compute_lift_mm(context: SessionContext, z_mm: float, done_line_count: int) -> float:
    """Compute the distance by which to lower the bed before the head leaves the part.

    Finished parts on the bed may be higher than this one.

    Parameters
    ----------
    context
        State of the session.
    z_mm
        Height of the head in mm.
    done_line_count
        Number of lines of the program that were acknowledged.
    """
    max_height_mm = 0.0 if context.program is None else context.program.compute_max_height_mm(done_line_count)
    return max(0.0, min(max(z_mm, max_height_mm) + LIFT_MM, context.profile.top_mm) - z_mm)


def can_pause(context: SessionContext) -> bool:
    """Return True if the head can leave the part now and return."""
    return (
        context.program is not None
        and context.phase is PrintPhase.PRINTING
        and context.filament is Filament.AT_NOZZLE
        and allows_extrusion(
            context, context.program.find_target_c(HeaterName.NOZZLE, context.link.streamed_line_count) or 0.0
        )
    )


def pause(context: SessionContext, program: Program, done_line_count: int) -> Script:
    """Park the filament, keep the bed warm, wait for a person, and return to the part.

    The filament is parked because the print may end in the pause. Source:
    docs/explanation/ultimaker2-serial.md, section 5.

    Parameters
    ----------
    context
        State of the session.
    program
        The program that is being printed.
    done_line_count
        Number of its lines that were acknowledged.
    """
    firmware = context.firmware
    context.phase = PrintPhase.PAUSED
    context.position_mm = None
    has_stopped = yield from send(context, firmware.wait_command, firmware.position_query, limit_s=math.inf)
    if not has_stopped or context.position_mm is None:
        raise PrintEnded(Fault.NO_ANSWER, "the board does not report the position of the head")
    motion = MotionState(program, done_line_count)
    position_mm = [
        reported_mm if math.isnan(tracked_mm) else tracked_mm
        for tracked_mm, reported_mm in zip(motion.position_mm, context.position_mm, strict=True)
    ]
    yield from park(context, motion.retracted_mm, can_extrude=True)
    lift_command = b"G1 F1200 Z%.3f" % (
        position_mm[2] + compute_lift_mm(context, position_mm[2], done_line_count)
    )
    yield from send(
        context, b"G90", lift_command, b"G1 F9000 X%g Y%g" % context.profile.pause_xy_mm, b"M104 S0"
    )
    context.is_nozzle_paused = True
    yield from arm_dead_man_timer(context, PAUSE_DEAD_MAN_TIMEOUT_S)
    yield from _await_resume(context)
    target_c = program.find_target_c(HeaterName.NOZZLE, done_line_count) or 0.0
    yield from arm_dead_man_timer(context, PRINTING_DEAD_MAN_TIMEOUT_S)
    yield from set_target(context, HeaterName.NOZZLE, target_c)
    context.is_nozzle_paused = False
    yield from heat(context, HeatCommand(done_line_count, HeaterName.NOZZLE, target_c, waits=True))
    context.filament = Filament.UNKNOWN
    yield from send(
        context,
        *_list_return_commands(motion, position_mm, context.profile.park_retraction_mm),
        firmware.wait_command,
    )
    context.filament = Filament.AT_NOZZLE
    context.phase = PrintPhase.PRINTING


def _list_return_commands(motion: MotionState, position_mm: Point, park_retraction_mm: float) -> list[bytes]:
    """List the commands that push the filament, return to the part and restore the file's settings."""
    x, y, z, e = position_mm
    push_mm = park_retraction_mm - motion.retracted_mm
    last_mm = min(LAST_EXTRUSION_MM, push_mm)
    commands = [b"G91", b"G1 F300 E%.3f" % (push_mm - last_mm), b"G90"]
    commands += [b"G1 F9000 X%.3f Y%.3f" % (x, y), b"G1 F1200 Z%.3f" % z]
    commands += [b"G91", b"G1 F1500 E%.3f" % last_mm, b"G90", b"G92 E%.5f" % e]
    if not math.isnan(motion.feedrate_mm_min):
        commands.append(b"G1 F%g" % motion.feedrate_mm_min)
    if motion.is_relative:
        commands.append(b"G91")
    return commands


def _await_resume(context: SessionContext) -> Script:
    """Wait until a person resumes the print, and reset the dead-man timer meanwhile."""
    context.pause_ends_s = context.now_s + PAUSE_TIMEOUT_S
    context.link.poll_interval_s = context.pace.printing_interval_s
    while context.is_pause_requested:
        if context.now_s >= context.pause_ends_s:
            raise PrintEnded(Fault.PAUSE_TIMEOUT, f"nobody resumed it within {PAUSE_TIMEOUT_S / 3600:g} h")
        yield context.wait(lambda: not context.is_pause_requested, PAUSE_COMMAND_INTERVAL_S)
        if context.is_pause_requested:
            yield from arm_dead_man_timer(context, context.dead_man_timeout_s)
    context.pause_ends_s = None
