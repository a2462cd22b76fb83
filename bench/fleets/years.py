"""Size of a state folder after a year of nights, with and without nightly pruning, from simulated prints.

    python -m bench.fleets.years --json
    python -m bench.fleets.years --measure STATE_FOLDER    # sizes of the files of a planned job

Every night a job is planned, printed on eight printers and judged, and the database is backed up. The files
of a job have the sizes of those of a real night and take no space (they are sparse). The state, its events,
the backup and the pruning are the daemon's own. The pictures of parts are not drawn; a file of the usual size
replaces each of them.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import random
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from bench.fleets.agents.without_agents import NoEffects
from bench.fleets.measured_daemon import make_planned_event
from drivers.clock import Clock
from farm.compute import WorkerPool
from farm.config import Fleet
from farm.control import Controller
from farm.model import Bed, FilamentState, Job, JobOptions, PrintState
from farm.paths import StateFolder
from farm.planning import list_bed_boxes
from farm.state import events as ev
from farm.state.retention import list_job_file_names, list_referenced_files
from farm.state.storage import Store, list_files, read_books
from farm.state.transitions import apply
from farm.upkeep.upkeep import Upkeep

DAY_S = 86400.0
START_S = 1_790_000_000.0
PARTS_PER_JOB = 8
PICTURE_BYTES = 17_000  # mean size of the pictures of parts
FILE_AGE_S = 7200.0  # seconds of wall-clock time; pruning keeps younger files
JOB_FILE_BYTES = {
    "model": [1009943],
    "stl": [703584, 484884, 408684, 480384, 511284, 579384, 311584, 446084],
    "gcode": [22400779, 12443729, 10703633, 10851730, 12796205, 15853277, 10104921, 10837877],
    "picture": [396072],
    "assembly": [3774900],
    "report": [10635],
}
"""Bytes of the files of one job: the Stanford bunny, 350 mm long, 1.65 kg in eight parts of 14 h each."""


class NightClock(Clock):
    """Clock that is set to the time of each night."""

    now_s = START_S

    def now(self) -> float:
        """Return the time of the current night in farm seconds."""
        return self.now_s


class FakeWorkers:
    """Workers whose pictures of parts are files of the usual size."""

    async def run(
        self, function: object, files: Path, parts: dict[str, str], *_: object, **__: object
    ) -> object:
        """Write a file for the picture of each part; return their names by part."""
        return {part: write_sparse(files, f"{name}.png", PICTURE_BYTES) for part, name in parts.items()}


def write_sparse(files: Path, name: str, size_bytes: int) -> str:
    """Write a sparse file of a size, last modified two hours ago."""
    path = files / name
    path.touch()
    os.truncate(path, size_bytes)
    stored_s = time.time() - FILE_AGE_S
    os.utime(path, (stored_s, stored_s))
    return name


def list_printer_names(job_count: int) -> list[str]:
    """List the names of the printers that a number of jobs per night need."""
    return [f"um2-{number:02d}" for number in range(1, PARTS_PER_JOB * job_count + 1)]


def list_job_events(
    number: int, at_s: float, names: dict[str, list[str]], printers: list[str]
) -> Iterator[ev.AnyEvent]:
    """Yield the events of a job that is planned, printed and judged good in one night.

    Parameters
    ----------
    number
        Number of the job.
    at_s
        Time of its submission in farm seconds.
    names
        Names of its files in the store, by kind.
    printers
        Names of its printers, one for each part.
    """
    (model,) = names["model"]
    job = Job(
        id=number, request_id=f"request-{number}", name="bunny.stl", model_file=model, options=JobOptions(),
        submitted_s=at_s,
    )  # fmt: skip
    yield ev.JobSubmitted(at_s=at_s, job=job)
    yield ev.PlanningStarted(at_s=at_s, job=number)
    plan = make_planned_event(number, len(names["gcode"]), printers, random.Random(number))
    parts = zip(plan.parts, names["stl"], strict=True)
    plates = zip(plan.plates, names["gcode"], strict=True)
    yield plan.model_copy(
        update={
            "at_s": at_s + 1800.0,
            "parts": tuple(part.model_copy(update={"file": name}) for part, name in parts),
            "plates": tuple(plate.model_copy(update={"gcode": name}) for plate, name in plates),
            "picture": names["picture"][0],
            "assembly": names["assembly"][0],
            "decomposition": names["report"][0],
        }
    )
    for plate, printer in zip(plan.plates, printers, strict=False):
        name, start_s, end_s = f"{plate.id}-print", at_s + 1900.0, at_s + 10 * 3600.0
        yield ev.PlateAssigned(at_s=start_s, plate=plate.id, printer=printer, print_id=name)
        for state in (PrintState.HEATING, PrintState.PRINTING):
            extruded = state is PrintState.PRINTING
            yield ev.PrintProgressed(
                at_s=start_s, print_id=name, state=state, started_s=start_s, extruded=extruded
            )
        yield ev.PrintEnded(
            at_s=end_s, print_id=name, state=PrintState.DONE, fault=None, reason=None, started_s=start_s,
            ended_s=end_s, extruded=True, filament=FilamentState.PARKED,
        )  # fmt: skip
        yield ev.BedCleared(at_s=end_s + 3600.0, printer=printer, by="ann")


class SimulatedFarm:
    """State folder of a farm that prints every night."""

    def __init__(self, root: Path, keep: dict[str, float], job_count: int) -> None:
        self.state = StateFolder(root)
        self.state.make()
        self.store, self.clock = Store(self.state.books), NightClock()
        fleet = Fleet.model_validate({"fleet": {"keep": keep}, "printers": []})
        self.controller = Controller(fleet, self.store, self.clock, list_bed_boxes)
        self.controller.start(NoEffects())
        self.upkeep = Upkeep(self.controller, self.store, self.state, cast(WorkerPool, FakeWorkers()))
        self.upkeep_s: list[float] = []
        self._job_count = job_count
        for name in list_printer_names(job_count):
            self._commit(ev.PrinterAdded(at_s=START_S, printer=name, bed=Bed.CLEAR))

    def _commit(self, event: ev.AnyEvent) -> None:
        new_books, _ = apply(event, self.controller.books)
        self.store.commit(event, self.controller.books, new_books)
        self.controller.books = new_books

    async def simulate_nights(self, night_count: int) -> None:
        """Simulate the prints of some nights, each followed by the upkeep: backup and pruning."""
        for night in range(1, night_count + 1):
            self.clock.now_s = START_S + night * DAY_S
            for index in range(self._job_count):
                number = (night - 1) * self._job_count + index + 1
                printers = list_printer_names(self._job_count)[PARTS_PER_JOB * index :][:PARTS_PER_JOB]
                for event in list_job_events(
                    number, self.clock.now_s - 14 * 3600.0, self._write_files(number), printers
                ):
                    self._commit(event)
            start_s = time.perf_counter()
            await self.upkeep.prune("the bench", dry_run=False)
            self.upkeep_s.append(time.perf_counter() - start_s)

    def _write_files(self, number: int) -> dict[str, list[str]]:
        return {
            kind: [
                write_sparse(self.state.files, f"{number}-{i}.{kind}", size_bytes)
                for i, size_bytes in enumerate(sizes_bytes)
            ]
            for kind, sizes_bytes in JOB_FILE_BYTES.items()
        }

    def measure(self) -> dict[str, Any]:
        """Close the store, and return the sizes at the end of the year."""
        files, books = list_files(self.state.files), self.controller.books
        event_count = len(self.store.read_all_events())
        missing_files = list_referenced_files(books) - files.keys()
        self.store.close()
        oldest_backup, *_ = sorted(self.state.backups.iterdir())
        pruned_jobs = [job for job in books.jobs.values() if job.pruned_s]
        return {
            "files_gb": sum(file.size_bytes for file in files.values()) / 1e9,
            "database_mb": self.state.books.stat().st_size / 1e6,
            "backups_mb": sum(path.stat().st_size for path in self.state.backups.iterdir()) / 1e6,
            "backup_readable": read_books(oldest_backup)[1] > 0,
            "events": event_count,
            "jobs": len(books.jobs),
            "pruned_jobs": len(pruned_jobs),
            "missing_files": len(missing_files),
            "upkeep_s_median": statistics.median(self.upkeep_s),
            "upkeep_s_worst": max(self.upkeep_s),
        }


def measure_job(state: StateFolder, number: int) -> dict[str, list[int]]:
    """Return the sizes of the files of a planned job, by kind."""
    books, _ = read_books(state.books)
    job = books.jobs[number]
    kinds = {
        "model": [job.model_file],
        "stl": [books.parts[name].file for name in job.parts],
        "gcode": [books.plates[name].gcode for name in job.plates],
        "picture": [job.picture or ""],
        "assembly": [job.assembly or ""],
        "report": [job.decomposition or ""],
    }
    assert {name for names in kinds.values() for name in names} == list_job_file_names(books, job)
    return {kind: [(state.files / name).stat().st_size for name in names] for kind, names in kinds.items()}


def run(night_count: int, keep: dict[str, float], job_count: int) -> dict[str, Any]:
    """Simulate a farm in a new folder, and measure it."""
    with tempfile.TemporaryDirectory(prefix="farm-years-") as folder:
        farm = SimulatedFarm(Path(folder), keep, job_count)
        asyncio.run(farm.simulate_nights(night_count))
        return farm.measure()


def main() -> None:
    """Print the sizes with and without pruning."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nights", type=int, default=365)
    parser.add_argument("--jobs", type=int, default=1, help="jobs a night, each on eight printers")
    parser.add_argument("--days", type=float, default=90.0, help="value of `fleet.keep.days`")
    parser.add_argument("--gb", type=float, default=50.0, help="value of `fleet.keep.gb`")
    parser.add_argument("--measure", type=Path, metavar="FOLDER", help="only measure job 1 of a state folder")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.measure is not None:
        print(json.dumps(measure_job(StateFolder(args.measure), 1)))
        return
    logging.disable()
    no_limits = {"days": 1e6, "gb": 1e6}
    figures = {
        "night_gb": args.jobs * sum(map(sum, JOB_FILE_BYTES.values())) / 1e9,
        "nights": args.nights,
        "printers": PARTS_PER_JOB * args.jobs,
        "kept": run(args.nights, {"days": args.days, "gb": args.gb}, args.jobs),
        "everything": run(args.nights, no_limits, args.jobs),
    }
    if args.json:
        print(json.dumps(figures))
        return
    print(
        f"{args.nights} nights of {figures['printers']} printers; "
        f"{figures['night_gb']:.2f} GB of new files per night"
    )
    for name, keep in (("without pruning", "everything"), ("with pruning", "kept")):
        measures = figures[keep]
        print(
            f"{name:<16} {measures['files_gb']:7.1f} GB, database {measures['database_mb']:.1f} MB and "
            f"{measures['events']} events, backup and pruning {measures['upkeep_s_median']:.2f} s a night "
            f"(worst {measures['upkeep_s_worst']:.2f})"
        )


if __name__ == "__main__":
    main()
