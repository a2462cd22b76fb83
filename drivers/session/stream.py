"""Scripts that print a program: stream its lines, stop for heating, and finish. Pure."""

from __future__ import annotations

import math

from drivers.errors import Fault
from drivers.gcode import HeatCommand, HeaterName, Program
from drivers.messages import Filament, PrintPhase
from drivers.session.commands import (
    HEATING_DEAD_MAN_TIMEOUT_S,
    PRINTING_DEAD_MAN_TIMEOUT_S,
    arm_dead_man_timer,
    send,
)
from drivers.session.context import PrintEnded, Script, SessionContext, Wait
from drivers.session.heat import allows_extrusion, confirm_heaters_off, heat, verify_targets
from drivers.session.identification import check_height
from drivers.session.park import can_pause, park, pause, try_measure_retraction_mm, unpark
from drivers.session.print_abort import BARRIER_COUNT


def print_program(context: SessionContext, program: Program) -> Script:
    """Print a whole program on an identified board, until the heaters are confirmed off."""
    context.phase = PrintPhase.HEATING
    context.heaters_off = False
    yield from arm_dead_man_timer(context, HEATING_DEAD_MAN_TIMEOUT_S)
    cooling_line = next(
        (h.line for h in program.heat_commands if _switches_nozzle_off(h, program.extrusion_line)),
        program.line_count,
    )
    start = 0
    for stop, heat_command in _list_stops(program, cooling_line):
        yield from _stream_lines(context, program, start, stop)
        start = stop
        if stop == program.home_line + 1:
            yield from check_height(context, program.read_lines(program.home_line, stop)[0])
        if heat_command is not None:
            context.executed_line_count = start = stop + 1
            yield from heat(context, heat_command)
            can_extrude = heat_command.heater is HeaterName.NOZZLE and allows_extrusion(
                context, heat_command.target_c
            )
            if can_extrude and context.filament is Filament.PARKED:
                yield from unpark(context)
        elif stop == program.extrusion_line < program.line_count:
            context.has_extruded = True
            context.phase = PrintPhase.PRINTING
            yield from arm_dead_man_timer(context, PRINTING_DEAD_MAN_TIMEOUT_S)
        if stop == cooling_line and context.phase is PrintPhase.PRINTING:
            yield from verify_targets(context)
    yield from _finish_print(context, program)


def _list_stops(program: Program, cooling_line: int) -> list[tuple[int, HeatCommand | None]]:
    """List the lines before which the stream stops, each with the heat command that replaces it, if any."""
    lines = (program.home_line + 1, program.extrusion_line, program.line_count)
    stops: dict[int, HeatCommand | None] = dict.fromkeys(lines)
    stops |= {heat_command.line: heat_command for heat_command in program.heat_commands if heat_command.waits}
    stops.setdefault(cooling_line, None)
    return sorted(((line, stops[line]) for line in stops if line <= program.line_count), key=lambda s: s[0])


def _switches_nozzle_off(heat_command: HeatCommand, after_line: int) -> bool:
    return (
        heat_command.heater is HeaterName.NOZZLE
        and heat_command.target_c == 0
        and heat_command.line > after_line
    )


def _stream_lines(context: SessionContext, program: Program, start: int, stop: int) -> Script:
    """Send lines `start` to `stop`, and pause when requested."""
    link = context.link

    def is_sent_or_paused() -> bool:
        can_begin_pause = context.is_pause_requested and can_pause(context)
        return link.is_drained or link.source_error is not None or can_begin_pause

    while start < stop:
        link.poll_interval_s = context.pace.printing_interval_s
        link.stream(context.now_s, program.read_lines, start, stop)
        context.report_s = context.now_s
        while not (yield Wait(is_sent_or_paused, context.no_report_deadline_s)):
            if context.now_s >= context.no_report_deadline_s:
                raise PrintEnded(Fault.NO_ANSWER, "the board is printing, but reports no temperatures")
        if link.source_error is not None:
            raise link.source_error
        if link.is_drained:
            return
        link.drop_unsent()
        yield Wait(lambda: link.is_drained)
        start = link.streamed_line_count
        if can_pause(context):  # the line in flight may have switched the nozzle off
            yield from pause(context, program, start)


def _finish_print(context: SessionContext, program: Program) -> Script:
    """Send the file's end code, and confirm the heaters off."""
    firmware = context.firmware
    context.phase = PrintPhase.ENDING
    context.final_line_count = program.line_count
    off_commands = (
        *firmware.heaters_off_commands,
        firmware.fan_off_command,
        *(firmware.wait_command,) * BARRIER_COUNT,
    )
    yield from send(context, *off_commands, limit_s=math.inf)
    if context.filament is Filament.AT_NOZZLE:
        # The end code has placed the filament, and the nozzle is cooling already.
        yield from park(context, try_measure_retraction_mm(program, program.line_count), can_extrude=False)
    if not (yield from confirm_heaters_off(context)):
        if context.report is not None and context.report.targets_off:
            raise PrintEnded(
                Fault.HEATER_STUCK_ON, "a heater was not confirmed to cool at the end of the print"
            )
        raise PrintEnded(Fault.NO_ANSWER, "heaters were not confirmed off at the end of the print")
    yield from arm_dead_man_timer(context, 0.0)
