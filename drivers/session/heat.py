"""Scripts that heat to a target and confirm heaters off, and the check of each report. Pure.

The file's own M190 and M109 are never sent, as the firmware ignores the host while it executes them. Instead,
M140 or M104 is sent, and then M105 until the target is reached, so that a cancellation takes effect within
one report.
"""

from __future__ import annotations

import math

from drivers.errors import Fault
from drivers.gcode import HeatCommand, HeaterName
from drivers.link import Report
from drivers.messages import PrintPhase
from drivers.records import Suspicion
from drivers.session.commands import arm_dead_man_timer, await_report, send
from drivers.session.context import PrintEnded, Script, SessionContext, TimedScript

OFF_TIMEOUT_S = 120.0  # longer than the heater watch waits for a heater to cool
OFF_WITHOUT_MAINS_TIMEOUT_S = 60.0  # replaces OFF_TIMEOUT_S after the request to cut the mains
MIN_COOLING_S = 10.0  # minimum time for a heater to cool after a reset, even after such a request
BED_BAND_C = 0.5
NOZZLE_BAND_C, NOZZLE_HOLD_S = 2.0, 3.0  # as for M109: the nozzle must stay within this band for this time
HEATING_TIMEOUTS_S = {HeaterName.NOZZLE: 900.0, HeaterName.BED: 2400.0}
EXTRUSION_MARGIN_C = 5.0  # above the temperature below which the firmware refuses to extrude
# Maximum time between commands while heating: M105 does not reset the dead-man timer.
COMMAND_INTERVAL_S = 300.0
SUSPICION_TIMEOUT_S = 25.0  # time for a heater that may be stuck on to show that it cools
# Time for a board to restart and report temperatures, if the agent died after the finding.
RESTART_DURATION_S = 15.0
MAX_UNEXPECTED_REPORTS = 3  # a single report may be garbled

_TARGET_COMMANDS = {HeaterName.NOZZLE: b"M104 S%g", HeaterName.BED: b"M140 S%g"}
_HEATED_PHASES = (PrintPhase.HEATING, PrintPhase.PRINTING, PrintPhase.PAUSED)


def allows_extrusion(context: SessionContext, nozzle_c: float) -> bool:
    """Return True if the firmware is certain to extrude at this temperature."""
    return nozzle_c >= context.profile.min_extrusion_c + EXTRUSION_MARGIN_C


def set_target(context: SessionContext, heater: HeaterName, target_c: float) -> Script:
    """Set the target of a heater, without waiting for the temperature."""
    yield from send(context, _TARGET_COMMANDS[heater] % target_c)


def heat(context: SessionContext, command: HeatCommand) -> Script:
    """Heat as M109 and M190 do, but in a way that can be aborted; the heater watch detects faults."""
    yield from set_target(context, command.heater, command.target_c)
    if command.target_c == 0:
        return
    context.link.poll_interval_s = context.pace.heating_interval_s
    deadline_s = context.now_s + HEATING_TIMEOUTS_S[command.heater]
    reached_s = math.inf
    while True:
        context.link.poll_soon(context.now_s + context.pace.heating_interval_s)
        if not (yield from await_report(context, context.report_deadline_s)):
            text = f"the board answers, but reports no temperature of the {command.heater}"
            raise PrintEnded(Fault.NO_ANSWER, text)
        current_c = context.heater_watch.compute_median_c(command.heater)
        difference_c = command.target_c - current_c
        if command.heater is HeaterName.BED and difference_c <= BED_BAND_C:
            return
        if command.heater is HeaterName.NOZZLE and abs(difference_c) <= NOZZLE_BAND_C:
            reached_s = min(reached_s, context.now_s)
            if context.now_s - reached_s >= NOZZLE_HOLD_S:
                return
            continue
        reached_s = math.inf
        if context.now_s > deadline_s:
            text = f"the {command.heater} reached only {current_c:g} of {command.target_c:g} C in time"
            raise PrintEnded(Fault.HEATER_TIMEOUT, text)
        if context.now_s - context.last_command_at_s > COMMAND_INTERVAL_S:
            yield from arm_dead_man_timer(context, context.dead_man_timeout_s)


