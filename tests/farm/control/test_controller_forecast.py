"""Forecasts of a simulated fleet whose prints take the expected times, so that they are exact."""

import heapq
import tempfile
from pathlib import Path

from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from books.make_books import make_plan_event
from books.recording_controller import MODEL, Farm
from farm.errors import FarmError
from farm.model import AgentPrint, AgentSnapshot, Bed, FilamentState, JobOptions, JobState, Link, PrintState
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.scheduling.forecast import CLEARING_S
from farm.state import events as ev
from farm.state.plate_state import PlateState

HOUR_S = 3600.0
MONDAY_S = 1_000_000.0 // 604800 * 604800 + 4 * 86400  # 00:00 UTC
HEATING_S = 300.0
ORDER = (PrintState.DONE, PrintState.PRINTING, None)  # of simultaneous changes, as in the forecast


class Clock:
    scale = 1.0

    def __init__(self, now_s):
        self.now_s = now_s

    def now(self):
        return self.now_s


class ForecastSimulation:
    """Farm whose printers and people act as in the forecast."""

    def __init__(self, folder, printers, now_s, start_rules):
        self.clock = Clock(now_s)
        self.farm = Farm(
            folder, ["ultimaker2_plus"] * printers, clock=self.clock, timezone="UTC", **start_rules
        )
        self.controller = self.farm.controller
        self.controller.started_s = now_s - HOUR_S
        self.farm.report_ready(*self.controller.fleet.names)
        self.pending_steps, self.started_ids, self.end_s = [], set(), now_s + 28 * 24 * HOUR_S

    def plan(self, hours, options):
        request = f"r{len(self.controller.books.jobs):07d}"
        number, _ = self.farm.jobs.submit(request, "m.stl", MODEL, options)
        if self.controller.books.jobs[number].state is JobState.QUEUED:
            self.controller.handle(ev.PlanningStarted(at_s=self.clock.now_s, job=number))
        event = make_plan_event(number, len(hours))
        names = self.controller.fleet.names
        plates = tuple(
            plate.model_copy(
                update={
                    "sliced_s": item * HOUR_S,
                    "expected_s": item * HOUR_S + HEATING_S,
                    "grams": 100.0 * item,
                    "printer": names[index % min(len(names), options.printers or len(names))],
                    "family": "ultimaker2_plus",
                }
            )
            for index, (plate, item) in enumerate(zip(event.plates, hours, strict=True))
        )
        self.planned = len(self.farm.effects.plans)
        self.controller.on_plan(number, Plan(event.parts, plates, (), 1.0, 500.0, 100.0))
        self.refuse_revisions()

    def refuse_revisions(self):
        """Reject all revisions, so that every job keeps its first plan."""
        while len(self.farm.effects.plans) > self.planned:
            number, *_ = self.farm.effects.plans[self.planned]
            self.planned += 1
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
        self.refuse_revisions()
        now_s = self.clock.now_s
        for attempt in list(self.controller.books.open_prints()):
            if attempt.id not in self.started_ids:
                self.started_ids.add(attempt.id)
                plate = self.controller.books.plates[attempt.plate]
                state_delays_s = {PrintState.PRINTING: HEATING_S, PrintState.DONE: plate.expected_s}
                self.report_print(attempt.printer, attempt.id, PrintState.HEATING, now_s)
                for state, after_s in state_delays_s.items():
                    self.add_step(now_s + after_s, attempt.printer, attempt.id, state, now_s)

    def add_step(self, at_s, name, print_id, state, started_s):
        """Add an action: a state of a print, or a cleared bed if the state is None."""
        heapq.heappush(self.pending_steps, (at_s, ORDER.index(state), name, print_id, started_s))

    def step(self):
        """Advance to the time of the next change; return False if there is none."""
        self.start_prints()
        edge_s = self.find_next_edge_s()
        next_s = min(self.pending_steps[0][0] if self.pending_steps else float("inf"), edge_s)
        if next_s == float("inf") or next_s > self.end_s:
            return False
        self.clock.now_s = next_s
        if not self.pending_steps or self.pending_steps[0][0] > next_s:
            self.controller.handle()
            return True
        self.take_step(next_s)
        return True

    def find_next_edge_s(self):
        """Return the time at which hours or start times change next."""
        rules, now_s = self.controller.rules, self.clock.now_s
        starts = (job.not_before_s for job in self.controller.books.jobs.values() if not job.state.ended)
        edges = (rules.attended.find_next_edge_s(now_s), rules.quiet.find_next_edge_s(now_s), *starts)
        return min((edge for edge in edges if edge is not None and edge > now_s), default=float("inf"))

    def take_step(self, next_s):
        """Perform the next action that is due."""
        _, order, name, print_id, started_s = heapq.heappop(self.pending_steps)
        state = ORDER[order]
        if state is None:
            self.farm.clear_bed(name)
            return
        self.report_print(name, print_id, state, started_s, next_s if state.ended else None)
        if state.ended:
            clear_s = self.controller.rules.find_bed_clear_s(next_s, CLEARING_S)
            self.add_step(clear_s, name, print_id, None, 0.0)

    def run_to_end(self):
        """Run to the end; return the end of each plate."""
        while self.step():
            pass
        books = self.controller.books
        return {p.plate: p.ended_s for p in books.prints.values() if p.state is PrintState.DONE}


jobs = st.lists(
    st.tuples(
        st.lists(st.integers(2, 24).map(lambda halves: halves / 4), min_size=1, max_size=6),
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


# Without shrinking, which takes minutes.
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
# A print of a job at its limit of printers ends at the moment when another bed becomes clear.
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
# A print of a job at its limit of printers ends at the moment when attended hours begin.
@example(
    [([2.0], JobOptions()), ([2.0, 0.75, 5.0], JobOptions(printers=2, spares=1)), ([0.75], JobOptions())],
    {"max_heating": 1, "attended": ["mon-fri 08:00-12:00", "13:00-17:00"]},
    4,
    7,
    [2000, 326, 300, 2000],
)
@given(jobs, rule_sets, st.integers(1, 4), st.integers(0, 23), st.lists(st.integers(200, 2000), max_size=4))
def test_forecast_is_exact_without_failures(job_specs, start_rules, printers, hour, reels):
    with tempfile.TemporaryDirectory() as folder:
        simulation = ForecastSimulation(
            Path(folder) / "farm", printers, MONDAY_S + hour * HOUR_S, start_rules
        )
        for name, grams in zip(simulation.controller.fleet.names, reels, strict=False):
            reel = {"material": "generic_pla", "grams": grams, "nozzle_mm": 0.4}
            simulation.controller.handle(ev.ReelLoaded(at_s=1.0, printer=name, reel=reel, by="ann"))
        for hours, options in job_specs:
            simulation.plan(hours, options)
        simulation.start_prints()
        now_s = simulation.clock.now_s
        books = simulation.controller.books
        forecast_ends_s = dict(simulation.controller.build_view_context(StateFolder(Path(folder))).ends_s)
        waiting_ids = {plate.id for plate in books.waiting_plates()}
        assert forecast_ends_s.keys() <= waiting_ids
        end_times_s = simulation.run_to_end()
        remaining_ids = {p.id for p in simulation.controller.books.waiting_plates()}
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
            simulation.controller.books.plate_state(p) is PlateState.PRINTING
            for p in simulation.controller.books.plates.values()
        )
        simulation.farm.store.close()
