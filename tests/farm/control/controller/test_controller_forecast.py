"""Forecasts of a simulated fleet, which are exact because its prints take the expected times."""

import heapq
import tempfile
from pathlib import Path

from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.errors import FarmError
from farm.model import AgentPrint, AgentSnapshot, Bed, FilamentState, JobOptions, JobState, Link, PrintState
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.scheduling.forecast import CLEARING_TIME_S
from farm.state import events as ev
from farm.state.plate_state import PlateState
from hosts.manual_clock import ManualClock

HOUR_S = 3600.0
MONDAY_S = 1_000_000.0 // 604800 * 604800 + 4 * 86400  # 00:00 UTC
HEATING_S = 300.0
STATE_ORDER = (
    PrintState.DONE,
    PrintState.PRINTING,
    None,
)  # order of simultaneous changes, as in the forecast


class ForecastSimulation:
    """Farm whose printers and people act as in the forecast."""

    def __init__(self, folder, printer_count, now_s, start_rules):
        self.clock = ManualClock(now_s)
        self.farm = Farm(
            folder, ["ultimaker2_plus"] * printer_count, clock=self.clock, timezone="UTC", **start_rules
        )
        self.controller = self.farm.controller
        self.controller.started_s = now_s - HOUR_S
        self.farm.report_ready(*self.controller.fleet.names)
        self.pending_steps, self.started_ids, self.end_s = [], set(), now_s + 28 * 24 * HOUR_S

    def plan_job(self, durations_h, options):
        request = f"r{len(self.controller.books.jobs):07d}"
        number, _ = self.farm.jobs.submit(request, "m.stl", INSPECTED_MODEL, options)
        if self.controller.books.jobs[number].state is JobState.QUEUED:
            self.controller.handle(ev.PlanningStarted(at_s=self.clock.now_s, job=number))
        event = make_plan_event(number, len(durations_h))
        names = self.controller.fleet.names
        plates = tuple(
            plate.model_copy(
                update={
                    "sliced_s": duration_h * HOUR_S,
                    "expected_s": duration_h * HOUR_S + HEATING_S,
                    "grams": 100.0 * duration_h,
                    "printer": names[index % min(len(names), options.printers or len(names))],
                    "family": "ultimaker2_plus",
                }
            )
            for index, (plate, duration_h) in enumerate(zip(event.plates, durations_h, strict=True))
        )
        self.planned_count = len(self.farm.effects.plans)
        self.controller.on_plan(number, Plan(event.parts, plates, (), 1.0, 500.0))
        self.reject_revisions()

    def reject_revisions(self):
        """Reject all revisions, so that every job keeps its first plan."""
        while len(self.farm.effects.plans) > self.planned_count:
            number, *_ = self.farm.effects.plans[self.planned_count]
            self.planned_count += 1
            self.controller.on_plan(number, FarmError("no better plan"))

    def report_print(self, name, print_id, state, started_s, ended_s=None):
        extruded = state is not PrintState.HEATING
        agent_print = AgentPrint(
            print_id=print_id, state=state, fault=None, reason=None, progress_s=float(extruded),
            print_time_s=1.0, extruded=extruded, started_s=started_s, ended_s=ended_s,
        )  # fmt: skip
        link = Link.READY if state.ended else Link.BUSY
        filament = FilamentState.PARKED
        self.controller.on_snapshot(
            AgentSnapshot(printer=name, link=link, filament=filament, agent_pid=9, print=agent_print)
        )

    def start_prints(self):
        self.reject_revisions()
        now_s = self.clock.now_s
        for attempt in list(self.controller.books.list_open_prints()):
            if attempt.id not in self.started_ids:
                self.started_ids.add(attempt.id)
                plate = self.controller.books.plates[attempt.plate]
                state_delays_s = {PrintState.PRINTING: HEATING_S, PrintState.DONE: plate.expected_s}
                self.report_print(attempt.printer, attempt.id, PrintState.HEATING, now_s)
                for state, delay_s in state_delays_s.items():
                    self.add_step(now_s + delay_s, attempt.printer, attempt.id, state, now_s)

    def add_step(self, at_s, name, print_id, state, started_s):
        """Add an action: a state of a print, or a cleared bed if the state is None."""
        heapq.heappush(self.pending_steps, (at_s, STATE_ORDER.index(state), name, print_id, started_s))

    def step(self):
        """Advance to the time of the next change; return False if there is none."""
        self.start_prints()
        next_change_s = self.find_next_edge_s()
        next_s = min(self.pending_steps[0][0] if self.pending_steps else float("inf"), next_change_s)
        if next_s == float("inf") or next_s > self.end_s:
            return False
        self.clock.now_s = next_s
        if not self.pending_steps or self.pending_steps[0][0] > next_s:
            self.controller.handle()
            return True
        self.perform_next_step(next_s)
        return True

    def find_next_edge_s(self):
        """Return the next time at which attended or quiet hours change, or a job may start."""
        rules, now_s = self.controller.rules, self.clock.now_s
        starts = (job.not_before_s for job in self.controller.books.jobs.values() if not job.state.ended)
        change_times_s = (
            rules.attended_hours.find_next_edge_s(now_s),
            rules.quiet_hours.find_next_edge_s(now_s),
            *starts,
        )
        return min(
            (
                change_time_s
                for change_time_s in change_times_s
                if change_time_s is not None and change_time_s > now_s
            ),
            default=float("inf"),
        )

    def perform_next_step(self, next_s):
        """Perform the next action that is due."""
        _, order, name, print_id, started_s = heapq.heappop(self.pending_steps)
        state = STATE_ORDER[order]
        if state is None:
            self.farm.clear_bed(name)
            return
        self.report_print(name, print_id, state, started_s, next_s if state.ended else None)
        if state.ended:
            clear_s = self.controller.rules.find_clearing_end_s(next_s, CLEARING_TIME_S)
            self.add_step(clear_s, name, print_id, None, 0.0)

    def run_to_end(self):
        """Run to the end; return the end of each plate."""
        while self.step():
            pass
        books = self.controller.books
        return {p.plate: p.ended_s for p in books.prints.values() if p.state is PrintState.DONE}


