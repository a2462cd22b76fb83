"""The firmware's rules, one by one, against what was observed of it (docs: um2-serial)."""

from __future__ import annotations

import math
import random
from functools import reduce
from operator import xor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulator.faults import Faults
from drivers.emulator.firmware import Firmware
from drivers.emulator.listener import Phase
from drivers.profiles import PROFILES
from drivers.replies import checksum

STOPPED = (
    "Printer stopped due to errors. Fix the error and use M999 to restart. "
    "(Temperature is reset. Set it after restarting)"
)


class Host:
    """Someone at the other end of the line, with time in hand."""

    def __init__(
        self, model: str = "ultimaker2_plus", faults: Faults | None = None, boot: bool = True
    ) -> None:
        self.firmware = Firmware(PROFILES[model], faults or Faults(), random.Random(1), 0.0)
        self.board = self.firmware.board
        self.now_s = 0.0
        self.n = 0
        if boot:
            self.wait(5.0)

    def wait(self, seconds: float) -> list[str]:
        """The lines said in the next seconds."""
        return self.until(self.now_s + seconds)

    def until(self, end_s: float) -> list[str]:
        out = b""
        while (due_s := self.firmware.deadline_s()) <= end_s:
            self.now_s = max(self.now_s, due_s)
            out += self.firmware.feed(b"", self.now_s)
        self.now_s = end_s
        out += self.firmware.feed(b"", end_s)
        return out.decode("latin-1").splitlines()

    def put(self, *lines: str) -> list[str]:
        """Send lines in one burst; what is answered at once."""
        data = "".join(f"{line}\n" for line in lines).encode("latin-1")
        return self.firmware.feed(data, self.now_s).decode("latin-1").splitlines()

    def say(self, line: str, seconds: float = 600.0) -> list[str]:
        """Send a line and wait for its ok (that may be glued behind other words)."""
        said = self.put(line)
        end_s = self.now_s + seconds
        while not any(word.endswith("ok") or word.startswith("ok") for word in said):
            due_s = self.firmware.deadline_s()
            assert due_s <= end_s, f"no ok to {line!r}, only {said}"
            said += self.until(due_s)
        return said

    def number(self, body: str) -> list[str]:
        """Send a line with number and checksum."""
        self.n += 1
        return self.say(numbered(self.n, body))

    def warm(self, nozzle_c: float = 210.0) -> None:
        self.say(f"M109 S{nozzle_c}")


def numbered(n: int, body: str) -> str:
    line = f"N{n} {body}"
    return f"{line}*{reduce(xor, line.encode())}"


@pytest.fixture
def host() -> Host:
    return Host()


# --- boot ---


def test_the_banner_comes_a_second_after_power_and_the_card_fails_2_3_s_later() -> None:
    host = Host(boot=False)
    assert host.until(0.99) == []
    said = host.until(1.05)
    assert said[:3] == [
        "start",
        "echo:Marlin 1.0.0",
        "echo: Last Updated: Mar 15 2018 13:04:08 | Author: Vers:_3.3.0",
    ]
    assert "echo: Free Memory: 2055  PlannerBufferBytes: 1232" in said
    assert "echo:  M92 X80.00 Y80.00 Z200.00 E369.00" in said
    assert "echo:  M201 X9000 Y9000 Z100 E10000" in said
    assert said[-1] == "echo:   M301 P10.03 I1.50 D70.00"
    assert host.until(3.29) == []
    assert host.until(3.31) == ["echo:SD init fail"]


def test_what_is_sent_to_the_bootloader_is_lost_and_what_comes_later_waits() -> None:
    host = Host(boot=False)
    host.until(0.5)
    assert host.put("M105") == []
    host.until(1.1)
    assert host.put("M114") == []
    said = host.until(3.0)
    assert [line for line in said if line.startswith(("ok", "X:"))][1:] == ["ok"]
    assert not any("T:" in line for line in said)


def test_the_extended_model_tells_itself_by_its_banner_and_by_its_height() -> None:
    host = Host("ultimaker2_extended_plus", boot=False)
    assert any(line.endswith("Vers:_3.3.0ex") for line in host.until(2.0))
    host.until(5.0)
    host.say("G28")
    assert host.say("M114")[0].startswith("X:0.00Y:224.50Z:315.00E:0.00 Count X: 0.00Y:224.50Z:315.00")