def confirm_heaters_off(context: SessionContext) -> TimedScript:
    """Poll until a report shows both targets 0 and every warm heater was seen to cool."""
    deadline_s = context.compute_deadline_s(OFF_TIMEOUT_S)
    context.targets_off_s = None
    context.heater_watch.reset()
    context.link.poll_interval_s = context.pace.heating_interval_s
    context.link.poll(context.now_s)
    earliest_end_s = context.compute_deadline_s(MIN_COOLING_S)
    while context.now_s < deadline_s:
        deadline_s = min(
            deadline_s, max(earliest_end_s, context.power_off_requested_s + OFF_WITHOUT_MAINS_TIMEOUT_S)
        )
        has_report = yield from await_report(context, deadline_s)
        if not has_report or context.report is None or not context.report.targets_off:
            continue
        if context.targets_off_s is None:
            context.targets_off_s = context.now_s
        if context.heater_watch.is_cooling:
            context.heaters_off = True
            return True
    return False


def verify_targets(context: SessionContext) -> Script:
    """Check the targets before the nozzle is switched off.

    A stopped board acknowledges all moves at once, but its targets are 0.
    """
    while True:
        context.link.poll(context.now_s)
        if not (yield from await_report(context, context.report_deadline_s)):
            raise PrintEnded(Fault.NO_ANSWER, "the board reports no temperatures at the end of the print")
        if not context.unexpected_report_count:  # else poll again, until enough reports are unexpected
            return


# --- at each report ---


def watch_heaters(context: SessionContext, report: Report) -> PrintEnded | None:
    """Judge a report; return the end of the print that it causes, or None."""
    expected_targets_c = _find_expected_targets_c(context)
    finding = context.heater_watch.judge_report(report, expected_targets_c, context.now_s)
    is_ending = context.phase is PrintPhase.ENDING
    if context.phase not in _HEATED_PHASES and not is_ending:
        return None
    if finding is not None and (finding.fault is Fault.HEATER_STUCK_ON or is_ending):
        note_suspicion(context, finding.text)
        if finding.is_off or is_ending:
            context.request_power_off()
    elif context.heater_watch.is_cooling and not context.wants_power_off:
        context.suspicion = None
    print_end = None if finding is None else PrintEnded(finding.fault, finding.text)
    if is_ending:
        return print_end if context.reason is None else None  # a print with a reason is ending already
    return _watch_targets(context, report, expected_targets_c) or print_end


def note_suspicion(context: SessionContext, text: str) -> None:
    """Note that a heater may be stuck on; the first finding counts."""
    if context.suspicion is None:
        context.suspicion = Suspicion(text.lstrip(" :"), context.now_s)


def compute_power_off_due_s(context: SessionContext) -> float:
    """Return the time at which to request a cut of the mains, unless the heater is seen to cool before."""
    if context.suspicion is None or context.wants_power_off or context.has_ended:
        return math.inf
    min_wait_s = 2 * context.pace.min_timeout_s
    # The suspicion may be from the previous session.
    suspected_s, started_s = context.suspicion.found_s, context.started_s
    return max(
        suspected_s + max(SUSPICION_TIMEOUT_S, min_wait_s), started_s + max(RESTART_DURATION_S, min_wait_s)
    )


def _find_expected_targets_c(context: SessionContext) -> dict[HeaterName, float]:
    """Return the targets that the session has set."""
    program = context.program
    if program is None or context.phase not in _HEATED_PHASES:
        return dict.fromkeys(HeaterName, 0.0)
    expected_targets_c = {
        name: program.find_target_c(name, context.done_line_count) or 0.0 for name in HeaterName
    }
    if context.is_nozzle_paused:
        expected_targets_c[HeaterName.NOZZLE] = 0.0
    return expected_targets_c


def _watch_targets(
    context: SessionContext, report: Report, expected_targets_c: dict[HeaterName, float]
) -> PrintEnded | None:
    """Detect a target that the session did not set: Tinker firmware or a person at the knob may do so."""
    nozzle_c, bed_c = expected_targets_c[HeaterName.NOZZLE], expected_targets_c[HeaterName.BED]
    is_unchanged = abs(report.nozzle_target_c - nozzle_c) <= 1 and abs(report.bed_target_c - bed_c) <= 1
    context.unexpected_report_count = 0 if is_unchanged else context.unexpected_report_count + 1
    if context.unexpected_report_count < MAX_UNEXPECTED_REPORTS:
        if not is_unchanged:  # poll soon, but after the lines in flight, which may set the target
            context.link.poll_soon(context.now_s + context.pace.heating_interval_s)
        return None
    targets = f"nozzle {report.nozzle_target_c:g} and bed {report.bed_target_c:g} C"
    return PrintEnded(Fault.TARGET_CHANGED, f"somebody set {targets}, not {nozzle_c:g} and {bed_c:g}")
