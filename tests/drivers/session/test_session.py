"""Complete prints on the emulator's firmware, in one process and on a simulated clock."""

import errno
import os

import pytest

from drivers.clock import Clock
from drivers.emulator.faults import Faults
from drivers.errors import Fault
from drivers.gcode.program import MemoryStore
from drivers.messages import Filament, PrintPhase
from drivers.session import Pace
from printers.print_rig import GCODE, Rig, assert_end_with_heaters_off, make_gcode, make_retracting_gcode


def test_print_passes_its_phases_and_ends_with_heaters_off_and_filament_parked():
    rig = Rig().run()
    assert_end_with_heaters_off(rig, PrintPhase.DONE, None)
    assert rig.phases == [
        PrintPhase.CONNECTING, PrintPhase.HEATING, PrintPhase.PRINTING, PrintPhase.ENDING, PrintPhase.DONE,
    ]  # fmt: skip
    assert rig.session.context.has_extruded
    assert rig.session.context.filament is Filament.PARKED
    assert rig.firmware.board.filament_end_mm == pytest.approx(-20.0, abs=0.1)
    assert rig.firmware.error_count == 0


def test_wait_commands_are_never_sent_and_the_dead_man_timer_is_armed_before_heating():
    rig = Rig().run()
    assert b"M109" not in rig.sent_bytes and b"M190" not in rig.sent_bytes
    assert rig.sent_bytes.index(b"M85 S1200") < rig.sent_bytes.index(b"M140 S60")
    assert rig.sent_bytes.rindex(b"M85 S0") > rig.sent_bytes.rindex(b"G28")


@pytest.mark.parametrize(("filament", "push_count"), [(Filament.PARKED, 1), (Filament.AT_NOZZLE, 0)])
def test_parked_filament_is_unparked_once(filament: Filament, push_count: int):
    rig = Rig(filament=filament).run()
    assert rig.sent_bytes.count(b"G1 F300 E20") == push_count


@pytest.mark.parametrize("lines", [0, 3, 9, 10, 12, 60, 150])
def test_cancel_at_any_time_ends_with_heaters_off(lines: int):
    rig = Rig().run_until_printing(lines)
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.CANCELLED, None)
    assert rig.session.context.reason == "no more"


def test_cancel_in_the_middle_parks_the_filament_and_moves_the_head_away():
    rig = Rig().run_until_printing(100)
    end_s = rig.now_s
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert rig.session.context.filament is Filament.PARKED
    assert rig.firmware.board.filament_end_mm == pytest.approx(-20.0, abs=0.1)
    assert rig.firmware.board.head_position_mm[0] == pytest.approx(0.0, abs=0.5)
    assert rig.now_s - end_s < 60.0


def test_cancel_before_homing_moves_nothing():
    rig = Rig()
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.HEATING)
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.CANCELLED, None)
    assert b"Z10" not in rig.sent_bytes and b"G28" not in rig.sent_bytes


@pytest.mark.parametrize(
    ("faults", "fault"),
    [
        (Faults(reset_after=100), Fault.REBOOT),
        (Faults(kill_after=700), Fault.KILL),
        (Faults(stop_after=700), Fault.MAXTEMP),
        (Faults(bed_open_after=700), Fault.MAXTEMP),
        (Faults(nozzle_short_after=700), Fault.MINTEMP),
        (Faults(silent_after=700), Fault.NO_ANSWER),
        (Faults(stuck_after=700), Fault.NOISY_LINE),
        (Faults(zero_after=700), Fault.TARGET_CHANGED),
        (Faults(dead_bed=True), Fault.HEATER_TIMEOUT),
        (Faults(weak_bed=True), Fault.HEATER_TIMEOUT),
        (Faults(weak_nozzle=True), Fault.HEATER_TIMEOUT),
        (Faults(nozzle_dies_after=700), Fault.STOPPED),
        (Faults(bed_dies_after=700), Fault.THERMAL_RUNAWAY),
        (Faults(no_endstop=1), Fault.ENDSTOP),
        (Faults(no_endstop=3), Fault.ENDSTOP),
        (Faults(stuck_endstop=True), Fault.ENDSTOP),
        (Faults(checksum=0.2), Fault.NOISY_LINE),
    ],
)
def test_faults_of_the_board_fail_the_print_by_name_and_end_with_heaters_off(faults: Faults, fault: Fault):
    assert_end_with_heaters_off(Rig(faults, text=make_gcode(1000)).run(), PrintPhase.FAILED, fault)


