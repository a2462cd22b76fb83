"""Night on the accelerated clock: real daemon, agents and emulators, with a script as the operator.

    python -m bench.night --json
    python -m bench.night --seed 3 --keep DIR

One job has many equal plates of slow moves. The operator clears beds in attended hours and is away for a
night. Some boards, chosen by the seed, are reset during a print, one printer is unplugged permanently, and
the daemon is killed twice. The lower bound is that of the remaining printers, without the hours in
which nobody clears a bed (`away_s`). With `--keep`, the farm's folder (books, logs, journals) is kept as a
new folder DIR.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from datetime import UTC, datetime, timedelta
from pathlib import Path

from drivers.emulator.launch import Command, control, is_running
from drivers.errors import DriverError
from drivers.printers import PROFILES
from drivers.records import JOURNAL
from drivers.remote import kill_agent
from farm import api
from farm.cli.client import Client
from farm.errors import DaemonUnreachable, FarmError
from farm.fleet_file import load_fleet
from farm.model import Bed, Job, JobOptions, PrintState
from farm.paths import StateFolder
from farm.planning import Plan
from farm.planning.inspection import complete_section
from farm.planning.inspection.own_gcode import inspect_gcode, plan_gcode
from farm.planning.plan import DecomposeTask
from farm.state import Books, PlateState
from farm.state import events as ev
from farm.state.storage import Store
from farm.state.transitions import apply

PRINTER_MODEL = "ultimaker2_plus"
SIDE_MM, LAYER_MM, MOVES_PER_LAYER = 20.0, 0.2, 4
E_PER_MM = 0.4 * LAYER_MM / 6.38  # for lines of 0.4 mm, with filament of 2.85 mm
AWAY_AFTER_S = 1800.0  # farm time at which the operator's night begins
POLL_S = 0.3  # seconds of wall-clock time between two polls of the operator
START_TIMEOUT_S = 120.0  # seconds of wall-clock time for the start of a daemon on a busy machine


def write_slow_gcode(moves: int, move_s: float) -> str:
    """Write the G-code of a square tower with slow moves."""
    lines = [";FLAVOR:Marlin", "M140 S60", "M104 S205", "M190 S60", "M109 S205", "G28"]
    lines += ["G1 X5 Y5 Z0.3 F3000", "G1 X5 Y100 E15 F1000", "M82", "G92 E0"]
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    e_mm = 0.0
    for layer in range(max(1, moves // MOVES_PER_LAYER)):
        lines += [f";LAYER:{layer}", f"G0 F9000 X100 Y100 Z{LAYER_MM * (layer + 1):.2f}"]
        for x, y in (*corners[1:], corners[0]):
            e_mm += SIDE_MM * E_PER_MM
            speed_mm_min = 60 * SIDE_MM / move_s
            lines.append(f"G1 F{speed_mm_min:.1f} X{100 + SIDE_MM * x:g} Y{100 + SIDE_MM * y:g} E{e_mm:.4f}")
    end_lines = ["G1 F1500 E-6", "M104 S0", "M140 S0", "M107", "G91", "G1 Z10", "G90", "G28 X0 Y0", "M84"]
    return "\n".join([*lines, *end_lines]) + "\n"


class Night:
    """Farm for one night."""

    def __init__(self, folder: Path, args: argparse.Namespace) -> None:
        self.args = args
        self.command = [sys.executable, "-P", "-m", "farm.cli.main"]
        self.state = StateFolder(folder / "state")
        self.fleet_file = folder / "fleet.yaml"
        self.names = [f"um2-{i:02d}" for i in range(1, args.printers + 1)]
        self.rng = random.Random(args.seed)
        self.back_after_s = AWAY_AFTER_S + 3600.0 * args.away_h
        self.client = Client(self.state.root / "farm.sock")
        self.state.make()
        self._write_fleet()
        self.fleet = load_fleet(self.fleet_file, frozenset(PROFILES), complete_section)
        self.plate_s = self._add_planned_job()
        print_numbers = range(1, args.plates + 1)
        # Numbers of started prints at which one fails, and at which a printer is unplugged.
        self.failure_numbers = sorted(
            self.rng.sample(print_numbers, max(1, round(args.failing * args.plates)))
        )
        self.unplug_number = self.rng.randint(2, args.printers)
        # Numbers of printed plates at which the daemon is killed, within the first half of them.
        self.kill_thresholds = [(kill + 1) * args.plates // (2 * args.kills) for kill in range(args.kills)]
        # Printer and plate of each print that was made to fail.
        self.failed_plates: set[tuple[str, str]] = set()
        self.unplugged_printer: str | None = None
        self.kill_count = 0

    def _write_fleet(self) -> None:
        now_time = datetime.now(UTC)
        attended_windows = [
            (now_time - timedelta(hours=1), AWAY_AFTER_S),
            (now_time + timedelta(seconds=self.back_after_s), 12 * 3600.0),
        ]
        windows = [
            f"{start_time:%H:%M}-{(max(start_time, now_time) + timedelta(seconds=length_s)):%H:%M}"
            for start_time, length_s in attended_windows
        ]
        rows = "".join(
            f"  - {json.dumps(self._describe_printer(i, name))}\n" for i, name in enumerate(self.names)
        )
        self.fleet_file.write_text(
            f"fleet: {{name: night, time_scale: {self.args.scale}, attended: {json.dumps(windows)},"
            f" compute: {{workers: 1}}}}\n"
            f"printers:\n{rows}"
        )

    def _describe_printer(self, seed: int, name: str) -> dict[str, str]:
        """Return a printer's entry in `fleet.yaml`."""
        return {"name": name, "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}?seed={seed}"}

    def _add_planned_job(self) -> float:
        """Add a planned job of many equal plates to the books; return the expected time of one."""
        path = self.state.work / "slow.gcode"
        path.write_text(write_slow_gcode(self.args.moves, self.args.move_s))
        options = JobOptions()
        model = inspect_gcode(path, path.name, options, self.fleet.printers, self.state.files)
        plan_folder = self.state.work / "plan"
        plan_folder.mkdir()
        task = DecomposeTask(
            1,
            self.state.files / model.file,
            options,
            self.fleet.printers[:1],
            round_count=1,
            folder=plan_folder,
        )
        plan = plan_gcode(task, self.state.files)
        now_s = time.time()
        job = Job(
            id=1,
            request_id="the-night",
            name="night.gcode",
            model_file=model.file,
            options=options,
            submitted_s=now_s,
        )
        books = Books()
        with Store(self.state.books) as store:
            for event in (
                *(ev.PrinterAdded(at_s=now_s, printer=name, bed=Bed.UNKNOWN) for name in self.names),
                ev.JobSubmitted(at_s=now_s, job=job),
                ev.PlanningStarted(at_s=now_s, job=1),
                self._make_planned_event(plan, now_s),
            ):
                new_books, _ = apply(event, books)
                store.commit(event, books, new_books)
                books = new_books
        return plan.plates[0].expected_s

    def _make_planned_event(self, plan: Plan, now_s: float) -> ev.JobPlanned:
        parts, plates = [], []
        for number in range(1, self.args.plates + 1):
            plate_id, part_id = f"1/{number:02d}", f"1/p{number:02d}"
            printer = self.names[(number - 1) % len(self.names)]
            parts.append(plan.parts[0].model_copy(update={"id": part_id, "plate": plate_id}))
            changes = {"id": plate_id, "parts": (part_id,), "printer": printer}
            plates.append(plan.plates[0].model_copy(update=changes))
        return ev.JobPlanned(
            at_s=now_s,
            job=1,
            parts=tuple(parts),
            plates=tuple(plates),
            repairs=(),
            scale=1.0,
            serial_s=plan.serial_s * self.args.plates,
            expected_s=plan.expected_s,
            picture=None,
        )

    # -- the farm ---------------------------------------------------------------------------------------

    def run_farm(self, *arguments: str) -> None:
        """Run a command of `farm`."""
        command = [*self.command, *arguments, "--state", str(self.state.root)]
        if arguments[0] == "up":
            command += ["--fleet", str(self.fleet_file)]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
        if process.returncode != 0:
            raise SystemExit(f"farm {' '.join(arguments)}: {process.stderr}")

    def run(self) -> dict[str, object]:
        """Run the night, and return its figures."""
        start_s = time.monotonic()
        self.run_farm("up")
        try:
            while True:
                view = self._read_status()
                job = view.jobs[0]
                if job.state in ("done", "failed") or time.monotonic() - start_s > self.args.patience_s:
                    break
                self._cause_failures(view, job)
                self._operate(view, job)
                time.sleep(POLL_S)
            return self._compute_figures(job, time.monotonic() - start_s)
        finally:
            self._stop()

    def _read_status(self) -> api.Status:
        deadline_s = time.monotonic() + START_TIMEOUT_S
        while True:
            try:
                return self.client.fetch_status()
            except DaemonUnreachable as error:
                if time.monotonic() > deadline_s:
                    raise SystemExit(
                        f"the daemon has not answered for {START_TIMEOUT_S:.0f} s: {error}"
                    ) from error
                time.sleep(POLL_S)

    def _cause_failures(self, view: api.Status, job: api.JobView) -> None:
        """Cause failures, by the number of prints that have begun and by the progress of the job.

        A failure hits the next print that is in its first half, because another one might end before it
        fails.
        """
        started_count = sum(attempt.started is not None for part in job.parts for attempt in part.prints)
        for printer in view.printers:
            print_view = printer.print
            if print_view is None or print_view.state != PrintState.PRINTING or not print_view.layer:
                continue
            attempt_key = (printer.name, print_view.plate)
            if (
                print_view.progress > 0.5
                or printer.name == self.unplugged_printer
                or attempt_key in self.failed_plates
            ):
                continue
            if self.unplugged_printer is None and started_count >= self.unplug_number:
                self.unplugged_printer = printer.name
                self.failed_plates.add(attempt_key)
                control(self._find_emulator(printer.name), Command.UNPLUG)
            elif self.failure_numbers and started_count >= self.failure_numbers[0]:
                del self.failure_numbers[0]
                self.failed_plates.add(attempt_key)
                control(self._find_emulator(printer.name), Command.RESET)
        if (
            self.kill_count < len(self.kill_thresholds)
            and job.printed >= self.kill_thresholds[self.kill_count]
        ):
            self.kill_count += 1
            os.kill(view.daemon.pid, signal.SIGKILL)
            self.run_farm("up")

    def _operate(self, view: api.Status, job: api.JobView) -> None:
        """Clear printed beds and inspect failed printers, in attended hours.

        The bed of the unplugged printer is cleared too, so that its part gets a verdict.
        """
        is_away = AWAY_AFTER_S < (job.elapsed_s or 0.0) < self.back_after_s
        if is_away:
            return
        printers_to_clear = {printer.name for printer in view.printers if printer.bed != Bed.CLEAR}
        for item in view.todo:
            try:
                if item.code == "outage":
                    self.client.send_command("/outage/confirm")
                elif item.code in ("clear", "look", "connect"):
                    for name in (
                        item.printers
                        if item.code == "look"
                        else printers_to_clear.intersection(item.printers)
                    ):
                        self.client.clear_bed(name, api.ClearedRequest())
            except FarmError:
                pass  # the state changed meanwhile, which the next poll shows

    # -- the end ----------------------------------------------------------------------------------------

    def _compute_figures(self, job: api.JobView, wall_s: float) -> dict[str, object]:
        with Store(self.state.books) as store:
            books = store.load()
        good_plates = [p for p in books.plates.values() if books.find_plate_state(p) is PlateState.GOOD]
        printer_count = len(self.names) - (self.unplugged_printer is not None)
        rounds = -(-len(books.plates) // printer_count)
        return {
            "printers": len(self.names),
            "plates": len(books.plates),
            "done": len(good_plates),
            "lost": len(books.plates) - len(good_plates),
            "printed_twice": sum(count > 1 for count in self._count_completed_prints(books).values()),
            "failed": sum(p.state is PrintState.FAILED for p in books.prints.values()),
            "daemon_killed": self.kill_count,
            "unplugged": self.unplugged_printer,
            "makespan_s": round(job.elapsed_s or 0.0),
            "lower_bound_s": round(rounds * self.plate_s),
            "away_s": self.back_after_s - AWAY_AFTER_S,
            "starved": round(job.starved_share or 0.0, 4),
            "wall_s": round(wall_s, 1),
        }

    def _count_completed_prints(self, books: Books) -> Counter[str]:
        """Count the completed prints of each plate in the agents' journals; the script judges no part bad."""
        print_ids = set()
        for name in self.names:
            for line in (self._find_agent_folder(name) / JOURNAL).read_text().splitlines():
                print_record = json.loads(line).get("print")
                if print_record is not None and print_record["phase"] == PrintState.DONE:
                    print_ids.add(print_record["print_id"])
        return Counter(
            books.prints[print_id].plate if print_id in books.prints else "unknown" for print_id in print_ids
        )

    def _find_agent_folder(self, name: str) -> Path:
        return self.state.find_agent_folder(name)

    def _find_emulator(self, name: str) -> Path:
        return self._find_agent_folder(name) / "emulator"

    def _stop(self) -> None:
        command = [*self.command, "down", "--now", "--state", str(self.state.root)]
        if subprocess.run(command, capture_output=True, check=False).returncode != 0:
            for name in self.names:
                kill_agent(self._find_agent_folder(name))
        for name in self.names:
            if is_running(self._find_emulator(name)):
                try:
                    control(self._find_emulator(name), Command.POWER_OFF)
                except DriverError as error:
                    print(error, file=sys.stderr)


def make_parser(description: str | None) -> argparse.ArgumentParser:
    """Make the parser of the options of a night."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--printers", type=int, default=20)
    parser.add_argument("--plates", type=int, default=60)
    parser.add_argument("--moves", type=int, default=300, help="number of moves of a plate")
    parser.add_argument("--move-s", type=float, default=20.0, help="farm seconds per move")
    parser.add_argument("--away-h", type=float, default=5.5, help="farm hours without the operator")
    parser.add_argument("--scale", type=int, default=300, help="farm seconds per wall second")
    parser.add_argument("--failing", type=float, default=0.05, help="share of the prints that fail")
    parser.add_argument("--kills", type=int, default=2, help="number of times that the daemon is killed")
    parser.add_argument("--patience-s", type=float, default=900.0, help="limit of the wall-clock time in s")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--keep",
        type=Path,
        metavar="DIR",
        help="new folder in which the farm's books, logs and journals are kept",
    )
    parser.add_argument("--json", action="store_true")
    return parser


def parse_options(arguments: list[str] | None = None) -> argparse.Namespace:
    """Parse the options."""
    return make_parser(__doc__).parse_args(arguments)


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    args = parse_options()
    with tempfile.TemporaryDirectory(prefix="night-") as folder:
        if args.keep is not None:
            args.keep.mkdir(parents=True)
        figures = Night(args.keep or Path(folder), args).run()
    print(json.dumps(figures, indent=2) if args.json else "\n".join(f"{k}: {v}" for k, v in figures.items()))


if __name__ == "__main__":
    main()
