"""What a person writes for a job, a part or a printer."""

import pytest

from farm.api import PrinterView
from farm.cli.operate import place_of, waiting_for_it
from farm.model import Hold, HoldCode


@pytest.mark.parametrize(
    ("target", "path"),
    [
        ("3", "/jobs/3"),
        ("3/p01", "/jobs/3/parts/p01"),
        ("3/1", "/jobs/3/parts/1"),
        ("3/p01a", "/jobs/3/parts/p01a"),
        ("um2-03", "/printers/um2-03"),
    ],
)
def test_a_target_is_a_job_a_part_or_a_printer(target, path):
    assert place_of(target) == path


def test_all_beds_are_those_that_a_person_was_asked_to_clear():
    hold = Hold(code=HoldCode.BED_NOT_CLEAR, text="")
    states = ("idle", "maintenance", "look", "absent", "connecting")
    fleet = [PrinterView.model_construct(name=state, state=state, print=None, hold=hold) for state in states]
    clear = PrinterView.model_construct(name="clear", state="idle", print=None, hold=None)
    assert waiting_for_it([*fleet, clear]) == ["idle", "look", "connecting"]