# --- answers ---


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("M105", ["ok T:21.0 /0.0 B:21.0 /0.0 @:0 B@:0"]),
        ("M119", ["Reporting endstop status", "x_min: openy_max: openz_max: openok"]),
        ("M27", ["Not SD printing", "Card error:1", "ok"]),
        ("M20", ["Begin file list", "End file list", "ok"]),
        ("M21", ["echo:SD init fail", "ok"]),
        ("T0", ["echo:Active Extruder: 0", "ok"]),
        ("T1", ["echo:T\x01Invalid extruder", "ok"]),
        ("HELLO", ['echo:Unknown command: "HELLO"', "ok"]),
        ("g1 x1", ['echo:Unknown command: "g1 x1"', "ok"]),
        *(
            (code, ["ok"])
            for code in [
                "M112",
                "M108",
                "M410",
                "M125",
                "M600",
                "M155",
                "M118",
                "M73",
                "M113",
                "G29",
                "G80",
                "M9999",
            ]
        ),
        *(
            (code, ["ok"])
            for code in ["M23", "M24", "M25", "M26", "M28", "M29", "M30", "M923", "M928", "M107"]
        ),
    ],
)
def test_an_answer_has_the_firmwares_own_words(host: Host, line: str, answer: list[str]) -> None:
    assert host.say(line) == answer


def test_it_names_itself_without_capabilities(host: Host) -> None:
    said = host.say("M115")
    assert said[0].startswith("FIRMWARE_NAME:Marlin Ultimaker2; Sprinter/grbl mashup for gen6 FIRMWARE_URL:")
    assert said[0].endswith("PROTOCOL_VERSION:1.0 MACHINE_TYPE:Ultimaker EXTRUDER_COUNT:1")
    assert said[1:] == ["ok"]


def test_the_position_is_the_last_target_and_the_count_is_where_the_head_is(host: Host) -> None:
    host.say("G28")
    host.say("G1 X100 F6000")  # 100 mm/s
    host.wait(0.5)
    asked, count = host.say("M114")[0].split(" Count X: ")
    assert asked == "X:100.00Y:224.50Z:215.00E:0.00"
    assert 40 < float(count.split("Y:")[0]) < 60
    host.say("M400")
    assert host.say("M114")[0] == "X:100.00Y:224.50Z:215.00E:0.00 Count X: 100.00Y:224.50Z:215.00"


def test_homing_from_the_middle_is_5_3_s_of_silence(host: Host) -> None:
    host.say("G28")
    for line in ("G1 X115 Y112.25 Z107.5 F9000", "M400"):
        host.say(line)
    assert host.put("G28") == []
    assert host.wait(5.2) == []
    assert host.wait(0.2) == ["ok"]


def test_homing_one_axis_leaves_the_others(host: Host) -> None:
    host.say("G28")
    host.say("G1 X50 Y60 Z70 F9000")
    host.say("G28 X0 Y0")
    assert host.say("M114")[0].startswith("X:0.00Y:224.50Z:70.00")


# --- moves ---


def test_out_of_reach_is_silently_clamped(host: Host) -> None:
    assert host.say("G1 X500 Y-50 Z400") == ["ok"]
    assert host.say("M114")[0].startswith("X:230.00Y:0.00Z:225.00")


def test_cold_extrusion_is_refused_after_its_ok_and_counted_all_the_same(host: Host) -> None:
    assert host.put("G1 E5 F300") == ["ok", "echo: cold extrusion prevented"]
    assert "E:5.00" in host.say("M114")[0]
    host.wait(10.0)
    assert host.board.filament_mm == 0.0


def test_a_metre_at_once_is_refused(host: Host) -> None:
    host.warm()
    assert host.put("G1 E1001 F300") == ["ok", "echo: too long extrusion prevented"]


def test_a_move_is_acknowledged_when_parsed_and_all_else_when_done(host: Host) -> None:
    """The oks of both moves come before the answer to the M105 in front of them."""
    assert host.put("G28", "M105", "G1 X10 F6000", "M114", "G1 X20") == ["ok", "ok"]
    said = host.wait(30.0)
    assert said[0] == "ok" and said[1].startswith("ok T:") and said[2].startswith("X:10.00")
    assert said[3:] == ["ok"]


