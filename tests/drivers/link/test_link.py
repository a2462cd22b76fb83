"""Link with a small firmware, over wires that lose and change bytes.

The rules are those of docs/explanation/ultimaker2-serial.md, section 1.
"""

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import Fault, UnreadableFile
from drivers.firmware import ULTIMAKER2
from drivers.gcode import add_frame
from drivers.link import BoardConnected, Link, Phase, Report, replies
from drivers.link.link import SILENCE_S
from drivers.link.recovery import MAX_ATTEMPTS, MAX_QUERIES
from printers.link_bench import BANNER, Bench, Wire, make_lines, stream_program


def test_frames_equal_those_of_the_documentation():
    assert add_frame(0, b"M110") == b"N0 M110*35\n"


@given(count=st.integers(1, 700), piece_bytes=st.sampled_from([1, 2, 7, 10_000]))
@settings(max_examples=25, deadline=None)
def test_clean_wire_executes_every_line_once_without_resends(count: int, piece_bytes: int):
    bench = Bench(Wire(0.0, 0.0, piece_bytes, 0)).boot()
    program = make_lines(count)
    stream_program(bench, program)
    bench.run()
    assert bench.firmware.executed_lines == list(enumerate(program, 1))
    assert bench.link.streamed_line_count == count
    assert bench.link.resend_count == 0
    assert not bench.list_faults()


def test_stream_ends_at_lines_that_cannot_be_read():
    program, bench = make_lines(600), Bench().boot()

    def read_lines(start: int, stop: int) -> list[bytes]:
        if stop > 300:
            raise UnreadableFile("check the disk")
        return program[start:stop]

    bench.link.stream(bench.now_s, read_lines, 0, len(program))
    bench.run()
    assert str(bench.link.source_error) == "check the disk"
    count = len(bench.firmware.executed_lines)
    assert 0 < count <= 300
    assert bench.firmware.executed_lines == list(enumerate(program[:count], 1))
    assert (bench.link.streamed_line_count, bench.link.is_drained) == (count, True)
    bench.link.send(bench.now_s, b"M104 S0")  # commands may follow at once
    stream_program(bench, program[:5])
    bench.run()
    assert bench.link.source_error is None
    assert [text for _, text in bench.firmware.executed_lines[count:]] == [b"M104 S0", *program[:5]]


def test_resent_line_is_counted_once():
    class LossyWire(Wire):
        """Wire that loses the third line."""

        def transmit(self, data: bytes) -> list[bytes]:
            is_lost = data.startswith(b"N3 ") and not bench.link.resend_count
            return [] if is_lost else super().transmit(data)

    bench = Bench(LossyWire(0.0, 0.0, 10_000, 0)).boot()
    stream_program(bench, make_lines(5))
    bench.run()
    assert (bench.link.resend_count, len(bench.firmware.executed_lines)) == (1, 5)


@given(
    count=st.integers(1, 400),
    loss_share=st.sampled_from([0.0, 0.0002, 0.002]),
    change_share=st.sampled_from([0.0002, 0.001, 0.01]),
    piece_bytes=st.sampled_from([1, 10_000]),
    seed=st.integers(0, 2**32),
)
@settings(max_examples=150, deadline=None)
def test_lossy_wire_executes_lines_once_in_order_or_ends_in_a_named_fault(
    count: int, loss_share: float, change_share: float, piece_bytes: int, seed: int
):
    bench = Bench(Wire(loss_share, change_share, piece_bytes, seed)).boot()
    program = [*make_lines(count), b"M400", b"M400", b"M400"]
    stream_program(bench, program)
    bench.run()
    numbers = [number for number, _ in bench.firmware.executed_lines]
    assert numbers == list(range(1, len(numbers) + 1))
    if bench.link.phase is Phase.DEAD:
        assert set(bench.list_faults()) <= {Fault.NO_ANSWER, Fault.NOISY_LINE, Fault.REBOOT}
    else:
        # With three barriers, a wrong acknowledgement of the last one affects no line of the print.
        assert len(numbers) >= count
        assert bench.link.streamed_line_count == len(program)


