"""Signs that a person or an SD card uses an idle printer."""

from drivers.agent.idle_watch import HEATED_REASON, MOVED_REASON, SD_PRINT_REASON, IdleWatch
from drivers.errors import Fault
from drivers.link.replies import Report

HOME_POSITION = b"X:0.00Y:224.50Z:215.00E:0.00 Count X: 0.00Y:224.50Z:215.00"
MOVED_POSITION = b"X:10.00Y:224.50Z:215.00E:0.00 Count X: 10.00Y:224.50Z:215.00"
FED_POSITION = b"X:0.00Y:224.50Z:215.00E:5.00 Count X: 0.00Y:224.50Z:215.00"


def test_moved_position_is_detected_when_reported_twice():
    for position in (MOVED_POSITION, FED_POSITION):
        watch = IdleWatch()
        results = [
            watch.judge_answer(text)
            for text in (
                HOME_POSITION,
                HOME_POSITION,
                position,
                HOME_POSITION,
                position,
                position,
                position,
                HOME_POSITION,
                HOME_POSITION,
            )
        ]
        reasons = [reason for _, reason in results]
        assert all(is_understood for is_understood, _ in results)
        assert reasons == [None, None, None, None, None, MOVED_REASON, None, None, MOVED_REASON]


def test_garbled_first_answer_is_not_a_move():
    """Accept a position only after it was reported twice, and detect a later move away from it."""
    watch = IdleWatch()
    reasons = [
        watch.judge_answer(text)[1]
        for text in (
            FED_POSITION,
            HOME_POSITION,
            HOME_POSITION,
            HOME_POSITION,
            MOVED_POSITION,
            MOVED_POSITION,
        )
    ]
    assert reasons == [None, None, None, None, None, MOVED_REASON]


def test_move_after_the_first_answer_is_detected():
    """Detect that a person has begun to use a bed, which must not count as clear."""
    watch = IdleWatch()
    assert [watch.judge_answer(text)[1] for text in (HOME_POSITION, MOVED_POSITION, MOVED_POSITION)] == [
        None,
        None,
        MOVED_REASON,
    ]


def test_position_after_a_reset_is_not_a_move():
    watch = IdleWatch()
    watch.judge_answer(HOME_POSITION)
    watch.reset()
    assert [watch.judge_answer(MOVED_POSITION), watch.judge_answer(MOVED_POSITION)] == [
        (True, None),
        (True, None),
    ]


def test_print_from_the_sd_card_is_detected_until_it_ends():
    watch = IdleWatch()
    assert watch.judge_answer(b"Not SD printing") == (True, None)
    assert watch.judge_answer(b"Card error:1") == (True, None) and not watch.is_printing_from_card
    assert (
        watch.judge_answer(b"SD printing byte 2048/90210") == (True, SD_PRINT_REASON)
        and watch.is_printing_from_card
    )
    assert watch.judge_answer(b"Card error:0") == (True, SD_PRINT_REASON) and watch.is_printing_from_card
    assert watch.judge_answer(b"Not SD printing") == (True, None) and not watch.is_printing_from_card
    assert watch.judge_answer(b"echo:SD init fail") == (False, None)


def test_manually_heated_nozzle_is_detected_but_a_garbled_report_is_ignored():
    watch = IdleWatch()
    cold_report, hot_report = Report(21.0, 0.0, 21.0, 0.0), Report(21.0, 180.0, 21.0, 0.0)
    assert [
        watch.judge_report(r)[0] for r in (cold_report, hot_report, cold_report, hot_report, hot_report)
    ] == [None, None, None, None, HEATED_REASON]


def test_rising_heater_is_stuck_on_and_cooling_heater_is_not():
    watch = IdleWatch()
    falling_reports = [Report(float(t), 0.0, 60.0, 0.0) for t in range(210, 40, -5)]
    assert all(watch.judge_report(report) == (None, None) for report in falling_reports)
    rising_results = [watch.judge_report(Report(float(t), 0.0, 60.0, 0.0))[1] for t in range(45, 100, 5)]
    findings = [finding for finding in rising_results if finding is not None]
    assert findings and all(finding.fault is Fault.HEATER_STUCK_ON for finding in findings)
    assert rising_results.index(findings[0]) == 6  # three reports above 60 C
    assert "nozzle" in findings[0].text
    watch.judge_report(Report(120.0, 200.0, 60.0, 0.0))  # a person may heat the nozzle
    assert watch.judge_report(Report(150.0, 0.0, 60.0, 0.0)) == (None, None)
