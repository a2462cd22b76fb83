"""Invalid reports of agents: other printers are unaffected, and the books stay readable."""

import json
from datetime import datetime

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from drivers.errors import MessageError
from drivers.messages import Filament, LinkState, PrintPhase, Snapshot
from drivers.remote.client import read_line
from farm.agents.protocol_adapter import compute_clock_offset_s, to_farm_print, to_farm_snapshot
from farm.model import JobOptions
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.storage.store import Store
from farm.views import describe_job, describe_night, describe_printer, list_history, list_tasks
from hosts.manual_clock import ManualClock

NOW_S = datetime(2026, 11, 1).timestamp()
CLOCK = ManualClock(NOW_S)
EXTREME_NUMBERS = [float("nan"), float("inf"), -1e300, 1e300, -1.0, 0.0, 1e-300, 1e12, NOW_S, NOW_S + 1e4]
times_s = st.sampled_from([None, *EXTREME_NUMBERS])
numbers = st.sampled_from(EXTREME_NUMBERS)


prints = st.fixed_dictionaries(
    {
        "print_id": st.sampled_from(["mine", "theirs", "x", "y", ""]),
        "phase": st.sampled_from(list(PrintPhase)),
    },
    optional={
        "fault": st.sampled_from([None, "port_lost", "no such fault"]),
        "reason": st.sampled_from([None, "", "\x1b[2J"]),
        "progress_s": numbers,
        "print_time_s": numbers,
        "extruded": st.booleans(),
        "started_s": times_s,
        "ended_s": times_s,
        "pause_ends_s": times_s,
        "ends_by_s": times_s,
        "starved_s": numbers,
        "layer": st.sampled_from([None, -5, 10**30]),
        "z_mm": times_s,
        "sha256": st.sampled_from([None, "0" * 64]),
    },
)
# These prints have the file of a waiting plate.
similar_prints = prints.map(lambda item: {"started_s": NOW_S + 9.0, **item, "sha256": "0" * 64})
snapshots = st.fixed_dictionaries(
    {
        "printer": st.just("a"),
        "agent_pid": st.sampled_from([-1, 7, 10**30]),
        "link": st.sampled_from(list(LinkState)),
    },
    optional={
        "now_s": numbers,
        "filament": st.sampled_from(list(Filament)),
        "bed_clear": st.sampled_from([None, True, False]),
        "doubt": st.sampled_from([None, "it was moved\x1b[2J"]),
        "alarm": st.sampled_from([None, "it was moved\x1b[2J"]),
        "nozzle": st.fixed_dictionaries({"now_c": numbers, "target_c": numbers}),
        "print": st.none() | prints,
    },
)


def read_snapshots(snapshot_values):
    """Yield the snapshots of an agent that can be parsed."""
    for item in snapshot_values:
        try:
            snapshot = read_line(json.dumps({"kind": "snapshot", **item}).encode())
        except MessageError:
            continue
        assert isinstance(snapshot, Snapshot)
        yield snapshot


def render_views(controller, folder):
    """Render all views and notices, and check that they contain no escape sequences."""
    view_context = controller.build_view_context(StateFolder(folder))
    views = [describe_job(view_context, job) for job in controller.books.jobs.values()]
    views += [describe_printer(view_context, section, None) for section in controller.fleet.printers]
    views += [*list_tasks(view_context), *list_history(view_context)]
    night = describe_night(view_context)
    for view in [*views, *([night] if night else [])]:
        assert "\\u001b" not in view.model_dump_json()


def make_busy_farm(folder):
    """Make a farm with a job on two printers; `a` sends invalid reports."""
    farm = Farm(folder, clock=CLOCK, attended=["mon-fri 08:00-18:00"], quiet="22:00-06:00")
    farm.store._db.execute("PRAGMA synchronous = OFF")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.controller.handle(
        ev.PlanningStarted(at_s=NOW_S, job=1), make_plan_event(1, 4).model_copy(update={"at_s": NOW_S})
    )
    for name, plate, print_id in (("a", "1/01", "mine"), ("b", "1/02", "theirs")):
        farm.controller.handle(
            ev.BedReported(at_s=NOW_S, printer=name, bed="clear", filament="parked"),
            ev.PlateAssigned(at_s=NOW_S, plate=plate, printer=name, print_id=print_id),
        )
    return farm


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(snapshot_values=st.lists(snapshots, max_size=4))
def test_any_snapshot_can_be_recorded_shown_and_read(snapshot_values, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lies")
    farm = make_busy_farm(folder)
    other_print = farm.controller.books.prints["theirs"]
    for snapshot in read_snapshots(snapshot_values):
        farm.controller.on_snapshot(to_farm_snapshot(snapshot, CLOCK, snapshot.printer, True, False))
        render_views(farm.controller, folder)
    assert farm.controller.books.prints["theirs"] == other_print
    with Store(folder / "farm.db") as store:
        assert store.load() == farm.controller.books
    farm.store.close()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(last_record=snapshots, reported_prints=st.lists(similar_prints, max_size=4))
def test_any_journal_since_the_backup_can_be_recorded(last_record, reported_prints, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lies")
    farm = make_busy_farm(folder)
    farm.controller.start(farm.effects, restored_s=NOW_S + 1.0)
    other_print = farm.controller.books.prints["theirs"]
    for snapshot in read_snapshots([last_record]):
        print_views = [
            item.print
            for item in read_snapshots(
                {**last_record, "print": reported_print} for reported_print in reported_prints
            )
        ]
        farm_prints = [to_farm_print(item, compute_clock_offset_s(snapshot, CLOCK)) for item in print_views]
        farm.controller.on_journal(
            to_farm_snapshot(snapshot, CLOCK, snapshot.printer, True, False), farm_prints
        )
        assert farm.controller.find_unreported_since_s("a") is None
        render_views(farm.controller, folder)
    assert farm.controller.books.prints["theirs"] == other_print
    with Store(folder / "farm.db") as store:
        assert store.load() == farm.controller.books
    farm.store.close()
