"""A Dask cluster: faults of real processes, and the cost of its scheduler for many workers.

``PYTHONPATH=tests/support python -m bench.cluster faults [--rounds N] [--seed N] [--json]``, as root, runs
rounds in which a process or the network fails; see `bench.clusters.faults`. The figures of each round are
printed when it ends (to standard error with `--json`). Each round checks that the plan of the job is the plan
of one computer, that no result is used twice, and that no host has a task or an extra process at the end.

``... jobs [--parts 20,100] [--workers 1,2] [--record FILE] [--json]`` plans a job on a number of workers of
this computer; see `bench.clusters.jobs`. The times of the tasks can be recorded. ``... drawings [--parts
20,100] [--json]`` draws the parts of such jobs on one worker and on several. ``... search [--parts 20,100]
[--workers 1,2] [--budget S] [--json]`` searches for the parts of such jobs, with attempts on several workers.

``... replay [--workers 4,16,64,256] [--parts 20,100] [--jobs N] [--scale F] [--tasks FILE] [--page FILE]
[--json]`` runs jobs whose tasks only sleep through the real scheduler, one job for every four workers; see
`bench.clusters.replay`. `overhead_ms` is the median of the time that a task takes beyond its sleep,
`efficiency` the work divided by workers times duration, and `critical_s` the duration of the longest job on
an unlimited number of workers; `critical_path` has its tasks. All times but `overhead_ms` are unscaled.
In a second run, one worker makes all drawings of a job: `single_drawer_s` is the duration of that run, and
`ratio` the first duration as a share of it. `--page docs/explanation/cluster.md` writes the figures into the
table there.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from bench.clusters.replay import replay

RECORDED_JOBS = Path(__file__).with_name("clusters") / "jobs.json"
TABLE_BEGIN, TABLE_END = "<!-- bench/cluster.py {} -->", "<!-- end of {} -->"
REPLAY_COLUMNS = {
    "workers": "{workers}",
    "jobs": "{jobs}",
    "tasks": "{tasks}",
    "duration": "{duration_s:.0f} s",
    "at least": "{bound_s:.0f} s",
    "efficiency": "{efficiency:.0%}",
    "CPU per task": "{cpu_ms_per_task:.0f} ms",
    "overhead of a task": "{overhead_ms:.0f} ms",
    "if one worker draws": "{single_drawer_s:.0f} s",
    "ratio": "{ratio:.2f}",
}
FAULT_COLUMNS = {
    "fault": "{fault}",
    "rounds": "{rounds}",
    "faults during the job": "{during_job}",
    "duration": "{shortest_s:.0f} to {longest_s:.0f} s",
    "jobs with the same result as on one computer": "{same_plans}",
    "correct tasks": "{correct_tasks}",
    "results used twice": "{results_taken_twice}",
    "remaining tasks": "{remaining_tasks}",
    "extra processes": "{extra_processes}",
    "used the local pool": "{used_local_pool}",
}


def main() -> None:
    """Parse the command line, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("measurement", choices=["faults", "jobs", "drawings", "search", "replay"])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--parts", default="20,100")
    parser.add_argument("--workers", help="1,2 for jobs, and 4,16,64,256 for replay")
    parser.add_argument(
        "--budget", type=float, default=200.0, help="effort of a search, in seconds of one core"
    )
    parser.add_argument("--record", type=Path, help="file for the times of the tasks")
    parser.add_argument("--tasks", type=Path, default=RECORDED_JOBS, help="file with the times of the tasks")
    parser.add_argument("--jobs", type=int, help="default: one for every four workers")
    parser.add_argument("--scale", type=float, default=0.1)
    parser.add_argument(
        "--page", type=Path, help="page whose table gets the figures of faults or of a replay"
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="farm-cluster-") as name:
        folder = Path(name)
        if args.measurement == "faults":
            figures = measure_faults(args.rounds, args.seed, folder, args.json)
        elif args.measurement == "jobs":
            figures = {"runs": measure_jobs(args, folder)}
        elif args.measurement == "search":
            figures = {"runs": measure_searches(args, folder)}
        elif args.measurement == "drawings":
            figures = {"runs": measure_drawings(args, folder)}
        else:
            figures = {"runs": replay_jobs(args, folder)}
    if args.page is not None:
        is_replay = args.measurement == "replay"
        table = (
            (REPLAY_COLUMNS, figures["runs"])
            if is_replay
            else (FAULT_COLUMNS, summarise_faults(figures["rounds"]))
        )
        args.page.write_text(replace_table(args.page.read_text(), args.measurement, *table))
    if args.json:
        print(json.dumps(figures))
        return
    for row in figures.get("runs", [figures]):
        shown_row = {key: value for key, value in row.items() if isinstance(value, int | float | str)}
        texts = (f"{value}" if isinstance(value, str) else f"{value:.4g}" for value in shown_row.values())
        print("  ".join(f"{key} {text}" for key, text in zip(shown_row, texts, strict=True)))