def test_seventeen_moves_are_acknowledged_at_once_then_one_for_each_that_ends(host: Host) -> None:
    oks = 0
    for k in range(40):
        if host.put(f"G1 X{20 if k % 2 else 220} F6000") != ["ok"]:
            break
        oks += 1
    assert oks == 17
    assert host.put() == []
    for expected in (1, 1, 1):
        due_s = host.firmware.deadline_s()
        assert host.until(due_s) == ["ok"] * expected
        host.put("G1 X100 F6000")


def test_a_late_host_does_not_stretch_what_is_queued() -> None:
    ends = []
    for late_s in (0.0, 0.15):
        host = Host()
        for k in range(1, 60):
            said = host.put(f"G1 X{2 * k} F1200")  # 0.1 s each
            while "ok" not in said:
                said += host.until(host.firmware.deadline_s() + late_s)
        host.say("M400")
        ends.append(host.firmware.machine.planner.idle_since_s)
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


def test_m400_is_done_when_the_last_move_is_and_not_before(host: Host) -> None:
    began_s = host.now_s
    for k in range(1, 11):
        host.put(f"G1 X{10 * k} F600")  # 1 s each
    host.say("M400")
    assert host.now_s == pytest.approx(host.firmware.machine.planner.idle_since_s)
    assert host.now_s - began_s == pytest.approx(10.0, abs=0.5)
    assert host.firmware.printing_s == pytest.approx(host.now_s - began_s)


def test_relative_moves_and_a_new_zero(host: Host) -> None:
    for line in ("G28", "G91", "G1 X5 F3000", "G1 X5 Y-10", "G90", "G92 X100 E7", "G1 X101"):
        host.say(line)
    host.say("M400")
    said = host.say("M114")[0]
    assert said.startswith("X:101.00Y:214.50Z:215.00E:7.00 Count X: 101.00")
    assert host.firmware.machine.planner.position(host.now_s)[0] == pytest.approx(11.0)


def test_an_arc_goes_round(host: Host) -> None:
    for line in ("G28", "G1 X100 Y100 Z100 F9000", "M400"):
        host.say(line)
    before_s = host.firmware.printing_s
    for line in ("G2 X100 Y100 I20 J0 F1200", "M400"):
        host.say(line)
    assert host.firmware.printing_s - before_s == pytest.approx(2 * math.pi * 20 / 20, rel=0.02)


def test_quick_stop_empties_the_planner_and_knows_where_it_is(host: Host) -> None:
    host.say("G28")
    for x in (100, 200, 100, 200):
        host.put(f"G1 X{x} F6000")
    host.wait(0.5)
    assert host.put("M401") == ["ok"]
    asked, count = host.say("M114")[0].removeprefix("X:").split(" Count X: ")
    assert asked.split("Y:")[0] == count.split("Y:")[0]
    assert 40 < float(count.split("Y:")[0]) < 60
    before = host.firmware.machine.planner.position(host.now_s)
    host.wait(10.0)
    assert host.firmware.machine.planner.position(host.now_s) == before


def test_m0_never_comes_back(host: Host) -> None:
    assert host.put("M0", "M105") == []
    assert host.wait(1e6) == []
    host.firmware.reset(host.now_s)
    assert host.wait(2.0)[0] == "start"


# --- heat ---


def test_m109_reports_each_second_and_stays_three(host: Host) -> None:
    began_s = host.now_s
    said = host.say("M109 S60")
    assert [line[-3:] for line in said[-4:-1]] == ["W:2", "W:1", "W:0"] and said[-1] == "ok"
    assert all(line.startswith("T:") and " E:0 W:" in line for line in said[:-1])
    assert said[0].endswith("W:?")
    expected_s = PROFILES["ultimaker2_plus"].nozzle.seconds_to(59.0) + 3.0
    assert host.now_s - began_s == pytest.approx(expected_s, abs=0.05)
    assert len(said) - 1 == int(expected_s)


def test_m109_waits_for_cooling_down_too(host: Host) -> None:
    host.warm(200.0)
    began_s = host.now_s
    host.say("M109 S100")
    assert host.now_s - began_s > 60.0
    assert host.board.nozzle.temperature_c(host.now_s) < 101.0


