"""Home page: first tasks, buttons of each role, and heaters that are not confirmed off."""

import re

import pytest

from books.example_night import make_night_books, make_status
from farm import api
from farm.model import Bed, Hold, HoldCode, JobState, Role
from farm.web.notes import Note, User
from farm.web.pages.home import list_home_tasks, list_tiles, render_home
from farms.network_farm import NetworkFarm

ANN = User("ann", Role.OPERATE)


@pytest.fixture(scope="module")
def status(tmp_path_factory):
    farm = NetworkFarm(tmp_path_factory.mktemp("farm"))
    key = farm.add_key(Role.PRINT).text
    params = {"request_id": "r" * 8, "name": "box.stl", "size": 100}
    farm.ask("POST", "/api/v1/jobs", key, params=params, content=b"x" * 100)
    status_view = api.Status.model_validate(farm.ask("GET", "/api/v1/status", key).json())
    farm.store.close()
    return status_view


def replace_printers(status, *changes, todo=()):
    """Return the status with a printer for each of the changes."""
    printer = status.printers[0].model_copy(update={"heaters_off": True})
    printers = [
        printer.model_copy(update={"name": f"um2-{index}", **change})
        for index, change in enumerate(changes, 1)
    ]
    return status.model_copy(update={"printers": printers, "todo": list(todo)})


def replace_job(status, todo=(), **changes):
    job = status.jobs[0].model_copy(update=changes)
    return status.model_copy(update={"jobs": [job], "todo": list(todo)})


def make_print(remaining_s, **changes):
    values = {"job": 1, "plate": "1/01", "state": "printing", "progress": 0.5, "layers": 10}
    return api.PrintProgress(**{**values, "remaining_s": remaining_s, "pause_ends": None, **changes})


def make_last_print(state, verdict=None):
    return api.LastPrint(id="print-1", plate="1/01", state=state, ended=None, off=None, verdict=verdict)


@pytest.mark.parametrize(
    ("parts", "name", "label"),
    [
        (["1/p01"], "1/p01", "part 1/p01"),
        (["1/p01", "1/p04"], "1/01", "plate 1/01"),
        ([], "1/01", "plate 1/01"),
    ],
)
def test_plate_with_one_part_is_named_by_the_part(status, parts, name, label):
    progress = make_print(60.0, parts=parts)
    assert (progress.name, progress.label) == (name, label)
    assert f"</a>, {label}</p>" in render_home(replace_printers(status, {"print": progress}), ANN)


def test_tiles_are_in_the_order_of_their_ends(status):
    remaining_times_s = (7200.0, None, 60.0, 7205.0)
    print_fields = [
        {"print": None if remaining_s is None else make_print(remaining_s)}
        for remaining_s in remaining_times_s
    ]
    tiles = list_tiles(replace_printers(status, *print_fields))
    assert [tile.printer.name for tile in tiles] == ["um2-3", "um2-1", "um2-4", "um2-2"]
    assert tiles[0].model == "box.stl"


@pytest.mark.parametrize(
    ("changes", "is_shown"),
    [
        ({"nozzle_c": 180.0, "heaters_off": False}, True),
        ({"nozzle_c": 180.0, "heaters_off": True}, False),
        ({"nozzle_c": None, "heaters_off": False}, False),
        ({"nozzle_c": 180.0, "heaters_off": False, "state": "absent"}, False),
        ({"nozzle_c": 180.0, "heaters_off": False, "print": make_print(60.0)}, False),
    ],
)
def test_heat_without_a_print_is_the_first_task(status, changes, is_shown):
    todo = [api.Todo(code="clear", printers=["um2-1"], text="")]
    shown_status = replace_printers(status, {"bed_c": 60.0, **changes}, todo=todo)
    tasks = list_home_tasks(shown_status)
    assert [task.code for task in tasks] == (["heat", "clear"] if is_shown else ["clear"])
    page = render_home(shown_status, ANN)
    assert ("heaters are not confirmed off (nozzle 180 °C, bed 60 °C)" in page) == is_shown
    assert ('class="hot"' in page) == is_shown


TASKS = [
    (api.Todo(code="alarm", printers=["um2-1"], text="go to um2-1 now: hot"), "Go to um2-1 now: hot", ()),
    (api.Todo(code="farm", printers=[], text="free space", jobs=[1]), "Free space", ()),
    (
        api.Todo(code="outage", printers=["um2-1"], text=""),
        "um2-1 were lost at the same time",
        ("/outage/confirm",),
    ),
    (
        api.Todo(code="look", printers=["um2-1"], text="", good={"um2-1": "1/p01"}),
        "Inspect um2-1: it jammed",
        ("/printers/um2-1/cleared", 'name="good" value="1/p01"'),
    ),
    (
        api.Todo(code="connect", printers=["um2-1"], text="", brief="um2-1: no answer"),
        "Connect um2-1: no",
        (),
    ),
    (
        api.Todo(code="resume", printers=["um2-1"], text="resume um2-1 by 14:00: `farm resume um2-1`"),
        "resume um2-1 by 14:00<",
        ("/printers/um2-1/resume",),
    ),
    (api.Todo(code="replace", printers=["um2-1"], text="um2-1 is old", brief="um2-1 is old"), "um2-1 is", ()),
    (api.Todo(code="hours", printers=["um2-1"], text="", brief="um2-1 needs you"), "um2-1 needs you", ()),
    (api.Todo(code="clear", printers=["um2-1"], text=""), "Clear 1 bed", ("/printers/um2-1/cleared",)),
    (
        api.Todo(code="approve", printers=[], text="", brief="job 1 (2 parts)", jobs=[1]),
        "Approve job 1 (2 parts)",
        ("/jobs/1/approve", 'value="PLAN"'),
    ),
    (
        api.Todo(code="stopped", printers=[], text="", brief="part 1/p01", jobs=[1]),
        "Decide on part 1/p01",
        (),
    ),
    (
        api.Todo(code="reel", printers=["um2-1"], text="", brief="um2-1 has 5 g"),
        "um2-1 has 5 g",
        ("/printers/um2-1/load",),
    ),
]