def measure_jobs(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """Plan each job on each number of workers, and record the times of its tasks."""
    from bench.clusters.jobs import list_stages, measure_job

    rows: list[dict[str, Any]] = []
    records: dict[str, list[dict[str, list[float]]]] = {}
    for part_count in map(int, args.parts.split(",")):
        for worker_count in map(int, (args.workers or "1,2").split(",")):
            row = measure_job(part_count, worker_count, folder)
            # Only the first run is recorded, because with one worker nothing is drawn twice.
            records.setdefault(str(part_count), list_stages(row.pop("tasks")))
            rows.append(row)
    if args.record is not None:
        args.record.write_text(json.dumps(records, indent=1) + "\n")
    return rows


def measure_searches(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """Search for the parts of each job on each number of workers."""
    from bench.clusters.jobs import measure_search

    return [
        measure_search(part_count, worker_count, args.budget, folder)
        for part_count in map(int, args.parts.split(","))
        for worker_count in map(int, (args.workers or "1,2").split(","))
    ]


def measure_drawings(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """Draw the parts of each job on one worker and on several."""
    from bench.clusters.jobs import measure_drawing

    return [measure_drawing(int(parts), folder) for parts in args.parts.split(",")]


def replay_jobs(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """Run the recorded jobs on each number of sleeping workers."""
    jobs_by_parts = json.loads(args.tasks.read_text())
    recorded_jobs = [jobs_by_parts[parts] for parts in args.parts.split(",")]
    rows = []
    for worker_count in map(int, (args.workers or "4,16,64,256").split(",")):
        jobs = [recorded_jobs[n % len(recorded_jobs)] for n in range(args.jobs or max(2, worker_count // 4))]
        rows.append(asyncio.run(replay(worker_count, jobs, args.scale, folder / str(worker_count))))
    return rows


def replace_table(page: str, name: str, columns: dict[str, str], rows: list[dict[str, Any]]) -> str:
    """Return a page in which the named table, between two comments, has these rows.

    Parameters
    ----------
    columns
        Headings, with the format of each cell.
    """
    begin, end = TABLE_BEGIN.format(name), TABLE_END.format(name)
    before, _, after = page.partition(begin)
    _, _, rest = after.partition(end)
    lines = [" | ".join(["", *columns, ""]).strip(), "|---" * len(columns) + "|"]
    for row in rows:
        cells = [column.format(**row) for column in columns.values()]
        lines.append(" | ".join(["", *cells, ""]).strip())
    return "\n".join([before + begin, *lines, end + rest])


def summarise_faults(rounds: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each kind of fault."""
    rows = []
    for fault in dict.fromkeys(figures["fault"] for figures in rounds):
        fault_rounds = [figures for figures in rounds if figures["fault"] == fault]
        rows.append(
            {
                "fault": fault,
                "rounds": len(fault_rounds),
                "shortest_s": min(figures["duration_s"] for figures in fault_rounds),
                "longest_s": max(figures["duration_s"] for figures in fault_rounds),
                "same_plans": sum(
                    figures["job_ended"] and not figures["differences"] for figures in fault_rounds
                ),
                "correct_tasks": sum(figures["correct_tasks"] for figures in fault_rounds),
                "results_taken_twice": sum(figures["results_taken_twice"] for figures in fault_rounds),
                "remaining_tasks": sum(figures["remaining_tasks"] for figures in fault_rounds),
                "during_job": sum(figures["during_job"] for figures in fault_rounds),
                "extra_processes": sum(figures["extra_processes"] for figures in fault_rounds),
                "used_local_pool": sum(figures["used_local_pool"] for figures in fault_rounds),
            }
        )
    return rows


def measure_faults(rounds: int, seed: int, folder: Path, as_json: bool) -> dict[str, Any]:
    """Run rounds with faults, and print the figures of each; see `run_faults`."""
    from bench.clusters.faults import run_faults  # needs the command ip, and root
    from hosts.virtual_network import find_obstacle

    obstacle = find_obstacle()
    if obstacle is not None:
        raise SystemExit(f"not run: {obstacle}")

    def report(row: dict[str, Any]) -> None:
        print(json.dumps(row), file=sys.stderr if as_json else sys.stdout, flush=True)

    return asyncio.run(run_faults(rounds, seed, folder, report))


if __name__ == "__main__":
    main()
