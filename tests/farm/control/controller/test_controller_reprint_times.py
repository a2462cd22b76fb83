"""Figures of a job whose part is printed again a day later, through the controller."""

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.model import AgentPrint, AgentSnapshot, FilamentState, JobOptions, JobState, Link, PrintState
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.views import describe_job, list_history
from hosts.manual_clock import ManualClock

DAY_S = 86400.0


class Scenario:
    """Job on a farm of two printers, with a clock that the test sets."""

    def __init__(self, folder):
        self.clock = ManualClock()
        self.farm = Farm(folder, clock=self.clock)
        self.state = StateFolder(folder)
        self.farm.report_ready("a", "b")
        self.farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
        event = make_plan_event(1, 2)
        self.farm.controller.on_plan(1, Plan(event.parts, event.plates, (), 1.0, 500.0))

    def report_print(self, printer, state, started_s):
        """Report the state of a print as the agent of its printer does."""
        attempt = self.farm.controller.books.find_open_print(printer)
        is_ended = state.ended
        agent_print = AgentPrint(
            print_id=attempt.id, state=state, fault=None, reason=None, progress_s=90.0, print_time_s=90.0,
            extruded=True, started_s=started_s, ended_s=self.clock.now_s if is_ended else None,
        )  # fmt: skip
        link, filament = Link.READY if is_ended else Link.BUSY, FilamentState.PARKED
        self.farm.controller.on_snapshot(
            AgentSnapshot(printer=printer, link=link, agent_pid=9, filament=filament, print=agent_print)
        )

    def finish_prints(self, *printers):
        """Let the prints of these printers run for 100 s from now on, and clear their beds."""
        started_s = self.clock.now_s
        for printer in printers:
            self.report_print(printer, PrintState.PRINTING, started_s)
        self.clock.now_s += 100.0
        for printer in printers:
            self.report_print(printer, PrintState.DONE, started_s)
            self.farm.report_ready(printer)
            self.farm.clear_bed(printer)

    def describe_job(self):
        return describe_job(self.farm.build_view_context(self.state), self.farm.controller.books.get_job(1))


def test_reprint_a_day_later_adds_the_time_of_its_print(tmp_path):
    scenario = Scenario(tmp_path)
    scenario.finish_prints("a", "b")
    first_view = scenario.describe_job()
    assert (first_view.state, first_view.elapsed_s, first_view.speedup, first_view.utilisation) == (
        JobState.DONE,
        100.0,
        5.0,
        1.0,
    )

    scenario.clock.now_s += DAY_S
    scenario.farm.parts.reprint(1, "p01", "it fell", "ann")
    requested_view = scenario.describe_job()
    assert (
        requested_view.state,
        requested_view.elapsed_s,
        requested_view.current_s,
        requested_view.speedup,
    ) == (
        JobState.PRINTING,
        100.0,
        200.0,
        2.5,
    )
    scenario.finish_prints("a")

    repeated_view = scenario.describe_job()
    assert (repeated_view.state, repeated_view.elapsed_s, repeated_view.current_s, repeated_view.speedup) == (
        JobState.DONE,
        200.0,
        200.0,
        2.5,
    )
    assert repeated_view.utilisation == pytest.approx(2 / 3)
    assert repeated_view.runs[0].ended < repeated_view.runs[1].started
    assert (repeated_view.wasted_s, repeated_view.good) == (100.0, 2)
    rows = list_history(scenario.farm.build_view_context(scenario.state), job=1)
    assert [row.took_s for row in rows] == [100.0] * 3
    assert [row.part for row in rows if row.wasted] == ["1/p01"]

    scenario.farm.store.close()
    scenario.farm = Farm(tmp_path, clock=scenario.clock)  # after a restart
    assert scenario.describe_job() == repeated_view