def test_m190_reports_the_bed_and_is_done_at_once_when_hotter(host: Host) -> None:
    said = host.say("M190 S40", 5000)
    assert said[0].startswith("T:21.00 E:0 B:21.") and said[-1] == "ok"
    assert host.put("M190 S30") == ["ok"]


def test_temperatures_are_reported_with_their_targets(host: Host) -> None:
    host.say("M104 S210")
    host.say("M140 S60")
    assert host.say("M105")[0].startswith("ok T:21.0 /210.0 B:21.0 /60.0 @:127 B@:")
    host.wait(30.0)
    assert host.say("M105")[0].endswith("@:127 B@:127")


# --- numbers and checksums ---


def test_a_repeated_or_skipped_number_asks_for_the_next(host: Host) -> None:
    assert host.number("M110") == ["ok"]
    assert host.number("G4 P0") == ["ok"]
    for n in (2, 7):
        assert host.put(numbered(n, "G28")) == [
            "Error:Line Number is not Last Line Number+1, Last Line: 2",
            "Resend: 3",
            "ok",
        ]
    assert not host.firmware.machine.homed


def test_a_bad_checksum_asks_for_the_same_line(host: Host) -> None:
    assert host.put("N1 G28*1") == ["Error:checksum mismatch, Last Line: 0", "Resend: 1", "ok"]


def test_a_number_without_checksum_asks_for_the_same_line(host: Host) -> None:
    assert host.put("N1 G28") == ["Error:No Checksum with line number, Last Line: 0", "Resend: 1", "ok"]


def test_a_checksum_without_number_gets_no_ok_at_all(host: Host) -> None:
    assert host.put("M105*12") == ["Error:No Line Number with checksum, Last Line: 0"]
    assert host.wait(60.0) == []


def test_an_error_flushes_what_came_behind_it(host: Host) -> None:
    burst = ["N1 G4 P0*99", *(numbered(n, "G4 P0") for n in (2, 3, 4))]
    assert host.put(*burst) == ["Error:checksum mismatch, Last Line: 0", "Resend: 1", "ok"]
    assert host.put(numbered(1, "G4 P0")) == ["ok"]


@pytest.mark.parametrize(
    ("line", "then"), [("N100 M110*34", 101), ("N0 M110 N0*125", 1), ("N-1 M110*15", 0), ("N0 M110*35", 1)]
)
def test_m110_sets_the_line_number(host: Host, line: str, then: int) -> None:
    assert host.put(line) == ["ok"]
    assert host.put(numbered(then, "G4 P0")) == ["ok"]


def test_m110_without_checksum_is_an_error(host: Host) -> None:
    assert host.put("M110 N100")[1] == "Resend: 1"


def test_unnumbered_lines_may_be_mixed_in(host: Host) -> None:
    assert host.number("G4 P0") == ["ok"]
    assert host.say("M105")[0].startswith("ok T:")
    assert host.number("G4 P0") == ["ok"]


# --- traps ---


def test_a_comment_swallows_its_own_line_and_the_next(host: Host) -> None:
    assert host.put("M105 ;why", "M114", "M27") == ["Not SD printing", "Card error:1", "ok"]
    assert host.firmware.feed(b"M105 ;why\r\nM27\r\n", host.now_s).startswith(b"Not SD")
    assert host.put(";nothing", "", "M27")[-1] == "ok"


def test_a_colon_ends_a_line(host: Host) -> None:
    assert host.put("M117 ETA 12:30") == ["ok", 'echo:Unknown command: "30"', "ok"]


def test_letters_are_found_anywhere(host: Host) -> None:
    assert host.put("M117 Go X5") == ["ok"]
    assert host.say("M114")[0].startswith("X:5.00")
    assert host.put("M117 Nozzle")[0].startswith("Error:Line Number is not Last Line Number+1")
    assert host.put("M1\x0005") == []  # a NUL ends it: M1 waits for ever


def test_one_command_a_line(host: Host) -> None:
    assert host.put("G91 M114") == ["ok"]


def test_a_line_is_cut_at_95_characters(host: Host) -> None:
    assert host.put("M117 " + "a" * 90) == ["ok"]
    said = host.put("M117 " + "a" * 95)
    assert said == ["ok", 'echo:Unknown command: "aaaa"', "ok"]


