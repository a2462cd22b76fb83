"""Single faults on the wire: the head stops briefly, and every line is executed once."""

import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bench.printing.stalls import KINDS, run
from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.firmware import ULTIMAKER2
from drivers.link import Link, Phase
from drivers.printers import PROFILES
from printers.link_bench import pass_to_link

MAX_MEDIAN_S, MAX_STALL_S = 1.0, 3.0  # simulated seconds
FREQUENT_FAULT_COUNT = 200
RARE_FAULT_COUNT = 30  # faults of the lines without a move


@pytest.mark.parametrize("name", KINDS)
def test_transmission_fault_stops_the_head_briefly_and_repeats_no_line(name: str):
    fault_count = RARE_FAULT_COUNT if name.startswith("M") else FREQUENT_FAULT_COUNT
    outcome = run(KINDS[name], fault_count, seed=0)
    assert outcome.fault is None
    assert outcome.exact
    assert len(outcome.stalls_s) == fault_count
    assert outcome.median_s <= MAX_MEDIAN_S
    assert outcome.worst_s <= MAX_STALL_S


@given(st.sampled_from(sorted(KINDS)), st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_print_is_exact_and_continues_within_3_s_after_any_damage(name: str, seed: int):
    outcome = run(KINDS[name], 8, seed)
    assert outcome.exact
    assert outcome.worst_s <= MAX_STALL_S


@given(
    moves=st.lists(st.sampled_from([0.5, 3.0, 40.0, 180.0]), min_size=1, max_size=40),
    feedrate_mm_min=st.sampled_from([120, 600, 3000]),
    lost_answers=st.sets(st.integers(0, 39), max_size=2),
)
@example(moves=[0.5, 180.0] + [0.5] * 18, feedrate_mm_min=120, lost_answers=set())
@settings(max_examples=60, deadline=None)
def test_lost_ok_during_slow_moves_causes_no_resend(
    moves: list[float], feedrate_mm_min: int, lost_answers: set[int]
):
    """Use a move of 90 s, during which the board is silent and is queried."""
    x_positions_mm = [20.0 + (mm if index % 2 else 0.0) for index, mm in enumerate(moves)]
    program = [b"G1 F%d X%.1f" % (feedrate_mm_min, x) for x in x_positions_mm]
    firmware, link = (
        EmulatedFirmware(PROFILES["ultimaker2_plus"], Faults(), random.Random(0), 0.0),
        Link(ULTIMAKER2),
    )
    link.on_opened(0.0)
    now_s, is_connected, answer_count, line = 0.0, False, 0, b""
    while not (is_connected and link.is_drained):
        assert link.phase is not Phase.DEAD
        now_s = max(now_s, min(firmware.compute_deadline_s(), link.deadline_s)) + 1e-3
        answer = firmware.feed(line + link.take(), now_s)
        if answer == b"ok\n":
            answer_count += 1
            answer = b"" if answer_count in lost_answers else answer
        line, _ = pass_to_link(link, answer, now_s)
        link.tick(now_s)
        if not is_connected and link.phase is Phase.LIVE:
            is_connected = True
            link.send(now_s, b"M302 S0", b"G28")
            link.stream(now_s, lambda a, b: program[a:b], 0, len(program))
    now_s += 200.0
    firmware.feed(b"", now_s)
    assert firmware.machine.planner.move_count == len(program)
    assert link.resend_count == 0