@given(st.lists(st.binary(max_size=60), max_size=30))
def test_link_never_raises_for_any_input(noise: list[bytes]):
    bench = Bench().boot()
    stream_program(bench, make_lines(20))
    for data in noise:
        bench.link.receive(data, bench.now_s)
        bench.link.take()
        bench.now_s = max(bench.now_s, min(bench.link.deadline_s, bench.now_s + 100.0))
        bench.link.tick(bench.now_s)


@pytest.mark.parametrize(
    "answer", [b"Resend: %b", b"ok T:%b /0.0 B:20.0 /0.0 @:0 B@:0", b"ok T:20.0 /0.0 B:20.0 /%b @:0 B@:0"]
)
def test_endless_number_is_treated_as_noise(answer: bytes):
    link = Link(ULTIMAKER2)
    link.on_opened(0.0)
    link.receive(BANNER, 0.0)
    assert link.tick(10.0) is not None
    link.poll(10.0)
    link.receive(b"ok\n", 10.0)
    events = link.receive(answer % (b"9" * 5000) + b"\n", 10.0)
    assert not [event for event in events or () if isinstance(event, Report)]


def test_link_sets_the_line_number_and_connects_after_the_banner():
    bench = Bench().boot()
    assert bench.link.take() == b"N0 M110*35\n"
    assert [
        (e.has_restarted, b"Vers:_3.3.0" in e.banner) for e in bench.events if isinstance(e, BoardConnected)
    ] == [(True, True)]


def test_board_that_does_not_restart_is_queried_and_connected():
    bench = Bench()
    bench.link.on_opened(0.0)
    bench.run()
    assert [e.has_restarted for e in bench.events if isinstance(e, BoardConnected)] == [False]


def test_silent_board_fails_with_no_answer_and_is_sent_nothing_more():
    bench = Bench().boot()
    bench.run()
    bench.firmware.is_mute = True
    bench.link.send(bench.now_s, b"G1 X1")
    bench.run()
    assert bench.list_faults() == [Fault.NO_ANSWER]
    assert bench.link.take() == b""
    assert bench.link.deadline_s == math.inf


def test_slow_board_is_queried_and_no_line_is_sent_twice():
    bench = Bench().boot()
    bench.run()
    stream_program(bench, make_lines(50))
    late_bytes = bench.link.take()
    for _ in range(3):
        bench.now_s = bench.link.deadline_s
        bench.link.tick(bench.now_s)
        late_bytes += bench.link.take()
    assert late_bytes.count(ULTIMAKER2.last_line_query) == 3
    bench.link.receive(bench.firmware.feed(late_bytes), bench.now_s)
    bench.run()
    assert [number for number, _ in bench.firmware.executed_lines] == list(range(1, 51))
    assert bench.link.resend_count == 0


def test_timeout_is_reset_by_an_ordinary_ok():
    bench = Bench().boot()
    bench.run()
    stream_program(bench, make_lines(50))
    bench.now_s = bench.link.deadline_s
    bench.link.tick(bench.now_s)
    bench.now_s = bench.link.deadline_s
    for _ in range(2):
        bench.link.receive(b"ok\n", bench.now_s)
        assert bench.link.deadline_s == pytest.approx(bench.now_s + SILENCE_S)


def test_query_with_a_flipped_bit_is_not_executed():
    query = ULTIMAKER2.last_line_query
    for index in range(len(query)):
        for bit in range(8):
            damaged_query = query[:index] + bytes((query[index] ^ 1 << bit,)) + query[index + 1 :]
            for line in re.split(rb"[\n\r:]", damaged_query):
                assert not re.search(rb"[GMTN;]", line)


def measure_silence_s(bench: Bench, *commands: bytes) -> float:
    """Return the seconds for which the link waits for a silent board."""
    bench.run()
    bench.firmware.is_mute = True
    started_s = bench.now_s
    bench.link.send(started_s, *commands)
    bench.run()
    assert bench.list_faults() == [Fault.NO_ANSWER]
    return bench.now_s - started_s


def test_timeout_is_never_below_the_minimum():
    assert measure_silence_s(Bench(min_timeout_s=200.0).boot(), b"G1 X1") >= 200.0
    bench = Bench(min_timeout_s=200.0).boot()
    bench.run()
    bench.link.send(bench.now_s, b"G1 X1")
    assert bench.link.deadline_s >= bench.now_s + 25.0  # a query is sent after an eighth of the timeout


