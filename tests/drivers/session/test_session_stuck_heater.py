"""A heater that cannot be switched off: from the finding to the request to cut the mains."""

import math

import pytest

from drivers.emulator.faults import Faults
from drivers.errors import Fault
from drivers.gcode import HeaterName
from drivers.link.replies import Report
from drivers.messages import Filament, PrintPhase
from drivers.records import Suspicion
from drivers.safety import Finding, HeaterWatch
from drivers.session import Pace, Session, SessionContext
from printers.print_rig import PLUS_PROFILE, Rig, make_gcode

MAX_DELAY_S = 30.0  # from a finding to the request
NOZZLE, BED = HeaterName.NOZZLE, HeaterName.BED


def start_print_with_stuck_heater(heater: HeaterName) -> Rig:
    """Start a print, and then give a heater full power permanently."""
    rig = Rig(text=make_gcode(4000)).run_until_printing(300)
    rig.firmware.trigger_fault(f"{heater}_burns_after", rig.now_s)
    return rig


def run_until_finding(rig: Rig) -> float:
    """Run until the finding, and return its time."""
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.ENDING)
    assert rig.session.context.fault is Fault.HEATER_STUCK_ON
    return rig.now_s


def run_until_power_off_request(rig: Rig) -> float:
    rig.run(until=lambda: rig.session.context.wants_power_off)
    assert rig.session.context.wants_power_off
    return rig.now_s


@pytest.mark.parametrize("heater", [NOZZLE, BED])
def test_power_off_is_requested_soon_after_a_stuck_heater(heater: HeaterName):
    rig = start_print_with_stuck_heater(heater)
    finding_s = run_until_finding(rig)
    assert run_until_power_off_request(rig) - finding_s <= MAX_DELAY_S
    rig.run()
    assert rig.now_s - finding_s <= 150.0  # the print does not stay in its ending phase for long
    assert not rig.session.context.heaters_off


@pytest.mark.parametrize("after_s", [0.5, 5.0, 12.0])
@pytest.mark.parametrize(
    "activity", ["reset_after", "kill_after", "stop_after", "silent_after", "stuck_after"]
)
@pytest.mark.parametrize("heater", [NOZZLE, BED])
def test_activity_of_the_board_does_not_delay_the_power_off(
    heater: HeaterName, activity: str, after_s: float
):
    rig = start_print_with_stuck_heater(heater)
    finding_s = run_until_finding(rig)
    rig.run(until=lambda: rig.now_s >= finding_s + after_s)
    rig.firmware.trigger_fault(activity, rig.now_s)
    assert run_until_power_off_request(rig) - finding_s <= MAX_DELAY_S


def test_lost_port_does_not_delay_the_power_off():
    rig = start_print_with_stuck_heater(NOZZLE)
    finding_s = run_until_finding(rig)
    rig.is_plugged = False
    rig.link.on_closed()
    rig.session.fail(Fault.PORT_LOST, "unplugged", rig.now_s)
    assert run_until_power_off_request(rig) - finding_s <= MAX_DELAY_S


def test_stuck_nozzle_heater_is_found_after_a_cancel_or_in_a_pause():
    """Detect the fault by the temperature alone, because the target is 0."""
    for stop_session in (
        lambda rig: rig.session.cancel("no more", rig.now_s),
        lambda rig: rig.session.pause(rig.now_s),
    ):
        rig = start_print_with_stuck_heater(NOZZLE)
        started_s = rig.now_s
        stop_session(rig)
        assert run_until_power_off_request(rig) - started_s <= 45.0  # a pause first retracts the hot filament
        rig.run()
        assert (
            rig.session.context.suspicion is not None
            and "nozzle is off, but is getting hotter" in rig.session.context.suspicion.text
        )


@pytest.mark.parametrize("lines_before_the_end", [40, 12, 3])
def test_stuck_nozzle_heater_is_found_at_the_end_of_the_file(lines_before_the_end: int):
    rig = Rig(text=make_gcode(50))
    rig.run_until_printing(rig.program.line_count - lines_before_the_end)
    rig.firmware.trigger_fault("nozzle_burns_after", rig.now_s)
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.ENDING)
    started_s = rig.now_s
    assert run_until_power_off_request(rig) - started_s <= MAX_DELAY_S
    rig.run()
    assert rig.session.context.phase is PrintPhase.FAILED
    assert rig.session.context.fault in (Fault.HEATER_STUCK_ON, Fault.MAXTEMP)


def test_stuck_nozzle_heater_is_found_while_the_bed_heats():
    rig = Rig()
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.HEATING)
    rig.firmware.trigger_fault("nozzle_burns_after", rig.now_s)
    run_until_power_off_request(rig)
    assert rig.firmware.board.nozzle.compute_temperature_c(rig.now_s) < 80.0


