"""Lines of a link by themselves: how long each is waited for, and what of them can be sent again."""

import pytest

from drivers.firmware import ULTIMAKER2
from drivers.link.outbox import HISTORY_LINES, LINE_S, QUEUED_LINES, REACH_MM, Outbox
from drivers.link.recovery import Place, Recovery
from drivers.link.replies import Report

SLOW, SLOWER, FAST = b"G1 F60 X10", b"G1 F30 X10", b"G1 F6000 X10"


def sent(commands, polls_before=()):
    """An outbox that sends all commands; how long each is waited for."""
    outbox, waits = Outbox(ULTIMAKER2), []
    outbox.begin()
    assert outbox.take_next() is not None  # M110
    outbox.queue(tuple(commands))
    for number in range(1, len(commands) + 1):
        if number in polls_before:
            outbox.insert_poll()
            outbox.take_next()
        assert outbox.take_next() is not None
        waits.append(outbox.patience_s)
    return outbox, waits


def test_lines_behind_a_slow_move_are_waited_for_as_it_is():
    _, waits = sent([SLOW, *[FAST] * (QUEUED_LINES + 3)])
    assert QUEUED_LINES >= 16 + 8  # planned, and waiting
    assert waits[: QUEUED_LINES + 1] == [pytest.approx(60 * REACH_MM / 60)] * (QUEUED_LINES + 1)
    assert waits[QUEUED_LINES + 1 :] == [LINE_S] * 3


def test_the_slowest_of_the_moves_that_are_queued_counts():
    _, waits = sent([FAST, SLOWER, SLOW, FAST])
    assert waits == [LINE_S, *[pytest.approx(60 * REACH_MM / 30)] * 3]


@pytest.mark.parametrize("before", range(1, 6))
def test_a_line_keeps_its_patience_where_a_poll_takes_its_number(before):
    plain = [b"G90", b"M400", b"G90", b"G4 P9", b"G28"]
    assert sent(plain, [before])[1] == sent(plain)[1]


def test_a_line_can_be_sent_again_while_it_is_kept():
    outbox, _ = sent([b"G90"] * 200)
    assert [number for number in range(201) if outbox.holds(number)] == list(range(201 - HISTORY_LINES, 201))
    first, _ = sent([b"G90"])
    assert first.holds(0) and not first.holds(-1)


def test_a_refusal_without_a_number_leaves_the_questions_open():
    recovery, place = Recovery(), Place(5, 0, 5, 0)
    recovery.ask(place)
    recovery.ask(place)
    assert recovery.refuse(-1)
    assert (recovery.asks, recovery.wanted) == (2, -1)
    assert recovery.match_answer(5, place, True) is None
    recovery.refuse(6)
    assert (recovery.asks, recovery.wanted) == (1, 6)


@pytest.mark.parametrize(("nozzle_c", "bed_c", "off"), [(0, 0, True), (1, 0, False), (0, 1, False)])
def test_heat_is_off_where_both_targets_are_0(nozzle_c, bed_c, off):
    assert Report(200.0, nozzle_c, 60.0, bed_c).off is off