@pytest.mark.parametrize(("todo", "text", "forms"), TASKS, ids=[todo.code for todo, _, _ in TASKS])
def test_each_task_has_a_text_and_for_operators_its_form(status, todo, text, forms):
    shown_status = replace_printers(replace_job(status, plan="PLAN"), {"look": "it jammed"}, todo=[todo])
    page = render_home(shown_status, ANN)
    assert text in page
    for form in forms:
        assert form in page
    viewer_page = render_home(shown_status, User("bob", Role.LOOK))
    assert text in viewer_page
    assert 'method="post"' not in viewer_page.partition("<main")[2]


@pytest.mark.parametrize(
    ("last_print", "is_asked"),
    [
        (make_last_print("done"), True),
        (make_last_print("done", "good"), False),
        (make_last_print("failed"), False),
        (None, False),
    ],
)
def test_verdict_is_asked_for_a_part_that_waits_for_one(status, last_print, is_asked):
    todo = [api.Todo(code="clear", printers=["um2-1"], text="")]
    page = render_home(replace_printers(status, {"last": last_print, "bed": Bed.NOT_CLEAR}, todo=todo), ANN)
    assert ("part is good" in page) == ('name="bad"' in page) == is_asked
    assert ("Bed is clear" in page) != is_asked
    seen_print = "print-1" if last_print else "none"
    assert page.count(f'name="seen" value="{seen_print}"') == page.count("/cleared") > 0


@pytest.mark.parametrize(
    ("bed", "state"), [(Bed.CLEAR, "idle"), (Bed.NOT_CLEAR, "not_clear"), (Bed.UNKNOWN, "idle")]
)
def test_printer_whose_bed_is_to_be_cleared_is_not_shown_as_idle(status, bed, state):
    page = render_home(replace_printers(status, {"state": "idle", "bed": bed}), ANN)
    assert re.search(r'<div class="title">.*<span class="state (\w+)">', page)[1] == state


def test_tasks_have_different_ids_even_if_they_are_alike(status):
    todo = [api.Todo(code="farm", printers=[], text=text) for text in ("a", "b")]
    tasks = list_home_tasks(status.model_copy(update={"todo": todo}))
    assert len({task.key for task in tasks}) == 2


def test_job_shows_why_it_waits_and_ended_jobs_are_below(status):
    hold = Hold(code=HoldCode.START_TIME, text="starts at 20:00 (`--at`)")
    waiting_page = render_home(replace_job(status, hold=hold), ANN)
    assert "<li>starts at 20:00 (<code>--at</code>)</li>" in waiting_page
    approval_hold = Hold(code=HoldCode.APPROVAL, text="held until `farm approve 1`")
    assert "<li>waits for approval</li>" in render_home(replace_job(status, hold=approval_hold), ANN)
    failed_page = render_home(
        replace_job(status, state=JobState.FAILED, error="e", reason="<b>too thin</b>"), ANN
    )
    assert "No job is open" in failed_page
    assert failed_page.index("No job is open") < failed_page.index(">Ended<") < failed_page.index("box.stl")


def test_note_is_above_the_page(status):
    page = render_home(status, ANN, Note("<i> is refused", is_problem=True))
    assert page.index("&lt;i&gt; is refused") < page.index("<main")


def test_lost_host_is_one_card_without_a_button_for_each_printer(status):
    text = "pc-b with 2 printers does not answer (time-out): check its power and its network (`farm hosts`)"
    todo = api.Todo(code="host", printers=["um2-1", "um2-2"], text=text)
    lost_status = replace_printers(status, {"state": "unknown"}, {"state": "unknown"}, todo=[todo])
    (task,) = list_home_tasks(lost_status)
    assert (task.key, task.text, task.printers) == ("host", text, [])
    page = render_home(lost_status, ANN)
    assert "pc-b with 2 printers does not answer" in page
    assert "Look at um2-1" not in page


def test_job_without_a_running_print_is_shown_as_waiting(status):
    page = render_home(replace_job(status, state=JobState.PRINTING), ANN)
    printing_page = render_home(replace_job(make_status(make_night_books()), state=JobState.PRINTING), ANN)
    waiting_badge, printing_badge = ('<span class="state waiting">', '<span class="state printing">')
    assert (waiting_badge in page, printing_badge in page) == (True, False)
    assert (waiting_badge in printing_page, printing_badge in printing_page) == (False, True)


def test_printed_job_has_ended(status):
    eta = status.fleet.now
    for state, expected_text in ((JobState.PRINTED, "ended <time"), (JobState.PRINTING, "ends <time")):
        assert expected_text in render_home(replace_job(status, state=state, eta=eta), ANN)
