"""CPU time of the controller with a large fleet, in this process, without sockets or other processes.

``python -m bench.fleets.controller_scale [--printers N] [--plates N] [--json]``. All printers connect one
after another; each then gets a plate, and prints. Every request for another plan of a job is refused.

* ``connect_cpu_s``: the first reports of all printers.
* ``start_cpu_s``: the ticks that start their prints.
* ``status_ms``: one description of the farm for `farm status`; ``status_json_ms``: with `--json`.
* ``cleared_ms``: a person's command after which the next plate starts, the most expensive frequent event.

Figures in ms are medians over single calls, except ``starting_tick_max_ms`` (the slowest of the ticks that
start prints) and ``first_status_ms`` (the first of the calls for ``status_ms``).
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from bench.fleets.agents.without_agents import NoEffects, make_snapshot
from bench.fleets.measured_daemon import fill_books
from drivers.clock import Clock
from farm.config import Fleet
from farm.control import Controller
from farm.errors import FarmError
from farm.http import Services
from farm.http.routes.status import describe_farm, summarise_farm
from farm.model import Print, PrintState
from farm.paths import StateFolder
from farm.planning import list_bed_boxes
from farm.scheduling import StartPlanning
from farm.state import events as ev
from farm.state.storage import Store

PRINTER_MODEL = "ultimaker2_plus"
REPEATS = 5
MAX_TICKS = 200
PLATE_CHANGES = 40


class PlanningRecorder(NoEffects):
    """Effects that store the jobs to plan.

    Attributes
    ----------
    jobs_to_plan
        Numbers of the jobs to plan.
    """

    def __init__(self) -> None:
        self.jobs_to_plan: list[int] = []

    def perform(self, effect: object, books: object) -> None:
        """Store the number of a job to plan; ignore every other effect."""
        if isinstance(effect, StartPlanning):
            self.jobs_to_plan.append(effect.job)

    def refuse_plans(self, controller: Controller) -> None:
        """Answer each request for a plan with an error, so that the job keeps its plan."""
        while self.jobs_to_plan:
            controller.on_plan(self.jobs_to_plan.pop(), FarmError("no better plan"))


def measure_calls(calls: Iterable[Callable[[], object]]) -> list[float]:
    """Return the CPU seconds of each call."""
    durations_s = []
    for call in calls:
        start_s = time.thread_time()
        call()
        durations_s.append(time.thread_time() - start_s)
    return durations_s


def measure(printers: int, plates: int) -> dict[str, float]:
    """Run the measurement in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        state = StateFolder(Path(folder))
        state.make()
        names = [f"um2-{number:03d}" for number in range(1, printers + 1)]
        fill_books(state.books, names, plates)
        rows = [{"name": name, "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"} for name in names]
        store = Store(state.books)
        try:
            controller = Controller(Fleet.model_validate({"printers": rows}), store, Clock(), list_bed_boxes)
            effects = PlanningRecorder()
            controller.start(effects)
            return _measure_controller(controller, effects, state, names)
        finally:
            store.close()


def _measure_controller(
    controller: Controller, effects: PlanningRecorder, state: StateFolder, names: list[str]
) -> dict[str, float]:
    connect_s = measure_calls(lambda name=name: controller.on_snapshot(make_snapshot(name)) for name in names)  # type: ignore[misc]
    start_tick_times_s: list[float] = []
    while len(list(controller.books.list_open_prints())) < len(names) and len(start_tick_times_s) < MAX_TICKS:
        start_tick_times_s += measure_calls([controller.tick])
        effects.refuse_plans(controller)
    prints = list(controller.books.list_open_prints())

    def report_all(progress_s: float) -> list[float]:
        return measure_calls(
            lambda attempt=attempt: controller.on_snapshot(
                make_snapshot(attempt.printer, attempt, progress_s)
            )  # type: ignore[misc]
            for attempt in prints
        )

    event_s, report_s = report_all(0.0), report_all(1.0)
    cleared_s = [_measure_clear_command(controller, effects, attempt) for attempt in prints[:PLATE_CHANGES]]
    controller.tick()
    services: Any = Services(controller, state, state.root / "fleet.yaml", None, None)  # type: ignore[arg-type]
    schedule_s = measure_calls([controller.handle] * REPEATS)
    idle_tick_times_s = measure_calls([controller.tick] * REPEATS)
    summary_s = measure_calls([lambda: summarise_farm(services).model_dump_json()] * REPEATS)
    status_s = measure_calls([lambda: describe_farm(services).model_dump_json()] * REPEATS)
    return {
        "connect_cpu_s": sum(connect_s),
        "start_cpu_s": sum(start_tick_times_s),
        # In a small fleet the reports start all prints, without a tick.
        "starting_tick_max_ms": 1000 * max(start_tick_times_s, default=0.0),
        "event_ms": 1000 * statistics.median(event_s),
        "report_ms": 1000 * statistics.median(report_s),
        "cleared_ms": 1000 * statistics.median(cleared_s),
        "schedule_ms": 1000 * statistics.median(schedule_s),
        "tick_ms": 1000 * statistics.median(idle_tick_times_s),
        "status_ms": 1000 * statistics.median(summary_s),
        "first_status_ms": 1000 * summary_s[0],
        "status_json_ms": 1000 * statistics.median(status_s),
    }


def _measure_clear_command(controller: Controller, effects: PlanningRecorder, attempt: Print) -> float:
    """End a print, and clear its bed; return the CPU seconds that the start of the next plate takes."""
    ready_snapshot = make_snapshot(attempt.printer)
    printing_snapshot = make_snapshot(attempt.printer, attempt)
    assert printing_snapshot.print is not None
    done_print = printing_snapshot.print.model_copy(
        update={"state": PrintState.DONE, "ended_s": controller.clock.now()}
    )
    controller.on_snapshot(printing_snapshot.model_copy(update={"bed_clear": False, "print": done_print}))
    controller.on_snapshot(ready_snapshot.model_copy(update={"bed_clear": False}))
    controller.tick()
    controller.on_snapshot(ready_snapshot)
    event = ev.BedCleared(at_s=controller.clock.now(), printer=attempt.printer, by="ann")
    (seconds,) = measure_calls([lambda: controller.handle(event)])
    effects.refuse_plans(controller)
    return seconds


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--printers", type=int, default=1000)
    parser.add_argument("--plates", type=int, default=10_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    figures = measure(options.printers, options.plates)
    if options.json:
        print(json.dumps({"schema": 1, "printers": options.printers, "plates": options.plates, **figures}))
        return
    for name, value in figures.items():
        print(f"{name:22} {value:10.3f}")


if __name__ == "__main__":
    main()