def test_suspicion_by_a_broken_sensor_ends_when_the_heater_cools():
    rig = Rig(Faults(stop_after=700), text=make_gcode(1000))
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.ENDING)
    assert rig.session.context.suspicion is not None
    rig.run()
    assert rig.session.context.fault is Fault.MAXTEMP and rig.session.context.heaters_off
    assert rig.session.context.suspicion is None and not rig.session.context.wants_power_off


@pytest.mark.parametrize("burns", [False, True])
def test_session_after_a_dead_agent_keeps_the_finding(burns: bool):
    rig = start_print_with_stuck_heater(NOZZLE)
    finding_s = run_until_finding(rig)
    suspicion = rig.session.context.suspicion
    assert suspicion is not None
    if not burns:
        rig.firmware.board.nozzle.compute_temperature_c(rig.now_s)
        rig.firmware.board.nozzle.is_mosfet_shorted = False
    rig.link.on_closed()
    rig.session = Session(
        SessionContext(rig.link, None, PLUS_PROFILE, Filament.UNKNOWN, Pace(), rig.now_s, suspicion=suspicion)
    )
    if burns:
        assert run_until_power_off_request(rig) - finding_s <= MAX_DELAY_S
    rig.run()
    assert rig.session.context.wants_power_off is burns
    assert rig.session.context.heaters_off is not burns


@pytest.mark.parametrize("burns", [False, True])
def test_old_finding_requests_power_off_after_the_time_to_cool(burns: bool):
    rig = Rig()
    rig.firmware.board.nozzle.is_mosfet_shorted = burns
    started_s = rig.now_s
    old_suspicion = Suspicion("the nozzle went up to 250 C, above 210", rig.now_s - 3600.0)
    rig.session = Session(
        SessionContext(
            rig.link, None, PLUS_PROFILE, Filament.UNKNOWN, Pace(), rig.now_s, suspicion=old_suspicion
        )
    )
    if burns:
        rig.firmware.board.nozzle._temperature_c = 200.0
        assert run_until_power_off_request(rig) - started_s <= MAX_DELAY_S / 2
    rig.run()
    assert rig.session.context.wants_power_off is burns and rig.session.context.heaters_off is not burns


def test_rules_allow_for_the_delays_of_an_accelerated_clock():
    fast_watch, slow_watch = HeaterWatch(4.0), HeaterWatch(480.0)
    for now_s in range(400):
        report = Report(200.0 + now_s, 0.0, 21.0, 0.0)
        late_finding = slow_watch.judge_report(report, {NOZZLE: 0.0, BED: 0.0}, float(now_s))
        early_finding = fast_watch.judge_report(report, {NOZZLE: 0.0, BED: 0.0}, float(now_s))
        assert late_finding is None and (early_finding is None) == (now_s < 13)
    pace = Pace(min_timeout_s=240.0)
    rig = Rig()
    rig.session = Session(
        SessionContext(
            rig.link,
            None,
            PLUS_PROFILE,
            Filament.UNKNOWN,
            pace,
            1000.0,
            suspicion=Suspicion("it burns", 1000.0),
        )
    )
    rig.session.advance((), 1000.0 + 479.0)
    assert not rig.session.context.wants_power_off
    rig.session.advance((), 1000.0 + 480.0)
    assert rig.session.context.wants_power_off


def compute_overshoot_c(now_s: float, peak_c: float) -> float:
    """Compute a temperature that rises from 200 C by `peak_c` within 12 s after switch-off, then falls."""
    return 200.0 + (
        peak_c * math.sin(now_s / 12.0 * math.pi / 2) if now_s < 12.0 else peak_c - (now_s - 12.0)
    )


def observe_nozzle(watch: HeaterWatch, nozzle_c: float, target_c: float, now_s: float) -> Finding | None:
    return watch.judge_report(Report(nozzle_c, target_c, 21.0, 0.0), {NOZZLE: 0.0, BED: 0.0}, now_s)


@pytest.mark.parametrize("peak_c", [2.0, 6.0, 9.0])
def test_overshoot_of_a_healthy_nozzle_causes_no_finding(peak_c: float):
    watch = HeaterWatch(4.0)
    assert all(
        observe_nozzle(watch, compute_overshoot_c(s, peak_c), 0.0, s) is None for s in map(float, range(60))
    )


def test_heating_before_the_off_command_is_not_a_fault():
    """Report the former target while a command waits for homing."""
    watch = HeaterWatch(4.0)
    assert all(observe_nozzle(watch, 100.0 + 3 * s, 210.0, float(s)) is None for s in range(36))
    assert all(
        observe_nozzle(watch, compute_overshoot_c(s, 3.0), 0.0, 36.0 + s) is None
        for s in map(float, range(60))
    )
