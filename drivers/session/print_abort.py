"""Scripts that abort a print in any phase, by command or by a reset, and confirm the heaters off. Pure."""

from __future__ import annotations

import math

from drivers.errors import Fault
from drivers.link import Phase as LinkPhase
from drivers.messages import Filament
from drivers.session.commands import MAX_ATTEMPTS, arm_dead_man_timer, connect, send
from drivers.session.context import PrintEnded, Script, SessionContext, TimedScript
from drivers.session.heat import allows_extrusion, confirm_heaters_off
from drivers.session.park import LIFT_MM, compute_lift_mm, park, try_measure_retraction_mm

STOP_TIMEOUT_S = 30.0  # the stop waits for the current move
BARRIER_COUNT = 3  # number of M400: a garbled answer may fake the ok of one, but not of three

_RESET_FAULTS = frozenset(
    (
        Fault.STOPPED, Fault.MAXTEMP, Fault.MINTEMP, Fault.KILL, Fault.REBOOT, Fault.ENDSTOP,
        Fault.NO_ANSWER, Fault.NOISY_LINE, Fault.PORT_LOST, Fault.AGENT_DIED, Fault.ESTOP,
    )
)  # fmt: skip


def abort_print(context: SessionContext) -> Script:
    """Abort the print, by command if the board responds, else by a reset."""
    context.final_line_count = context.acknowledged_line_count
    is_homed = context.program is not None and context.final_line_count > context.program.home_line
    responds = context.connection is not None and context.link.phase is LinkPhase.LIVE
    if responds and context.fault not in _RESET_FAULTS:
        try:
            if (yield from _abort_by_command(context, is_homed)):
                return
        except PrintEnded:
            pass  # the board stopped responding during the sequence
    yield from _switch_heaters_off_by_reset(context, is_homed)


def _abort_by_command(context: SessionContext, is_homed: bool) -> TimedScript:
    """Abort by the safe sequence, and park the filament. Return False if it did not finish.

    Source: docs/explanation/ultimaker2-serial.md, section 5.
    """
    firmware = context.firmware
    context.link.drop_unsent()
    if not (yield from send(context, *firmware.abort_commands, limit_s=STOP_TIMEOUT_S)):
        return False
    if is_homed:  # before homing, the distance that the bed may move is unknown
        done_line_count = context.done_line_count
        context.position_mm = None
        yield from send(context, firmware.position_query)
        if context.filament is Filament.AT_NOZZLE and context.program is not None:
            can_extrude = context.report is not None and allows_extrusion(context, context.report.nozzle_c)
            yield from park(
                context,
                try_measure_retraction_mm(context.program, done_line_count, context.position_mm),
                can_extrude,
            )
        z_mm = math.nan if context.position_mm is None else context.position_mm[2]
        lift_mm = LIFT_MM if math.isnan(z_mm) else compute_lift_mm(context, z_mm, done_line_count)
        park_commands = (
            b"G91",
            b"G1 F1200 Z%.3f" % lift_mm,
            b"G90",
            b"G28 X0 Y0",
            firmware.motors_off_command,
        )
        if not (yield from send(context, *park_commands, *(firmware.wait_command,) * BARRIER_COUNT)):
            return False
    if not (yield from confirm_heaters_off(context)):
        return False
    yield from arm_dead_man_timer(context, 0.0)
    return True


def _switch_heaters_off_by_reset(context: SessionContext, is_homed: bool) -> Script:
    """Switch the heaters off by a reset, which is the emergency stop for every board with DTR."""
    if context.filament is Filament.AT_NOZZLE:
        context.filament = Filament.UNKNOWN
    context.link.ignore_faults = True
    try:
        for _ in range(MAX_ATTEMPTS):
            context.heaters_off = False
            try:
                if (yield from _reset_and_confirm_heaters_off(context, is_homed)):
                    return
            except PrintEnded as print_end:
                if print_end.fault is Fault.PORT_LOST:
                    break
            if context.wants_power_off:
                break
        context.request_power_off()
        context.reason = f"{context.reason}; heaters were not confirmed off: switch the printer off"
    finally:
        context.link.ignore_faults = False


def _reset_and_confirm_heaters_off(context: SessionContext, is_homed: bool) -> TimedScript:
    """Reset the board and confirm its heaters off; then move away from the part, if that is safe."""
    firmware = context.firmware
    yield from connect(context)
    has_restarted = context.connection is None or context.connection.has_restarted
    if not has_restarted:
        # The move queue is empty: the head stands still.
        yield from send(context, firmware.motors_off_command)
    if not (yield from confirm_heaters_off(context)):
        return False
    if not has_restarted:
        yield from arm_dead_man_timer(context, 0.0)
    if is_homed and context.fault is None:
        # The nozzle may touch the part.
        yield from send(
            context, *context.profile.leave_code, firmware.motors_off_command, firmware.wait_command
        )
    return True