def test_a_full_ring_loses_bytes_without_a_word(host: Host) -> None:
    line = "M105" + " " * 57  # with its newline 62 bytes: two fit the ring's 127, the third loses its end
    assert host.put("G4 S5") == []
    assert host.put(line, line, line) == []
    said = host.wait(10.0)
    assert [word[:5] for word in said] == ["ok", "ok T:", "ok T:"]


# --- stop, kill, reset ---


def test_stopped_it_takes_moves_with_an_ok_and_heats_again_all_the_same() -> None:
    host = Host(faults=Faults(stop_after=3))
    host.say("M140 S60")
    host.say("M104 S210")
    host.say("G4 P0")
    said = host.wait(1.0)
    assert host.board.nozzle.target_c == host.board.bed.target_c == 0.0
    assert host.put("G1 X5") == [STOPPED, "ok"]
    assert host.say("M104 S200") == ["ok"]
    assert host.board.nozzle.target_c == 200.0
    host.say("G28")
    assert host.firmware.machine.homed
    assert said == []


def test_an_open_sensor_stops_the_print_with_its_words() -> None:
    host = Host(faults=Faults(stop_after=1))
    said = host.put("G4 P0")
    assert said == ["Error:0", ": Extruder switched off. MAXTEMP triggered !", f"Error:{STOPPED}", "ok"]
    assert host.put("M999") == ["Resend: 1", "ok", "ok"]
    assert host.put("G1 X5") == ["ok"]


def test_a_target_beyond_275_degrees_trips(host: Host) -> None:
    host.say("M104 S300")
    said = host.wait(1000.0)
    assert said[:2] == ["Error:0", ": Extruder switched off. MAXTEMP triggered !"]
    assert host.board.nozzle.target_c == 0.0


def test_a_dead_nozzle_is_noticed_after_30_s_and_m109_goes_on() -> None:
    host = Host(faults=Faults(dead_nozzle=True))
    began_s = host.now_s
    said = host.say("M109 S210")
    assert f"Error:{STOPPED}" in said and said[-1] == "ok"
    assert host.now_s - began_s == pytest.approx(33.0, abs=1.1)


def test_a_dead_bed_is_never_noticed() -> None:
    host = Host(faults=Faults(dead_bed=True))
    host.put("M190 S60")
    said = host.wait(3600.0)
    assert len(said) > 3500 and all(line.startswith("T:21.00 E:0 B:21.0") for line in said)


def test_the_dead_man_kills_and_the_watchdog_resets(host: Host) -> None:
    host.say("M104 S210")
    host.say("M85 S30")
    host.wait(20.0)
    host.say("M105")  # does not feed it
    assert host.wait(9.9) == []
    assert host.wait(0.2) == ["Error:Printer halted. kill() called!"]
    assert host.board.nozzle.target_c == 0.0
    assert host.put("M105") == []
    assert host.wait(3.9) == []
    assert host.wait(0.2)[0] == "start"
    assert host.wait(100.0) == ["echo:SD init fail"]  # and the dead-man is off again


def test_the_dead_man_gives_a_late_reader_the_benefit(host: Host) -> None:
    """Bytes and the end of the wait that are noticed at once: the bytes were there."""
    host.say("M85 S30")
    host.now_s += 31.0
    assert host.put("M105")[0].startswith("ok T:")


def test_a_reset_forgets_all_but_what_is_there(host: Host) -> None:
    host.warm()
    for line in ("G28", "M85 S900", "G1 X100 Y100 Z100 F9000", "M400", "G1 E40 F300"):
        host.number(line)
    host.wait(2.0)
    fed_mm = host.board.filament_mm
    host.firmware.reset(host.now_s)
    assert 0 < host.board.filament_mm < 40 and host.board.filament_mm >= fed_mm
    assert host.board.nozzle.target_c == 0.0 and host.board.nozzle.temperature_c(host.now_s) > 200.0
    assert not host.firmware.machine.homed
    assert host.board.head_mm == pytest.approx((100, 100, 100))
    host.wait(5.0)
    assert host.say("M114")[0].startswith("X:0.00Y:0.00Z:0.00E:0.00")
    assert host.put(numbered(6, "G4 P0"))[:2] == [
        "Error:Line Number is not Last Line Number+1, Last Line: 0",
        "Resend: 1",
    ]


