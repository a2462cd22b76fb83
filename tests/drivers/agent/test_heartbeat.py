import os

from drivers.agent.heartbeat import LOOK_S, WEDGED_S, Heartbeat, Look, look_at


def silence(looks: list[Look], step_s: float = 0.5, until_s: float = WEDGED_S + 5) -> float | None:
    """When an agent that says nothing is judged to be wedged, in seconds; None where it is not."""
    heartbeat, now_s = Heartbeat(), 100.0
    while now_s < 100.0 + until_s:
        if heartbeat.wedged(now_s, lambda: looks.pop(0) if len(looks) > 1 else looks[0]):
            return now_s - 100.0
        now_s += step_s
    return None


def test_an_agent_that_was_stopped_sleeps_or_runs_without_a_word_is_wedged_after_half_a_minute():
    for state in "TSR":
        assert silence([Look(state, 3.0)]) == WEDGED_S


def test_an_agent_that_gets_no_processor_or_waits_for_a_disk_is_left_alone():
    share_s = WEDGED_S - LOOK_S
    assert silence([Look("R", 3.0), Look("R", 3.0 + 0.6 * share_s)]) is None
    assert silence([Look("R", 3.0), Look("R", 3.0 + 0.4 * share_s)]) == WEDGED_S
    assert silence([Look("D", 3.0)]) is None


def test_time_in_which_the_daemon_itself_did_not_run_is_no_silence():
    assert silence([Look("S", 0.0)], step_s=600.0, until_s=WEDGED_S * 600 - 1200) is None


def test_a_word_begins_the_count_anew():
    heartbeat = Heartbeat()
    for second in range(200):
        if second % 20 == 0:
            heartbeat.heard()
        assert not heartbeat.wedged(float(second), lambda: Look("S", 0.0))


def test_a_process_that_is_gone_is_not_wedged():
    heartbeat = Heartbeat()
    assert not any(heartbeat.wedged(float(second), lambda: None) for second in range(100))


def test_the_kernel_tells_of_a_process():
    mine = look_at(os.getpid())
    assert mine is not None and mine.state == "R" and mine.waited_s >= 0.0
    assert look_at(2**22 + 1) is None