@pytest.mark.parametrize(
    ("faults", "fault"),
    [
        (Faults(bed_burns_after=700), Fault.HEATER_STUCK_ON),
        (Faults(nozzle_burns_after=700), Fault.HEATER_STUCK_ON),
        (Faults(bed_short_after=700), Fault.MINTEMP),
    ],
)
def test_heater_that_does_not_cool_is_not_reported_as_off_and_its_mains_are_cut(faults: Faults, fault: Fault):
    rig = Rig(faults, text=make_gcode(1000)).run()
    assert (rig.session.context.phase, rig.session.context.fault) == (PrintPhase.FAILED, fault), (
        rig.session.context.reason
    )
    assert rig.session.context.wants_power_off and not rig.session.context.heaters_off
    assert "switch the printer off" in str(rig.session.context.reason)
    assert rig.read_targets() == (0.0, 0.0)  # targets of 0 are not enough


def test_heater_stuck_on_at_the_end_fails_the_print():
    rig = Rig(text=make_gcode(50))
    rig.run_until_printing(rig.program.line_count - 12)
    rig.firmware.board.bed.is_mosfet_shorted = True
    rig.run()
    assert (rig.session.context.phase, rig.session.context.fault) == (
        PrintPhase.FAILED,
        Fault.HEATER_STUCK_ON,
    )
    assert rig.session.context.wants_power_off


@pytest.mark.parametrize(
    "faults",
    [
        Faults(sleep_after=100),
        Faults(mute_resend=True, checksum=0.004),
        Faults(garble_ok=0.01),
        Faults(resend=0.005),
        Faults(swallow=0.004),
        Faults(no_number=0.004, no_checksum=0.004, wrong_number=0.004),
        Faults(noise=0.00005, lost=0.00002, doubled=0.00002),
    ],
)
def test_same_part_is_printed_with_recoverable_faults(faults: Faults):
    clean_rig, faulty_rig = Rig(text=make_gcode(1000)).run(), Rig(faults, text=make_gcode(1000), seed=3).run()
    assert_end_with_heaters_off(faulty_rig, PrintPhase.DONE, None)
    assert faulty_rig.firmware.board.filament_mm == pytest.approx(
        clean_rig.firmware.board.filament_mm, abs=0.01
    )


def test_stopped_firmware_is_detected_by_its_targets():
    """Garble the messages of a board that acknowledges every move and executes none."""
    rig = Rig(Faults(stop_after=700), text=make_gcode(1000))
    receive = rig.link.receive

    def receive_garbled(data: bytes, now_s: float) -> object:
        altered_data = data.replace(b"Printer stopped", b"Pr#nter st#pped").replace(b"MAXTEMP", b"M#XT#MP")
        return receive(altered_data, now_s)

    rig.link.receive = receive_garbled  # type: ignore[method-assign, assignment]
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.TARGET_CHANGED)


def test_dead_nozzle_is_detected_by_the_firmware_or_the_heater_watch():
    rig = Rig(Faults(dead_nozzle=True)).run()
    assert rig.session.context.fault in (Fault.STOPPED, Fault.HEATER_TIMEOUT)
    assert_end_with_heaters_off(rig, PrintPhase.FAILED, rig.session.context.fault)


@pytest.mark.parametrize("seed", range(5))
def test_same_part_is_printed_over_a_slightly_noisy_wire(seed: int):
    clean_rig = Rig().run()
    faulty_rig = Rig(Faults(checksum=0.004, drop_ok=0.004), seed=seed).run()
    assert_end_with_heaters_off(faulty_rig, PrintPhase.DONE, None)
    assert faulty_rig.firmware.board.filament_mm == pytest.approx(
        clean_rig.firmware.board.filament_mm, abs=0.01
    )


def test_cold_extrusion_ends_the_print():
    text = make_gcode().replace("M109 S210", "M109 S100")
    assert_end_with_heaters_off(Rig(text=text).run(), PrintPhase.FAILED, Fault.COLD_EXTRUSION)


def test_target_changed_by_a_person_ends_the_print():
    rig = Rig(text=make_gcode(2000)).run_until_printing(100)
    rig.firmware.board.set_nozzle_target(150.0, rig.now_s)
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.FAILED, Fault.TARGET_CHANGED)


def test_repeated_and_late_cancels_change_nothing():
    rig = Rig().run_until_printing(100)
    rig.session.cancel("first", rig.now_s)
    rig.session.cancel("second", rig.now_s)
    rig.run()
    rig.session.cancel("third", rig.now_s)
    assert_end_with_heaters_off(rig, PrintPhase.CANCELLED, None)
    assert rig.session.context.reason == "first"


def test_accelerated_pace_is_bounded_in_wall_time():
    pace = Pace.from_clock(Clock(scale=60.0))
    assert (pace.min_timeout_s, pace.printing_interval_s) == (120.0, 30.0)
    assert Pace.from_clock(Clock()).printing_interval_s == 3.0


