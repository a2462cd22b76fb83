"""Time of `farm status` with many printers and jobs in the books.

python -m bench.fleets.status --json
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx

from bench.fleets.agents.without_agents import make_snapshot
from drivers.clock import Clock
from farm.compute import WorkerPool
from farm.config import Fleet
from farm.control import Controller, DryRuns
from farm.http import Person, Services, make_app
from farm.model import (
    Bed,
    Entity,
    FilamentState,
    Job,
    JobOptions,
    JobState,
    Part,
    PartGeometry,
    Plate,
    Print,
    Printer,
    PrintState,
    Verdict,
)
from farm.paths import StateFolder
from farm.planning import list_bed_boxes
from farm.state import Books
from farm.state.storage import Store

PARTS_PER_JOB = 9
PRINTING_JOBS = 10  # number of jobs that print, and of jobs that wait for a verdict
WAITING_JOBS = 20  # jobs without a started plate
HOUR_S = 3600.0
BOUNDS_MM = ((-40.0, -40.0, 0.2), (40.0, 40.0, 100.0))


def make_job(number: int, jobs: int, printers: list[str], now_s: float) -> list[Entity]:
    """Make a job with parts, plates and prints: a job that is done, that lacks verdicts, or that is open."""
    is_waiting = number > jobs - WAITING_JOBS
    is_printing = not is_waiting and number > jobs - WAITING_JOBS - PRINTING_JOBS
    has_verdicts = number <= jobs - WAITING_JOBS - 2 * PRINTING_JOBS
    is_open = is_printing or is_waiting
    state = JobState.PRINTING if is_open else JobState.DONE if has_verdicts else JobState.PRINTED
    start_s = now_s - HOUR_S - (0.0 if is_open else (jobs - number) * HOUR_S)
    plate_ids = [f"{number}/{i:02d}" for i in range(1, PARTS_PER_JOB + 1)]
    entities: list[Entity] = []
    for i, plate_id in enumerate(plate_ids):
        printer = printers[(number * PARTS_PER_JOB + i) % len(printers)]
        attempt = Print(
            id=plate_id, plate=plate_id, job=number, printer=printer, assigned_s=start_s, started_s=start_s,
            state=PrintState.PRINTING if is_printing else PrintState.DONE, extruded=True,
            ended_s=None if is_printing else start_s + HOUR_S, verdict=Verdict.GOOD if has_verdicts else None,
        )  # fmt: skip
        part = Part(
            id=f"{number}/p{i + 1:02d}", job=number, plate=plate_id, file="p.stl",
            geometry=PartGeometry(
                to_model=(1.0,) * 16, min_mm=BOUNDS_MM[0], max_mm=BOUNDS_MM[1], volume_mm3=1e5
            ),
        )  # fmt: skip
        plate = Plate(
            id=plate_id, job=number, parts=(part.id,), gcode="g.gcode", sha256="0" * 64, sliced_s=HOUR_S,
            expected_s=HOUR_S + 300.0, grams=90.0, filament_mm=11000.0, layers=500, min_mm=BOUNDS_MM[0],
            max_mm=BOUNDS_MM[1], material="generic_pla", nozzle_mm=0.4, printer=printer,
            prints=() if is_waiting else (attempt.id,),
        )  # fmt: skip
        entities += [part, plate] if is_waiting else [part, plate, attempt]
    job = Job(
        id=number, request_id=f"request-{number}", name="bunny.stl", model_file="m.npz", options=JobOptions(),
        state=state, submitted_s=start_s, planned_s=start_s, plates=tuple(plate_ids),
        parts=tuple(f"{number}/p{i:02d}" for i in range(1, PARTS_PER_JOB + 1)), expected_s=HOUR_S,
        serial_s=9 * HOUR_S, ended_s=None if is_open else start_s + HOUR_S,
    )  # fmt: skip
    return [job, *entities]


async def measure(printers: int, jobs: int, rounds: int, folder: Path) -> dict[str, float | int]:
    """Measure the time and the size of an answer to `GET /status`."""
    names = [f"um2-{i:03d}" for i in range(1, printers + 1)]
    port = "sim://ultimaker2_plus"
    fleet = Fleet.model_validate(
        {"printers": [{"name": n, "model": "ultimaker2_plus", "port": port} for n in names]}
    )
    clock = Clock()
    controller = Controller(fleet, Store(folder / "farm.db"), clock, list_bed_boxes)
    controller.is_stopping = True  # nothing is scheduled, so only the answer is measured
    now_s = clock.now()
    entities = [entity for number in range(1, jobs + 1) for entity in make_job(number, jobs, names, now_s)]
    printer_records = [Printer(name=name, bed=Bed.NOT_CLEAR, filament=FilamentState.PARKED) for name in names]
    controller.books = Books.from_entities([*entities, *printer_records])
    for name in names:
        controller.telemetry.snapshots[name] = make_snapshot(
            name, controller.books.find_open_print(name), 600.0, HOUR_S
        )

    async def shut_down(now: bool) -> None:
        pass

    workers = WorkerPool(folder / "workers", 1, None)
    app = make_app(
        Services(controller, StateFolder(folder), folder / "fleet.yaml", workers, shut_down),
        DryRuns(controller),
    )
    durations_s, cpu_times_s = [], []
    person = Person(os.getuid(), os.getgid())

    async def identify_person(scope: Any, receive: Any, send: Any) -> None:
        await app({**scope, "state": {"caller": person}}, receive, send)

    async with httpx.AsyncClient(
        transport=httpx.ASGITransport(identify_person), base_url="http://farm"
    ) as client:
        for _ in range(rounds + 1):
            start_s, start_cpu_s = time.perf_counter(), time.process_time()
            answer = await client.get("/status")
            durations_s.append(time.perf_counter() - start_s)
            cpu_times_s.append(time.process_time() - start_cpu_s)
            assert answer.status_code == 200, answer.text
    workers.close()
    durations_s = sorted(durations_s[1:])  # the first one compiles the schema
    return {
        "printers": printers,
        "jobs": jobs,
        "prints": len(controller.books.prints),
        "answer_bytes": len(answer.content),
        "median_s": statistics.median(durations_s),
        "worst_s": durations_s[-1],
        "cpu_median_s": statistics.median(cpu_times_s[1:]),
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--printers", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1000)
    parser.add_argument("--times", type=int, default=50)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = asyncio.run(measure(args.printers, args.jobs, args.times, Path(folder)))
    if args.json:
        print(json.dumps(result, indent=2))
        return
    print(
        f"{result['printers']} printers, {result['jobs']} jobs: `farm status` answered in "
        f"{1000 * result['median_s']:.0f} ms (at worst {1000 * result['worst_s']:.0f} ms)"
    )


if __name__ == "__main__":
    main()
