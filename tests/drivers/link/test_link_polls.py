"""Link that polls temperatures while it sends lines, over wires with and without faults."""

import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.firmware import ULTIMAKER2
from drivers.link import Link, Phase, Report
from printers.link_bench import Bench, Wire, make_lines, pass_to_link, stream_program

BANNER = b"start\necho:Marlin 1.0.0\necho:   M301 P10 I1 D70\n"
REPORT = b"ok T:200.0 /210.0 B:60.0 /60.0 @:0 B@:0\n"


class FakeBoard:
    """Board that executes numbered lines in order, each once."""

    def __init__(self, poll_interval_s: float) -> None:
        self.link, self.now_s = Link(ULTIMAKER2), 0.0
        self.link.poll_interval_s = poll_interval_s
        self.executed: list[bytes] = []
        self.report_count = 0
        self.last_number = -1
        self.link.on_opened(0.0)
        self.receive(BANNER)

    def receive(self, data: bytes) -> list[object]:
        self.next_line, events = pass_to_link(self.link, data, self.now_s)
        self.report_count += sum(isinstance(event, Report) for event in events)
        return list(events)

    def take(self) -> bytes:
        line, self.next_line = self.next_line + self.link.take(), b""
        return line

    def step(self) -> bool:
        """Answer the sent bytes; return False if there were none."""
        line = self.take()
        if not line:
            return False
        result = re.fullmatch(rb"N(\d+) (.*)\*\d+\n", line)
        assert result is not None, line
        self.last_number += 1
        assert int(result[1]) == self.last_number
        self.now_s += 0.25
        if result[2] == b"M105":
            self.receive(REPORT)
        else:
            self.executed.append(result[2])
            self.receive(b"ok\n")
        return True


PROGRAM = [b"G1 X%d E%d" % (i % 200, i) for i in range(900)]


@pytest.mark.parametrize("first_line", [0, 7])
@pytest.mark.parametrize("commands", [(), (b"G28", b"M104 S0", b"G92 E0")])
@pytest.mark.parametrize("poll_interval_s", [0.5, 1.0, 3.0, 100.0])
def test_polls_keep_the_order_of_lines_and_are_not_counted(
    first_line: int, commands: tuple[bytes, ...], poll_interval_s: float
):
    """Check after every answer that the count for the journal equals that of the acknowledged lines."""
    board = FakeBoard(poll_interval_s)
    if commands:
        board.link.send(0.0, *commands)
    board.link.stream(0.0, lambda a, b: PROGRAM[a:b], first_line, len(PROGRAM))
    while board.step():
        printed_count = sum(line.startswith(b"G1") for line in board.executed)
        assert board.link.streamed_line_count == first_line + printed_count
        assert not board.link.is_drained or first_line + printed_count == len(PROGRAM)
    assert board.link.is_drained
    assert board.executed == [b"M110", *commands, *PROGRAM[first_line:]]
    assert board.link.resend_count == 0
    assert board.report_count >= len(PROGRAM) * 0.2 / poll_interval_s
    assert len(board.link._outbox._frames) < 400  # a print may have a million lines


def test_late_report_does_not_answer_a_refused_poll():
    board = FakeBoard(1e9)
    while board.step():
        pass
    board.link.poll(board.now_s)
    assert b"M105" in board.take()
    board.receive(b"Resend: %d\n" % (board.last_number + 1))
    assert [type(event) for event in board.receive(REPORT)] == [Report]
    assert not board.link.is_drained


def test_line_in_flight_is_not_counted_as_printed():
    board = FakeBoard(1e9)
    board.link.stream(0.0, lambda a, b: PROGRAM[a:b], 0, 3)
    while board.last_number < 2:
        board.step()
    assert board.take().startswith(b"N3 ")
    assert (board.link.streamed_line_count, board.link.is_drained) == (2, False)


@given(
    count=st.integers(1, 600),
    poll_interval_s=st.sampled_from([0.02, 0.05, 0.3, 1.0]),
    change_share=st.sampled_from([0.0, 0.0005]),
    seed=st.integers(0, 2**32),
)
@example(count=84, poll_interval_s=0.3, change_share=0.0005, seed=84)  # two changes of one bit of a poll
@settings(max_examples=60, deadline=None)
def test_polls_between_the_lines_change_neither_their_order_nor_the_count(
    count: int, poll_interval_s: float, change_share: float, seed: int
):
    bench = Bench(Wire(0.0, change_share, 10_000, seed))
    bench.link.poll_interval_s = poll_interval_s
    bench.boot()
    program = make_lines(count)
    bench.link.send(0.0, b"M82")
    stream_program(bench, program)
    line_counts = [0]
    for _ in range(200):
        if bench.link.is_drained or bench.link.phase is Phase.DEAD:
            break
        bench.run(until_s=bench.now_s + 0.5)
        line_counts.append(bench.link.streamed_line_count)
    if bench.link.phase is not Phase.DEAD:
        assert len(bench.firmware.executed_lines) == count + 1
        assert bench.link.streamed_line_count == count
        if not change_share:
            assert [body for _, body in bench.firmware.executed_lines] == [b"M82", *program]
            assert line_counts == sorted(line_counts)
            assert bench.link.resend_count == 0
