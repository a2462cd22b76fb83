"""Reading of lines by the firmware: numbers, checksums, special cases, and faults of the wire."""

from __future__ import annotations

from functools import reduce
from operator import xor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulator.faults import Faults
from drivers.gcode import compute_checksum
from printers.firmware_host import Host, add_number


@pytest.fixture
def host() -> Host:
    return Host()


def test_repeated_or_skipped_number_requests_the_next_line(host: Host) -> None:
    assert host.send_numbered("M110") == ["ok"]
    assert host.send_numbered("G4 P0") == ["ok"]
    for n in (2, 7):
        assert host.send_burst(add_number(n, "G28")) == [
            "Error:Line Number is not Last Line Number+1, Last Line: 2",
            "Resend: 3",
            "ok",
        ]
    assert not host.firmware.machine.is_homed


def test_bad_checksum_requests_the_same_line(host: Host) -> None:
    assert host.send_burst("N1 G28*1") == ["Error:checksum mismatch, Last Line: 0", "Resend: 1", "ok"]


def test_number_without_checksum_requests_the_same_line(host: Host) -> None:
    assert host.send_burst("N1 G28") == [
        "Error:No Checksum with line number, Last Line: 0",
        "Resend: 1",
        "ok",
    ]


def test_checksum_without_number_gets_no_ok(host: Host) -> None:
    assert host.send_burst("M105*12") == ["Error:No Line Number with checksum, Last Line: 0"]
    assert host.wait(60.0) == []


def test_error_discards_the_bytes_after_it(host: Host) -> None:
    burst = ["N1 G4 P0*99", *(add_number(n, "G4 P0") for n in (2, 3, 4))]
    assert host.send_burst(*burst) == ["Error:checksum mismatch, Last Line: 0", "Resend: 1", "ok"]
    assert host.send_burst(add_number(1, "G4 P0")) == ["ok"]


@pytest.mark.parametrize(
    ("line", "next_number"),
    [("N100 M110*34", 101), ("N0 M110 N0*125", 1), ("N-1 M110*15", 0), ("N0 M110*35", 1)],
)
def test_m110_sets_the_line_number(host: Host, line: str, next_number: int) -> None:
    assert host.send_burst(line) == ["ok"]
    assert host.send_burst(add_number(next_number, "G4 P0")) == ["ok"]


def test_m110_without_checksum_is_an_error(host: Host) -> None:
    assert host.send_burst("M110 N100")[1] == "Resend: 1"


def test_rest_of_a_truncated_line_is_lost_once(host: Host) -> None:
    host.send("M104 S210")
    off_lines = "\nM104 S0\nM140 S0"
    host.send_burst(f"N1 G1 X5 Y{off_lines}")
    assert host.board.nozzle.target_c == 210.0
    host.send_burst(off_lines)
    assert host.board.nozzle.target_c == 0.0


def test_unnumbered_lines_are_accepted_among_numbered_lines(host: Host) -> None:
    assert host.send_numbered("G4 P0") == ["ok"]
    assert host.send("M105")[0].startswith("ok T:")
    assert host.send_numbered("G4 P0") == ["ok"]


def test_comment_discards_its_line_and_the_next(host: Host) -> None:
    assert host.send_burst("M105 ;why", "M114", "M27") == ["Not SD printing", "Card error:1", "ok"]
    assert host.firmware.feed(b"M105 ;why\r\nM27\r\n", host.now_s).startswith(b"Not SD")
    assert host.send_burst(";nothing", "", "M27")[-1] == "ok"


def test_colon_ends_a_line(host: Host) -> None:
    assert host.send_burst("M117 ETA 12:30") == ["ok", 'echo:Unknown command: "30"', "ok"]


def test_letters_are_found_anywhere_in_a_line(host: Host) -> None:
    assert host.send_burst("M117 Go X5") == ["ok"]
    assert host.send("M114")[0].startswith("X:5.00")
    assert host.send_burst("M117 Nozzle")[0].startswith("Error:Line Number is not Last Line Number+1")
    assert host.send_burst("M1\x0005") == []  # a NUL ends the line: M1 waits forever


def test_one_command_is_read_per_line(host: Host) -> None:
    assert host.send_burst("G91 M114") == ["ok"]


def test_line_is_cut_at_95_characters(host: Host) -> None:
    assert host.send_burst("M117 " + "a" * 90) == ["ok"]
    answers = host.send_burst("M117 " + "a" * 95)
    assert answers == ["ok", 'echo:Unknown command: "aaaa"', "ok"]


def test_full_ring_loses_bytes_silently(host: Host) -> None:
    line = "M105" + " " * 57  # 62 bytes with its newline: two lines fit into the ring of 127 bytes
    assert host.send_burst("G4 S5") == []
    assert host.send_burst(line, line, line) == []
    answers = host.wait(10.0)
    assert [answer[:5] for answer in answers] == ["ok", "ok T:", "ok T:"]


def test_flipped_bytes_are_refused_and_requested_again() -> None:
    host = Host(faults=Faults(checksum=0.3))
    executed_count, try_count = 0, 0
    while executed_count < 200:
        try_count += 1
        answers = host.send_burst(add_number(executed_count + 1, "G4 P0"))
        if not answers or answers[0] != "ok":
            continue  # without an ok, the line has to be sent again
        executed_count += 1
    assert host.firmware._last_number == 200
    assert 230 < try_count < 400 and host.firmware.error_count == try_count - 200


def test_lost_oks_do_not_affect_other_lines() -> None:
    host = Host(faults=Faults(drop_ok=0.25))
    ok_count = sum(host.send_burst(add_number(n, "G4 P0")) == ["ok"] for n in range(1, 401))
    assert 250 < ok_count < 350
    assert host.firmware.line_count == 400


@given(st.binary(max_size=96))
@settings(deadline=None)
def test_folded_checksum_is_the_xor_of_all_bytes(line: bytes) -> None:
    assert compute_checksum(line) == reduce(xor, line, 0)


@given(st.lists(st.binary(max_size=60), max_size=20))
@settings(deadline=None)
def test_arbitrary_bytes_do_not_crash_the_firmware(chunks: list[bytes]) -> None:
    host = Host()
    for chunk in chunks:
        host.firmware.feed(chunk, host.now_s)
        host.wait(0.5)
    host.firmware.reset(host.now_s)
    host.wait(5.0)
    assert host.send("M105")[0].startswith("ok T:")


axis = st.one_of(st.none(), st.floats(-20, 250).map(lambda number: round(number, 3)))
feedrate = st.sampled_from([None, -1.0, 0.0, 600.0, 3000.0, 12000.0])


@given(st.lists(st.tuples(feedrate, axis, axis, axis, axis), min_size=1, max_size=30))
@settings(deadline=None)
def test_fast_path_of_a_move_equals_the_slow_path(moves: list[tuple[float | None, ...]]) -> None:
    """Compare a well-formed move, which skips the line buffer, with a double-spaced one, which does not."""
    ends = []
    for separator in (" ", "  "):
        host = Host()
        host.send("M302 S0")
        for move in moves:
            body = separator.join(
                ["G1", *(f"{a}{v}" for a, v in zip("FXYZE", move, strict=True) if v is not None)]
            )
            host.send_numbered(body)
        host.send("M400", 1e4)
        ends.append((host.send("M114"), host.firmware.moving_s, host.board.filament_mm, host.now_s))
    assert ends[0] == ends[1]
