"""Decisions about the agents of a host."""

import json

from hypothesis import given
from hypothesis import strategies as st

from drivers import messages as m
from drivers.host.supervision import Backoff, ReportFilter


def test_agent_that_ends_is_started_at_once_and_then_after_increasing_waits():
    backoff, now_s, waits_s = Backoff(), 1000.0, []
    for _ in range(10):
        started_s = now_s
        while not backoff.may_start(now_s):
            now_s += 0.5
        waits_s.append(now_s - started_s)
        backoff = backoff.record_start(now_s)
    assert waits_s == [0, 0, 0.5, 1, 2, 4, 8, 16, 32, 60]


def test_agent_that_ran_for_a_long_time_is_soon_started_again():
    backoff = Backoff(started_s=0.0, wait_s=60.0).record_start(500.0)
    assert backoff.may_start(501.0) and not backoff.may_start(500.0)


def make_line(at_s: float, progress_s: float, phase: m.PrintPhase = m.PrintPhase.PRINTING) -> bytes:
    """Return the line with which a printing agent reports its state."""
    report = m.PrintSnapshot(print_id="p", phase=phase, progress_s=progress_s, layer=int(progress_s))
    nozzle = m.Heater(now_c=200 + at_s % 3, target_c=210)
    link = m.LinkState.BUSY
    snapshot = m.Snapshot(
        printer="a", agent_pid=1, now_s=at_s, link=link, nozzle=nozzle, print=report
    )  # fmt: skip
    return snapshot.model_dump_json().encode() + b"\n"


def test_reports_of_progress_are_thinned_and_changes_pass_at_once():
    report_filter = ReportFilter(5.0)
    assert [
        time_s for time_s in range(12) if report_filter.passes(make_line(time_s, time_s), float(time_s))
    ] == [
        0,
        5,
        10,
    ]
    assert report_filter.passes(make_line(12, 12, m.PrintPhase.ENDING), 12.0)
    assert not report_filter.passes(make_line(13, 13, m.PrintPhase.ENDING), 13.0)
    assert report_filter.passes(m.Reply(id=3).model_dump_json().encode(), 13.0)


def test_every_report_passes_without_a_limit_on_the_rate():
    report_filter = ReportFilter(1.0)
    assert all(report_filter.passes(make_line(0, 0), 0.0) for _ in range(3))


VALUES = st.recursive(
    st.none() | st.text(), lambda values: st.lists(values) | st.dictionaries(st.text(), values)
)


@given(st.one_of(st.binary(), VALUES.map(lambda value: json.dumps(value).encode())))
def test_line_that_is_not_a_message_passes_to_the_daemon(data):
    assert ReportFilter(5.0).passes(data, 0.0)
