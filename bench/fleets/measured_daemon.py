"""Daemon that measures CPU per event and bytes per commit.

``python -m bench.fleets.measured_daemon FOLDER``.
"""

from __future__ import annotations

import cProfile
import json
import random
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.printers import PROFILES
from farm.control import Controller
from farm.daemon import Daemon, run
from farm.fleet_file import load_fleet
from farm.model import AgentSnapshot, Job, JobOptions, Part, PartGeometry, Plate
from farm.paths import FarmPaths, StateFolder
from farm.state import Books
from farm.state import events as ev
from farm.state.books import list_changed_entities
from farm.state.storage import Store
from farm.state.transitions import apply

MEASUREMENTS_FILE = "measures.json"
PLATES_PER_JOB = 20


def fill_books(path: Path, printers: list[str], plates: int) -> None:
    """Write books of planned jobs with a number of plates; every tenth job is limited to four printers."""
    rng, store, books = random.Random(1), Store(path), Books()
    for number in range(1, -(-plates // PLATES_PER_JOB) + 1):
        plate_count = min(PLATES_PER_JOB, plates - (number - 1) * PLATES_PER_JOB)
        options = JobOptions(printers=4 if number % 10 == 0 else None)
        job = Job(
            id=number, request_id=f"request-{number}", name="bunny.stl", model_file="m.npz", options=options,
            submitted_s=float(number),
        )  # fmt: skip
        for event in (
            ev.JobSubmitted(at_s=float(number), job=job),
            ev.PlanningStarted(at_s=float(number), job=number),
            make_planned_event(number, plate_count, printers, rng, options.printers),
        ):
            new_books, _ = apply(event, books)
            store.commit(event, books, new_books)
            books = new_books
    store.close()


def make_planned_event(
    job: int, plate_count: int, printers: list[str], rng: random.Random, max_printers: int | None = None
) -> ev.JobPlanned:
    """Make the plan of one job, which may use a limited number of printers."""
    parts, plates = [], []
    for plate_number in range(1, plate_count + 1):
        sliced_s, top = rng.uniform(3600.0, 36000.0), (40.0, 40.0, rng.uniform(50.0, 190.0))
        geometry = PartGeometry(to_model=(1.0,) * 16, min_mm=(-40.0, -40.0, 0.0), max_mm=top, volume_mm3=1e5)
        name, part = f"{job}/{plate_number:02d}", f"{job}/p{plate_number:02d}"
        parts.append(Part(id=part, job=job, plate=name, file="p.stl", geometry=geometry))
        plates.append(
            Plate(
                id=name, job=job, parts=(part,), gcode="g.gcode", sha256="0" * 64, sliced_s=sliced_s,
                expected_s=sliced_s + 300.0, grams=90.0, filament_mm=11000.0, layers=500,
                min_mm=(-40.0, -40.0, 0.2), max_mm=top, material="generic_pla", nozzle_mm=0.4,
                family=PROFILES["ultimaker2_plus"].family, printer=printers[rng.randrange(len(printers))],
            )
        )  # fmt: skip
    return ev.JobPlanned(
        at_s=float(job), job=job, parts=tuple(parts), plates=tuple(plates), repairs=(), scale=1.0,
        serial_s=9e5, expected_s=36000.0, picture=None,
        printers=tuple(sorted({plate.printer for plate in plates}))[:max_printers],
    )  # fmt: skip


class Measurements:
    """CPU seconds of events, reports and timers; bytes of commits.

    `start_bytes` is the size of the largest commit of each event that starts a print; `snapshot_at_s` has the
    time of each snapshot, and `connected_at_s` that of each printer's first report, on the clock that all
    processes share (`time.monotonic`).
    """

    def __init__(self) -> None:
        self.event_s: list[float] = []
        self.report_s: list[float] = []
        self.timer_s: list[float] = []
        self.commit_bytes: list[int] = []
        self.start_bytes: list[int] = []
        self.snapshot_at_s: list[float] = []
        self.connected_at_s: list[float] = []
        self._connected: set[str] = set()
        self._depth, self._overhead_s, self._starts = 0, 0.0, False

    def measure_time(self, method: Callable[..., Any], quiet_s: list[float]) -> Callable[..., Any]:
        """Measure the time of the outermost call; store it in `event_s` if it commits, else in `quiet_s`."""

        def call(*args: Any, **keywords: Any) -> Any:
            self._depth += 1
            commits, overhead_s, start_s = len(self.commit_bytes), self._overhead_s, time.thread_time()
            try:
                return method(*args, **keywords)
            finally:
                self._depth -= 1
                if not self._depth:
                    duration_s = time.thread_time() - start_s - (self._overhead_s - overhead_s)
                    (self.event_s if len(self.commit_bytes) > commits else quiet_s).append(duration_s)
                    if self._starts:
                        self.start_bytes.append(max(self.commit_bytes[commits:]))
                    self._starts = False

        return call

    def record_times(self, method: Callable[..., Any]) -> Callable[..., Any]:
        """Record the time of each snapshot."""

        def call(controller: Controller, snapshot: AgentSnapshot) -> Any:
            self.snapshot_at_s.append(time.monotonic())
            if snapshot.agent_pid is not None and snapshot.printer not in self._connected:
                self._connected.add(snapshot.printer)
                self.connected_at_s.append(self.snapshot_at_s[-1])
            return method(controller, snapshot)

        return call

    def count_bytes(self, commit: Callable[..., None]) -> Callable[..., None]:
        """Count the bytes of each commit, without adding to the time of its event."""

        def call(store: Store, event: ev.Event, old_books: Books, new_books: Books) -> None:
            commit(store, event, old_books, new_books)
            start_s = time.thread_time()
            changed_entities = list_changed_entities(old_books, new_books)
            texts = [entity.model_dump_json(exclude_defaults=True) for entity in changed_entities]
            size = len(event.model_dump_json()) + sum(map(len, texts))
            self.commit_bytes.append(size)
            self._starts = self._starts or isinstance(event, ev.PlateAssigned)
            self._overhead_s += time.thread_time() - start_s

        return call


def main() -> None:
    """Run the daemon on a state folder, and write its measurements there when it ends."""
    folder = Path(sys.argv[1])
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the server ends on this signal, then raises it again
    measurements = Measurements()
    Store.commit = measurements.count_bytes(Store.commit)  # type: ignore[method-assign]
    for name in ("handle", "on_refusal", "on_plan"):
        setattr(Controller, name, measurements.measure_time(getattr(Controller, name), []))
    on_snapshot = measurements.measure_time(Controller.on_snapshot, measurements.report_s)
    Controller.on_snapshot = measurements.record_times(on_snapshot)  # type: ignore[method-assign]
    Daemon._schedule = measurements.measure_time(Daemon._schedule, measurements.timer_s)  # type: ignore[method-assign]
    paths = FarmPaths(StateFolder(folder), folder / "farm.sock", folder / "fleet.yaml")
    fleet = load_fleet(paths.fleet, frozenset(PROFILES))
    profile = cProfile.Profile(time.thread_time) if len(sys.argv) > 2 else None
    try:
        if profile is None:
            run(fleet, paths)
        else:
            profile.runcall(run, fleet, paths)
    finally:
        if profile is not None:
            profile.dump_stats(sys.argv[2])
        lists = {name: value for name, value in vars(measurements).items() if isinstance(value, list)}
        (folder / MEASUREMENTS_FILE).write_text(json.dumps(lists))


if __name__ == "__main__":
    main()