jobs = st.lists(
    st.tuples(
        st.lists(st.integers(2, 24).map(lambda quarters: quarters / 4), min_size=1, max_size=6),
        st.builds(JobOptions, printers=st.none() | st.integers(1, 3), spares=st.integers(0, 1)),
    ),
    min_size=1,
    max_size=3,
)
rule_sets = st.fixed_dictionaries(
    {},
    optional={
        "attended": st.sampled_from([["08:00-18:00"], ["mon-fri 08:00-12:00", "13:00-17:00"]]),
        "quiet": st.sampled_from([["22:00-04:00"], ["sat,sun 00:00-12:00"]]),
        "max_heating": st.integers(1, 2),
    },
)


# Shrinking is disabled because it takes minutes.
@settings(max_examples=40, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@example([([8.0] * 8, JobOptions(printers=4))], {}, 8, 9, [])  # two rounds on four of eight printers
# A job that is planned again without a change keeps its place before the next one.
@example(
    [([4.25], JobOptions()), ([4.25], JobOptions()), ([2.0], JobOptions(printers=1, spares=1))],
    {"max_heating": 1, "attended": ["mon-fri 08:00-12:00", "13:00-17:00"]},
    2,
    23,
    [1013, 1084, 861, 640],
)
# A print ends at the moment when another bed becomes clear; its job uses as many printers as it may.
@example(
    [
        ([4.25, 4.5, 3.5, 5.0, 0.75], JobOptions(printers=3)),
        ([3.5, 3.75, 5.75, 1.75, 3.25, 4.75], JobOptions(printers=2)),
    ],
    {"attended": ["08:00-18:00"]},
    4,
    11,
    [1700, 260, 1161],
)
# A print ends at the moment when attended hours begin; its job uses as many printers as it may.
@example(
    [([2.0], JobOptions()), ([2.0, 0.75, 5.0], JobOptions(printers=2, spares=1)), ([0.75], JobOptions())],
    {"max_heating": 1, "attended": ["mon-fri 08:00-12:00", "13:00-17:00"]},
    4,
    7,
    [2000, 326, 300, 2000],
)
@given(jobs, rule_sets, st.integers(1, 4), st.integers(0, 23), st.lists(st.integers(200, 2000), max_size=4))
def test_forecast_is_exact_without_failures(job_specs, start_rules, printer_count, hour, reels_g):
    with tempfile.TemporaryDirectory() as folder:
        simulation = ForecastSimulation(
            Path(folder) / "farm", printer_count, MONDAY_S + hour * HOUR_S, start_rules
        )
        for name, grams in zip(simulation.controller.fleet.names, reels_g, strict=False):
            reel = {"material": "generic_pla", "grams": grams, "nozzle_mm": 0.4}
            simulation.controller.handle(ev.ReelLoaded(at_s=1.0, printer=name, reel=reel, by="ann"))
        for durations_h, options in job_specs:
            simulation.plan_job(durations_h, options)
        simulation.start_prints()
        now_s = simulation.clock.now_s
        books = simulation.controller.books
        forecast_ends_s = dict(simulation.controller.build_view_context(StateFolder(Path(folder))).ends_s)
        waiting_ids = {plate.id for plate in books.list_waiting_plates()}
        assert forecast_ends_s.keys() <= waiting_ids
        end_times_s = simulation.run_to_end()
        remaining_ids = {p.id for p in simulation.controller.books.list_waiting_plates()}
        assert remaining_ids == waiting_ids - forecast_ends_s.keys()
        for number in books.jobs:
            plates = [
                name for name in forecast_ends_s if simulation.controller.books.plates[name].job == number
            ]
            if plates:
                expected_s = max(forecast_ends_s[name] for name in plates) - now_s
                elapsed_s = max(end_times_s[name] for name in plates) - now_s
                assert abs(elapsed_s - expected_s) <= 0.02 * elapsed_s, (number, expected_s, elapsed_s)
        assert all(p.bed is not Bed.UNKNOWN for p in simulation.controller.books.printers.values())
        assert not any(
            simulation.controller.books.find_plate_state(p) is PlateState.PRINTING
            for p in simulation.controller.books.plates.values()
        )
        simulation.farm.store.close()
