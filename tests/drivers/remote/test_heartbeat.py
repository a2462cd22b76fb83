"""Detection of agents that hang."""

import os

from drivers.remote import Heartbeat, sample_process
from drivers.remote.heartbeat import HUNG_SILENCE_S, SAMPLE_SILENCE_S, ProcessSample


def measure_silence_until_hung_s(
    samples: list[ProcessSample], step_s: float = 0.5, until_s: float = HUNG_SILENCE_S + 5
) -> float | None:
    """Return the seconds of silence after which an agent counts as hung; None if it does not by `until_s`."""
    heartbeat, now_s = Heartbeat(), 100.0
    while now_s < 100.0 + until_s:
        if heartbeat.is_hung(now_s, lambda: samples.pop(0) if len(samples) > 1 else samples[0]):
            return now_s - 100.0
        now_s += step_s
    return None


def test_stopped_sleeping_or_looping_agent_is_hung_after_half_a_minute():
    for state in "TSR":
        assert measure_silence_until_hung_s([ProcessSample(state, 3.0)]) == HUNG_SILENCE_S


def test_agent_waiting_for_a_processor_or_disk_is_not_hung():
    sampled_s = HUNG_SILENCE_S - SAMPLE_SILENCE_S
    assert (
        measure_silence_until_hung_s([ProcessSample("R", 3.0), ProcessSample("R", 3.0 + 0.6 * sampled_s)])
        is None
    )
    assert (
        measure_silence_until_hung_s([ProcessSample("R", 3.0), ProcessSample("R", 3.0 + 0.4 * sampled_s)])
        == HUNG_SILENCE_S
    )
    assert measure_silence_until_hung_s([ProcessSample("D", 3.0)]) is None


def test_time_without_a_running_listener_does_not_count():
    assert (
        measure_silence_until_hung_s(
            [ProcessSample("S", 0.0)], step_s=600.0, until_s=HUNG_SILENCE_S * 600 - 1200
        )
        is None
    )


def test_message_restarts_the_count():
    heartbeat = Heartbeat()
    for time_s in range(200):
        if time_s % 20 == 0:
            heartbeat.reset()
        assert not heartbeat.is_hung(float(time_s), lambda: ProcessSample("S", 0.0))


def test_ended_process_is_not_hung():
    heartbeat = Heartbeat()
    assert not any(heartbeat.is_hung(float(time_s), lambda: None) for time_s in range(100))


def test_process_is_sampled_from_proc():
    sample = sample_process(os.getpid())
    assert sample is not None and sample.state == "R" and sample.waited_s >= 0.0
    assert sample_process(2**22 + 1) is None