def test_without_a_host_moves_and_heat_go_on(host: Host) -> None:
    host.say("M104 S210")
    host.say("G28")
    host.say("G1 X200 F600")
    host.wait(3600.0)
    assert host.board.nozzle.target_c == 210.0
    assert host.firmware.machine.planner.position(host.now_s)[0] == 200.0


# --- bed, filament, starvation ---


def unretract(host: Host) -> None:
    host.warm()
    for line in ("G28", "G92 E0", "G1 E20 F300", "G92 E0", "M400"):
        host.say(line)


def test_bringing_parked_filament_to_the_nozzle_leaves_the_bed_clear(host: Host) -> None:
    assert host.board.filament_end_mm == -20.0
    for line in ("G28", "G1 Z5 F2400"):
        host.say(line)
    host.warm()
    for line in ("G92 E0", "G1 E20 F300", "M400"):
        host.say(line)
    assert host.board.filament_end_mm == pytest.approx(0.0) and host.board.bed_clear


def test_extruding_over_the_bed_makes_it_not_clear_until_a_person_clears_it(host: Host) -> None:
    unretract(host)
    for line in ("G1 X50 Y50 Z0.3 F9000", "G1 X100 E2 F1500", "M400"):
        host.say(line)
    assert not host.board.bed_clear
    host.firmware.reset(host.now_s)
    assert not host.board.bed_clear
    host.board.clear_bed()
    assert host.board.bed_clear


def test_purging_with_the_bed_all_the_way_down_is_a_persons_own_affair(host: Host) -> None:
    unretract(host)
    host.say("G1 E30 F300")
    host.say("M400")
    assert host.board.bed_clear


def test_a_retraction_and_its_end_move_the_filament_and_print_nothing(host: Host) -> None:
    unretract(host)
    for line in ("G1 Z0.3 F9000", "G10", "M400"):
        host.say(line)
    assert host.board.filament_end_mm == pytest.approx(-6.5)
    for line in ("G11", "M400"):
        host.say(line)
    assert host.board.filament_end_mm == pytest.approx(0.0) and host.board.bed_clear


def stream(host: Host, pause_s: float) -> None:
    for k in range(1, 40):
        said = host.put(f"G1 X{50 + k} E{k * 0.05:.3f} F3000")
        while "ok" not in said:
            said += host.until(host.firmware.deadline_s())
        if k == 20:
            host.wait(pause_s)


def test_a_queue_that_runs_dry_in_a_print_is_starved(host: Host) -> None:
    unretract(host)
    host.say("G1 X50 Y50 Z0.3 F9000")
    stream(host, 0.0)
    assert host.firmware.starved_s == 0.0
    stream(host, 5.0)
    assert 4.0 < host.firmware.starved_s < 5.0
    starved_s = host.firmware.starved_s
    host.say("M400")
    host.wait(100.0)
    host.say("G1 X100 F3000")
    assert host.firmware.starved_s == starved_s  # who waits for the end of the moves, does not print


# --- faults on lines ---


def test_flipped_bytes_are_refused_and_asked_for_again() -> None:
    host = Host(faults=Faults(checksum=0.3))
    done, tries = 0, 0
    while done < 200:
        tries += 1
        said = host.put(numbered(done + 1, "G4 P0"))
        if not said or said[0] != "ok":
            continue  # nothing, or an error: the line has to be sent again
        done += 1
    assert host.firmware._last_n == 200
    assert 230 < tries < 400 and host.firmware.errors == tries - 200


def test_lost_oks_are_lost_and_nothing_else() -> None:
    host = Host(faults=Faults(drop_ok=0.25))
    answered = sum(host.put(numbered(n, "G4 P0")) == ["ok"] for n in range(1, 401))
    assert 250 < answered < 350
    assert host.firmware.lines == 400


def test_a_brown_out_resets_the_board_unasked() -> None:
    host = Host(faults=Faults(reset_after=3))
    host.say("M104 S210")
    host.say("G4 P0")
    host.put("G4 P0")
    assert host.board.nozzle.target_c == 0.0
    assert host.wait(2.0)[0] == "start"
    assert host.firmware.resets == 1
    host.wait(3.0)
    for _ in range(5):
        assert host.say("G4 P0") == ["ok"]