@pytest.mark.parametrize(
    ("command", "timeout_s"),
    [(b"G1 X1", 50.0), (b"M401", 300.0), (b"G28", 1500.0), (b"G4 P60000", 3000.0), (b"M400", 3000.0)],
)
def test_command_that_waits_for_moves_has_a_longer_timeout(command: bytes, timeout_s: float):
    assert measure_silence_s(Bench().boot(), command) == pytest.approx(timeout_s, abs=0.1)


def test_queries_after_a_line_fit_the_ring_buffer_of_the_board():
    bench = Bench().boot()
    bench.run()
    bench.link.send(bench.now_s, b"G1 X" + b"1" * (ULTIMAKER2.max_command_bytes - 4))
    sent_bytes = b""
    while bench.link.phase is Phase.LIVE:
        sent_bytes += bench.link.take()
        bench.now_s = bench.link.deadline_s
        bench.link.tick(bench.now_s)
    assert sent_bytes.count(ULTIMAKER2.last_line_query) == MAX_QUERIES
    assert len(sent_bytes) + len(b"234567") <= 126  # the board loses further bytes without an error


@pytest.mark.parametrize(
    ("line", "answers"),
    [
        (b"ok", [b"ok"]),
        (b"okok", [b"ok", b"ok"]),
        (b"ook", [b"o", b"ok"]),
        (b"okk", [b"ok", b"k"]),
        (b"Resend: 7ok", [b"Resend: 7", b"ok"]),
        (b"okError:checksum mismatch, Last Line: 6", [b"ok", b"Error:checksum mismatch, Last Line: 6"]),
        (b"Error:x, Last Line: 6Resend: 7", [b"Error:x, Last Line: 6", b"Resend: 7"]),
        (b"ok T:20.0 /0.0 B:1.0 /0.0 @:0 B@:0", [b"ok T:20.0 /0.0 B:1.0 /0.0 @:0 B@:0"]),
        (b"okPrinter stopped due to errors.", [b"ok", b"Printer stopped due to errors."]),
        (b"echo:SD card ok", [b"echo:SD card ok"]),
        (b"", []),
    ],
)
def test_answers_without_a_newline_are_split(line: bytes, answers: list[bytes]):
    assert replies.split_answers(line, ULTIMAKER2) == answers


@given(st.binary(max_size=100))
def test_splitting_answers_loses_no_byte(line: bytes):
    assert b"".join(replies.split_answers(line, ULTIMAKER2)) == line


def test_ok_without_a_newline_after_m119_counts():
    bench = Bench().boot()
    bench.link.send(bench.now_s, b"M119", b"G1 X1")
    bench.run()
    assert [body for _, body in bench.firmware.executed_lines] == [b"M119", b"G1 X1"]
    assert bench.now_s < 1.0


def test_plain_ok_never_answers_a_poll_and_a_report_never_acknowledges_a_line():
    bench = Bench().boot()
    bench.run()
    bench.link.send(bench.now_s, b"G1 X1", b"G1 X2")
    bench.link.take()
    report = b"ok T:20.5 /0.0 B:21.0 /0.0 @:0 B@:0\n"
    assert bench.link.receive(report, bench.now_s) == [Report(20.5, 0.0, 21.0, 0.0)]
    assert bench.link.take() == b""
    bench.link.receive(b"ok\n", bench.now_s)
    assert bench.link.take().startswith(b"N2 ")


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (b"start\n", Fault.REBOOT),
        (b"\xfe\x00start\n", Fault.REBOOT),
        (b"echo:Marlin 1.0.0\n", Fault.REBOOT),
        (b"Error:Printer stopped due to errors. Fix the error and use M999\n", Fault.STOPPED),
        (b"Printer stopped due to errors. Fix the error and use M999\nok\n", Fault.STOPPED),
        (b"Error:0\n: Extruder switched off. MAXTEMP triggered !\n", Fault.MAXTEMP),
        (b"Error:0\n: Extruder switched off. MINTEMP triggered !\n", Fault.MINTEMP),
        (b"Error:Temperature heated bed switched off. MAXTEMP triggered !!\n", Fault.MAXTEMP),
        (b"Error:Printer halted. kill() called!\n", Fault.KILL),
        (b"Error:Endstop not pressed after homing down. Endstop broken?\nok\n", Fault.ENDSTOP),
        (b"echo: cold extrusion prevented\n", Fault.COLD_EXTRUSION),
        (b"echo: too long extrusion prevented\n", Fault.BAD_FILE),
    ],
)
def test_faults_of_the_firmware_stop_the_stream_at_once(message: bytes, fault: Fault):
    bench = Bench().boot()
    stream_program(bench, make_lines(50))
    bench.run(until_s=0.1)
    bench.link.take()
    bench.events += bench.link.receive(message, bench.now_s)
    assert bench.list_faults() == [fault]
    bench.link.receive(b"ok\n", bench.now_s)
    assert bench.link.take() == b""


