"""Outbox: timeout of each line, and lines that can be sent again."""

import pytest

from drivers.emulator.firmware.listener import RING_BYTES
from drivers.firmware import ULTIMAKER2
from drivers.gcode.frame import MAX_FRAME_BYTES
from drivers.link import Link, Phase
from drivers.link.opening import START_TIMEOUT_S
from drivers.link.outbox import HISTORY_LINES, LINE_TIMEOUT_S, MAX_MOVE_MM, QUEUED_LINES, Outbox
from drivers.link.recovery import MAX_ATTEMPTS, MAX_QUERIES, Place, Recovery
from drivers.link.replies import Report

SLOW_MOVE, SLOWER_MOVE, FAST_MOVE = b"G1 F60 X10", b"G1 F30 X10", b"G1 F6000 X10"


def send_commands(commands, polls_before=()):
    """Send all commands through an outbox; return it with the timeout of each."""
    outbox, timeouts_s = Outbox(ULTIMAKER2), []
    outbox.begin()
    assert outbox.take_next() is not None  # M110
    outbox.queue(tuple(commands))
    for number in range(1, len(commands) + 1):
        if number in polls_before:
            outbox.insert_poll()
            outbox.take_next()
        assert outbox.take_next() is not None
        timeouts_s.append(outbox.timeout_s)
    return outbox, timeouts_s


def test_lines_behind_a_slow_move_have_its_timeout():
    _, timeouts_s = send_commands([SLOW_MOVE, *[FAST_MOVE] * (QUEUED_LINES + 3)])
    assert QUEUED_LINES >= 16 + 8  # moves in the planner, and lines that wait
    assert timeouts_s[: QUEUED_LINES + 1] == [pytest.approx(60 * MAX_MOVE_MM / 60)] * (QUEUED_LINES + 1)
    assert timeouts_s[QUEUED_LINES + 1 :] == [LINE_TIMEOUT_S] * 3


def test_timeout_follows_the_slowest_queued_move():
    _, timeouts_s = send_commands([FAST_MOVE, SLOWER_MOVE, SLOW_MOVE, FAST_MOVE])
    assert timeouts_s == [LINE_TIMEOUT_S, *[pytest.approx(60 * MAX_MOVE_MM / 30)] * 3]


@pytest.mark.parametrize("lines_before", range(1, 6))
def test_line_keeps_its_timeout_if_a_poll_takes_its_number(lines_before):
    commands = [b"G90", b"M400", b"G90", b"G4 P9", b"G28"]
    assert send_commands(commands, [lines_before])[1] == send_commands(commands)[1]


def test_line_can_be_resent_while_it_is_kept():
    outbox, _ = send_commands([b"G90"] * 200)
    assert [number for number in range(201) if outbox.holds(number)] == list(range(201 - HISTORY_LINES, 201))
    short_outbox, _ = send_commands([b"G90"])
    assert short_outbox.holds(0) and not short_outbox.holds(-1)


def test_plain_ok_does_not_answer_a_poll_with_the_next_line_encoded():
    """Check `take_encoded_line`, whose result the link sends on a plain ok."""
    outbox, _ = send_commands([])
    outbox.queue((FAST_MOVE,) * 9)
    assert outbox.take_next() is not None and outbox.take_encoded_line() is not None
    outbox.insert_poll()
    assert outbox.take_next() == b"N3 M105*36\n" and outbox.is_poll
    assert outbox.take_encoded_line() is None
    assert outbox.take_next() is not None and outbox.take_encoded_line() is not None


def test_all_queries_fit_the_ring_buffer_after_the_longest_line():
    assert MAX_FRAME_BYTES + 1 + MAX_QUERIES * len(ULTIMAKER2.last_line_query) <= RING_BYTES


def test_link_gives_up_on_a_silent_board_after_four_queries():
    link, now_s = Link(ULTIMAKER2), 0.0
    link.on_opened(now_s)
    while link.phase is not Phase.DEAD:
        now_s = link.deadline_s
        link.tick(now_s)
    assert now_s == START_TIMEOUT_S + MAX_ATTEMPTS * START_TIMEOUT_S / 2


def test_resend_is_accepted_after_two_unanswered_queries():
    link, now_s, query_count = Link(ULTIMAKER2), 0.0, 0
    link.on_opened(now_s)
    link.receive(b"start\necho:   M301 P10\n", now_s)
    link.send(now_s, FAST_MOVE, FAST_MOVE, FAST_MOVE)
    for _ in range(3):
        link.receive(b"ok\n", now_s)
    assert b"N3 " in link.take()
    link.receive(b"Error:checksum mismatch, Last Line: 2\nResend: 3\nok\n", now_s)
    while b"N3 " not in (sent_bytes := link.take()):
        query_count += sent_bytes.count(ULTIMAKER2.last_line_query)
        now_s = link.deadline_s
        link.tick(now_s)
    assert query_count == 2


def test_refusal_without_a_number_leaves_queries_pending():
    recovery, place = Recovery(), Place(5, 0, 5, 0)
    recovery.note_query(place, 0.0)
    recovery.note_query(place, 0.0)
    assert recovery.note_refusal(-1)
    assert (recovery.query_count, recovery.resend_number) == (2, -1)
    assert recovery.match_answer(5, place, True) is None
    recovery.note_refusal(6)
    assert (recovery.query_count, recovery.resend_number) == (1, 6)


@pytest.mark.parametrize(("nozzle_c", "bed_c", "is_off"), [(0, 0, True), (1, 0, False), (0, 1, False)])
def test_heaters_are_off_if_both_targets_are_0(nozzle_c, bed_c, is_off):
    assert Report(200.0, nozzle_c, 60.0, bed_c).targets_off is is_off