def test_a_mute_board_goes_on_heating_until_it_is_reset() -> None:
    host = Host(faults=Faults(silent_after=2))
    host.say("M104 S210")
    assert host.put("G4 P0") == []
    assert host.put("M105") == [] and host.wait(600.0) == []
    assert host.board.nozzle.temperature_c(host.now_s) == pytest.approx(210.0)
    assert host.firmware.phase is Phase.MUTE
    host.firmware.reset(host.now_s)
    assert host.wait(2.0)[0] == "start"


def test_the_same_seed_gives_the_same_day() -> None:
    days = []
    for _ in range(2):
        host = Host(faults=Faults(checksum=0.2, drop_ok=0.2))
        days.append([host.put(numbered(n, "G4 P0")) for n in range(1, 60)])
    assert days[0] == days[1]


# --- laws ---


@given(st.binary(max_size=96))
def test_the_folded_checksum_is_the_xor_of_all_bytes(line: bytes) -> None:
    assert checksum(line) == reduce(xor, line, 0)


@given(st.lists(st.binary(max_size=60), max_size=20))
@settings(deadline=None)
def test_no_bytes_at_all_bring_it_down(chunks: list[bytes]) -> None:
    host = Host()
    for chunk in chunks:
        host.firmware.feed(chunk, host.now_s)
        host.wait(0.5)
    host.firmware.reset(host.now_s)
    host.wait(5.0)
    assert host.say("M105")[0].startswith("ok T:")


GCODES = (0, 1, 2, 3, 4, 10, 11, 28, 90, 91, 92)
MCODES = (82, 83, 84, 85, 92, 104, 105, 106, 109, 110, 114, 119, 140, 190, 201, 203, 204, 205, 220, 221)
MORE_MCODES = (300, 302, 400, 401, 503, 601, 999)
codes = st.sampled_from([*(f"G{n}" for n in GCODES), *(f"M{n}" for n in (*MCODES, *MORE_MCODES)), "T0", "T1"])
numbers = st.one_of(
    st.floats(-1e4, 1e4).map(lambda number: f"{number:.3f}"),
    st.sampled_from(["", "0", "-0", "-1", "1e9", "9e99", "1e999", "nan", "-.", "0.0001", "9" * 60]),
)
words = st.lists(st.tuples(st.sampled_from("XYZEFSPIJT"), numbers).map("".join), max_size=4)


@given(st.lists(st.tuples(codes, words), max_size=25), st.floats(0.01, 1e4))
@settings(deadline=None)
def test_no_command_with_any_numbers_brings_it_down(
    commands: list[tuple[str, list[str]]], pause_s: float
) -> None:
    host = Host()
    for code, parameters in commands:
        host.put(" ".join([code, *parameters]))
        host.now_s += pause_s
        host.firmware.feed(b"", host.now_s)
        assert all(map(math.isfinite, host.firmware.machine.planner.position(host.now_s)))
        assert host.firmware.printing_s <= host.now_s
    host.firmware.reset(host.now_s)
    host.wait(5.0)
    assert host.say("M105")[0].startswith("ok T:")


axis = st.one_of(st.none(), st.floats(-20, 250).map(lambda number: round(number, 3)))
feedrate = st.sampled_from([None, -1.0, 0.0, 600.0, 3000.0, 12000.0])


@given(st.lists(st.tuples(feedrate, axis, axis, axis, axis), min_size=1, max_size=30))
@settings(deadline=None)
def test_the_short_way_of_a_move_is_the_long_way(moves: list[tuple[float | None, ...]]) -> None:
    """A well-formed numbered move skips the line buffer; two spaces are enough to send it the long way."""
    ends = []
    for gap in (" ", "  "):
        host = Host()
        host.say("M302 S0")
        for words in moves:
            body = gap.join(
                ["G1", *(f"{a}{v}" for a, v in zip("FXYZE", words, strict=True) if v is not None)]
            )
            host.number(body)
        host.say("M400", 1e4)
        ends.append((host.say("M114"), host.firmware.printing_s, host.board.filament_mm, host.now_s))
    assert ends[0] == ends[1]