def test_resend_of_a_board_that_lost_its_count_is_ignored():
    bench = Bench().boot()
    stream_program(bench, make_lines(300))
    bench.run(until_s=1.0)
    bench.firmware.last_number = 0  # the board was reset, and its `start` was lost
    executed_count = len(bench.firmware.executed_lines)
    bench.run()
    assert bench.list_faults() == [Fault.REBOOT]
    assert len(bench.firmware.executed_lines) == executed_count
    assert bench.now_s < 1.0 + (MAX_ATTEMPTS + 1) * 60.0


def test_dropping_unsent_lines_completes_the_line_in_flight_and_sends_no_more_of_the_program():
    bench = Bench().boot()
    stream_program(bench, make_lines(300))
    bench.run(until_s=0.5)
    bench.link.drop_unsent()
    bench.link.send(bench.now_s, b"M401")
    streamed_line_count = bench.link.streamed_line_count
    bench.run()
    bodies = [body for _, body in bench.firmware.executed_lines]
    assert bodies[-1] == b"M401"
    assert len(bodies) - 1 <= streamed_line_count + 1 == bench.link.streamed_line_count


def test_commands_are_refused_while_a_program_is_streamed():
    bench = Bench().boot()
    stream_program(bench, make_lines(300))
    with pytest.raises(ValueError, match="unsent"):
        bench.link.send(0.0, b"M401")
        bench.link.send(0.0, b"M401")


def test_unexpected_last_line_is_accepted_when_reported_twice():
    """Ignore a single answer, which may be garbled; a board that was reset repeats its answer."""
    program, bench = make_lines(120), Bench().boot()
    stream_program(bench, program)
    bench.run(until_s=0.8)
    assert 50 < bench.link.streamed_line_count < 100
    bench.link.take()
    for resend in (5, 6, 6):
        bench.events += bench.link.receive(b"Resend: %d\n" % resend, bench.now_s)
    for last_line in (5, 6, 6):
        assert bench.link.phase is Phase.LIVE and bench.list_faults() == []
        message = b"Error:No Line Number with checksum, Last Line: %d\n" % last_line
        bench.events += bench.link.receive(message, bench.now_s)
    assert bench.list_faults() == [Fault.REBOOT]
    assert bench.link.phase is Phase.DEAD


def test_link_gives_up_on_contradictory_last_lines():
    bench = Bench().boot()
    stream_program(bench, make_lines(120))
    bench.run(until_s=0.8)
    bench.link.receive(b"Resend: 5\n", bench.now_s)
    for last_line in range(20, 20 + MAX_ATTEMPTS + 1):
        assert bench.link.phase is Phase.LIVE
        message = b"Error:No Line Number with checksum, Last Line: %d\n" % last_line
        bench.events += bench.link.receive(message, bench.now_s)
    assert bench.list_faults() == [Fault.NOISY_LINE]


def test_garbled_resend_of_an_old_line_is_ignored():
    program, bench = make_lines(120), Bench().boot()
    stream_program(bench, program)
    bench.run(until_s=0.8)
    bench.events += bench.link.receive(b"Resend: 5\n", bench.now_s)
    bench.run()
    assert [text for _, text in bench.firmware.executed_lines] == program
    assert bench.list_faults() == []