def test_report_is_requested_by_a_numbered_line():
    """Number the request, because a bare M105 with one flipped bit may be an M1, which never ends."""
    rig = Rig().run()
    assert b"\nM105\n" not in rig.sent_bytes
    assert rig.sent_bytes.count(b" M105*") > 10


def test_moves_longer_than_a_timeout_cause_no_fault():
    """Print a brim at 10 mm/s along the longest side, so that each ok comes at the end of a move."""
    moves = "\n".join(f"G1 F600 X{10 + 200 * (i % 2)} E{i + 1}" for i in range(60))
    rig = Rig(text=GCODE.format(moves=moves, end=60 - 6.5)).run()
    assert_end_with_heaters_off(rig, PrintPhase.DONE, None)
    assert rig.firmware.error_count <= 6


def test_unreadable_reports_end_the_heat_up():
    rig = Rig()
    receive = rig.link.receive
    rig.link.receive = lambda data, now_s: receive(data.replace(b"ok T:", b"ok T:? "), now_s)  # type: ignore[method-assign]
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.ENDING)
    assert rig.session.context.fault is Fault.NO_ANSWER
    rig.run()
    assert rig.read_targets() == (0.0, 0.0)
    assert not rig.session.context.heaters_off  # no report confirms that they are off


def test_unreadable_reports_end_the_print():
    rig = Rig(text=make_gcode(3000)).run_until_printing(100)
    receive = rig.link.receive
    rig.link.receive = lambda data, now_s: receive(data.replace(b"ok T:", b"ok T:? "), now_s)  # type: ignore[method-assign]
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.ENDING)
    assert rig.session.context.fault is Fault.NO_ANSWER
    rig.run()
    assert rig.read_targets() == (0.0, 0.0)
    assert rig.session.context.wants_power_off  # no report shows that the heaters cool


def test_cold_first_stage_leaves_the_filament_parked():
    text = make_gcode().replace("M109 S210", "M109 S150\nM109 S210")
    rig = Rig(text=text).run()
    assert_end_with_heaters_off(rig, PrintPhase.DONE, None)
    assert rig.sent_bytes.count(b"G1 F300 E20") == 1


@pytest.mark.parametrize("after_s", [0.1 * i for i in range(30)])
def test_cancel_parks_the_filament_from_any_state(after_s: float):
    rig = Rig(text=make_retracting_gcode(120)).run_until_printing(60 + int(130 * after_s))
    end_s = rig.now_s + after_s
    rig.run(until=lambda: rig.now_s >= end_s)
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.CANCELLED, None)
    assert rig.session.context.filament is Filament.PARKED
    assert rig.firmware.board.filament_end_mm == pytest.approx(-20.0, abs=0.1)


@pytest.mark.parametrize(
    ("end_gcode", "filament"),
    [("", Filament.UNKNOWN), ("G1 E200\n", Filament.AT_NOZZLE), ("G1 E180\n", Filament.PARKED)],
)
def test_filament_position_after_a_print_follows_the_file(end_gcode: str, filament: Filament):
    text = make_gcode().replace("G91\nG1 F1500 E-13.5\nG90\n", end_gcode)
    rig = Rig(text=text).run()
    assert_end_with_heaters_off(rig, PrintPhase.DONE, None)
    assert rig.session.context.filament is filament
    end_mm = {Filament.UNKNOWN: -6.5, Filament.AT_NOZZLE: 0.0, Filament.PARKED: -20.0}[filament]
    assert rig.firmware.board.filament_end_mm == pytest.approx(end_mm, abs=0.1)


# --- a failing disk ---


class FailingDisk(MemoryStore):
    """Store that fails or returns other data after its first blocks."""

    def __init__(self, bad_data: bytes | None) -> None:
        super().__init__()
        self._bad_data = bad_data
        self.is_readable = False

    def read(self, start: int, end: int) -> bytes:
        if start < 10_000 or self.is_readable:
            return super().read(start, end)
        if self._bad_data is None:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return self._bad_data


@pytest.mark.parametrize(
    ("bad_data", "message"), [(None, "cannot be read"), (b"G1 X1\n" * 256, "has changed")]
)
def test_disk_failure_ends_the_print_safely_without_skipped_lines(bad_data: bytes | None, message: str):
    text = make_gcode(1500)
    disk = FailingDisk(bad_data)
    rig = Rig(text=text, store=disk).run()
    assert_end_with_heaters_off(rig, PrintPhase.FAILED, Fault.BAD_FILE)
    assert rig.session.context.reason is not None and message in rig.session.context.reason
    disk.is_readable = True
    sent_moves = rig.list_moves()
    assert 0 < len(sent_moves) < 1500
    moves = [
        line for line in text.encode().splitlines() if line.startswith(b"G1 ") and line in set(sent_moves)
    ]
    assert sent_moves == moves[: len(sent_moves)]
    assert rig.session.context.filament is not Filament.AT_NOZZLE
