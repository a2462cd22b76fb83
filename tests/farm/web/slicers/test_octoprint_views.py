"""Descriptions in OctoPrint's terms."""

import pytest

from books.make_books import make_job
from farm import api
from farm.config import PrinterSection
from farm.errors import NotFoundError
from farm.model import PrintState
from farm.web.slicers import octoprint_views as views


def make_progress(state=PrintState.PRINTING, share=0.25, remaining_s=300.0):
    return api.PrintProgress(
        job=1, plate="1/01", state=state, progress=share, remaining_s=remaining_s, layers=9, pause_ends=None
    )


@pytest.mark.parametrize(
    ("state", "text"),
    [
        (PrintState.ASSIGNED, "Starting"),
        (PrintState.HEATING, "Starting"),
        (PrintState.PRINTING, "Printing"),
        (PrintState.PAUSED, "Paused"),
        (PrintState.ENDING, "Cancelling"),
    ],
)
def test_states_of_a_print_have_the_names_of_octoprint(state, text):
    assert views.describe_current_job(make_job(), make_progress(state))["state"] == text


def test_progress_adds_up_to_the_whole_print():
    progress_view = views.describe_current_job(make_job(), make_progress())["progress"]
    assert (progress_view["completion"], progress_view["printTime"], progress_view["printTimeLeft"]) == (
        25.0,
        100,
        300,
    )
    progress_at_start = views.describe_current_job(make_job(), make_progress(share=0.0))["progress"]
    assert (progress_at_start["completion"], progress_at_start["printTime"]) == (0.0, None)


def test_view_without_a_job_has_empty_fields():
    job_view = views.describe_current_job(None, None)
    assert job_view["job"]["file"]["name"] is None
    assert job_view["progress"]["printTimeLeft"] is None
    assert job_view["state"] == "Operational"


def test_farm_always_reports_ready():
    flags = views.describe_state(None)["state"]["flags"]
    flag_names = (
        "error",
        "closedOrError",
        "paused",
        "pausing",
        "printing",
        "cancelling",
        "ready",
        "operational",
    )
    assert [flags[name] for name in flag_names] == [False] * 6 + [True] * 2


def test_farm_profile_has_the_volume_that_all_printers_share():
    sections = [
        PrinterSection(name=name, model=model, port=f"sim://{model}")
        for name, model in (("a", "ultimaker2_extended_plus"), ("b", "ultimaker2_plus"))
    ]
    profile = views.describe_profiles("lab", sections, "http://farm/api/printerprofiles")["profiles"][
        "_default"
    ]
    assert (profile["name"], profile["volume"]["height"]) == ("lab", 205.0)
    assert profile["model"] == "Ultimaker 2 Extended+ / Ultimaker 2+"
    tall_profile = views.describe_profiles("a", sections[:1], "x")["profiles"]["_default"]
    assert tall_profile["volume"]["height"] == 305.0


def test_file_is_found_by_number_and_name_or_as_the_newest_of_its_name():
    jobs = {
        n: make_job(n).model_copy(update={"name": name, "submitted_by": by})
        for n, name, by in (
            (1, "a.gcode", "ann"),
            (2, "a.gcode", "ann"),
            (3, "a.gcode", "bob"),
            (4, "b", "bob"),
        )
    }
    found_ids = {path: views.find_job(jobs, path, "ann").id for path in ("1/a.gcode", "a.gcode", "/b")}
    assert found_ids == {"1/a.gcode": 1, "a.gcode": 2, "/b": 4}
    assert views.find_job(jobs, "a.gcode", "carl").id == 3
    for path in ("4/a.gcode", "9/a.gcode", "c", "٣/a.gcode", "9" * 5000 + "/a.gcode", "", "1/"):
        with pytest.raises(NotFoundError):
            views.find_job(jobs, path, "ann")
