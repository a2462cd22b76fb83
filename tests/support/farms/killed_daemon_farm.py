"""Real farm whose daemon is killed and restarted repeatedly, and checks of its prints."""

import contextlib
import http.client
import itertools
import json
import re
import shutil
import subprocess
import sys
import time
from operator import attrgetter
from pathlib import Path
from urllib.parse import quote

from drivers.clock import Clock
from drivers.emulator.launch import Command, control
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from drivers.records import JOURNAL
from farm.cli.client import SocketConnection
from farm.model import Bed, PrintState
from farm.paths import StateFolder, read_anchor
from farm.state.storage.store import Store
from farms.real_farm import TIME_LIMIT_S, RealFarm, wait_for
from model_files.make_gcode import make_marlin, make_square

RESTART_SCRIPT = Path(__file__).with_name("restarted_daemon.py")
PRINTER_MODEL = "ultimaker2_plus"
PRIMED_MM = 7.8  # filament that each print feeds for priming, in addition to that of its plate
POLL_S = 0.05  # interval of the operator's polls


class KilledDaemonFarm(RealFarm):
    """Two simulated printers, jobs of one plate each, and a person who clears beds.

    If a `disk` (`SmallDisk`) is given, it holds the state folder, for the daemon and its children only.
    """

    def __init__(self, folder, disk=None):
        super().__init__(folder, dict.fromkeys(("one", "two"), (PRINTER_MODEL, f"sim://{PRINTER_MODEL}")))
        self.fleet.write_text(self.fleet.read_text().replace("time_scale: 150", "time_scale: 300"))
        self.gcode = folder / "plate.gcode"
        tower = make_square(side_mm=60.0, layers=8)
        self.gcode.write_text("\n".join([*make_marlin(tower), ""]).replace("F1800", "F240"))
        self.fed_mm = sum(move[3] for layer in tower for move in layer)
        self.supervisor = None
        self.job_count = 0
        self.disk, self.state_option = disk, self.state
        self.socket, self.log_file = folder / "farm.sock", folder / "daemon.log"
        if disk is not None:
            self.state = disk.visible_folder
            fleet_options = "uploads: {free_gb: 0}, time_scale: 300"
            self.fleet.write_text(self.fleet.read_text().replace("time_scale: 300", fleet_options))

    def start_daemons(self, deaths):
        """Start daemons that die at the moments in `deaths`; the last one survives."""
        self.kill_daemons()
        self.state.mkdir(exist_ok=True)
        command = [sys.executable, "-P", RESTART_SCRIPT, json.dumps(deaths), *self.list_daemon_arguments()]
        if self.disk is not None:
            command = self.disk.make_command(command)
        with self.log_file.open("ab") as log:
            self.supervisor = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def list_daemon_arguments(self):
        """Return the arguments with which `farm` runs the daemon."""
        return ["daemon", "--state", self.state_option, "--socket", self.socket, "--fleet", self.fleet]

    def kill_daemons(self):
        """Kill the daemon permanently."""
        if self.supervisor is not None:
            self.supervisor.terminate()
            self.supervisor.wait()

    def list_deaths(self):
        """List the moments at which daemons died, in order."""
        return re.findall(r"^dies (.*)$", self.log_file.read_text(), re.MULTILINE)

    def read_log(self):
        return self.log_file.read_text()[-4000:]

    def read_clock(self):
        """Return the farm's clock."""
        return Clock(*read_anchor(StateFolder(self.state).clock))

    def try_request(self, method, path, body=None):
        """Send a request; return status and answer, or None if the daemon died first or is not running."""
        assert self.supervisor.poll() is None, self.read_log()
        with contextlib.closing(SocketConnection(self.socket, TIME_LIMIT_S, TIME_LIMIT_S)) as connection:
            try:
                connection.request(method, path, body, {"Content-Type": "application/json"})
                answer = connection.getresponse()
                return answer.status, json.loads(answer.read())
            except (OSError, http.client.HTTPException):
                return None

    def request(self, method, path, body=None):
        """Repeat a request until a daemon answers; return the answer."""
        status, answer = self.request_any(method, path, body)
        assert status == 200, answer
        return answer

    def request_any(self, method, path, body=None):
        """Repeat a request until a daemon answers with any status; return status and body."""
        return wait_for("an answer", lambda: self.try_request(method, path, body))

    def submit(self, count, **options):
        """Submit a number of jobs."""
        for number in range(self.job_count, self.job_count + count):
            self.request("POST", *self.make_submission(number, **options))
        self.job_count += count

    def make_submission(self, number, **options):
        """Return the path and the body of a submission."""
        content, options_text = self.gcode.read_bytes(), quote(json.dumps(options))
        query = f"request_id=request-{number}&name=plate.gcode&size={len(content)}&options={options_text}"
        return f"/jobs?{query}", content

    def approve(self):
        """Approve all held jobs."""
        for job in self.request("GET", "/status")["jobs"]:
            self.request("POST", f"/jobs/{job['id']}/approve", json.dumps({"plan": job["plan"]}))

    def judge_prints_good(self, failing_prints=()):
        """Judge all printed parts good until every job is done; make the prints with these numbers fail."""
        started_prints = []
        deadline_s = time.monotonic() + TIME_LIMIT_S
        while True:
            status = self.request("GET", "/status")
            if {job["state"] for job in status["jobs"]} == {"done"}:  # the status omits old jobs
                return
            assert time.monotonic() < deadline_s, (status, self.read_log())
            for printer in status["printers"]:
                key = printer["print"] and (printer["name"], printer["print"]["plate"])
                if key and printer["print"]["layer"] and key not in started_prints:
                    if len(started_prints) in failing_prints:
                        control(self.get_emulator_folder(printer["name"]), Command.RESET)
                    started_prints.append(key)
            self.clear_beds(status)
            time.sleep(POLL_S)

    def clear_beds(self, status):
        """Clear all beds that are full or need an inspection according to `status`."""
        for item in status["todo"]:
            for name in item["printers"] if item["code"] in ("clear", "look") else ():
                # If the daemon dies or the state changes meanwhile, the next poll shows it.
                self.try_request("POST", f"/printers/{name}/cleared", "{}")

    def end(self):
        self.kill_daemons()
        super().end()

    # -- results ----------------------------------------------------------------------------------------

    def read_journals(self):
        """Return the printer and the last journal record of each print, by print id."""
        results = {}
        for name in self.printers:
            for line in (self.state / "agents" / name / JOURNAL).read_text().splitlines():
                record_print = json.loads(line).get("print")
                if record_print is not None:
                    results[record_print["print_id"]] = (name, record_print)
        return results

    def read_books(self):
        """Return the books of a killed daemon, read from a copy."""
        copy = self.folder / "books"
        copy.mkdir()
        for end in ("", "-wal"):
            shutil.copy(self.state / f"farm.db{end}", copy)
        with Store(copy / "farm.db") as store:
            return store.load()

    def check(self):
        """Assert that no plate is lost or printed twice, and that all times match the agents' records."""
        self.kill_daemons()
        books = self.read_books()
        assert len(books.jobs) == self.job_count
        started_prints = [p for p in books.prints.values() if p.started_s is not None]
        prints_by_id = {p.id: (p.printer, p.state, p.started_s, p.ended_s) for p in started_prints}
        journals = {
            name: (printer, record_print["phase"], record_print["started_s"], record_print["ended_s"])
            for name, (printer, record_print) in self.read_journals().items()
        }
        assert prints_by_id == journals
        done_prints = [p for p in started_prints if p.state is PrintState.DONE]
        assert sorted(p.plate for p in done_prints) == sorted(books.plates)
        for key in (attrgetter("plate"), attrgetter("printer")):  # prints must not overlap
            prints_by_time = sorted(started_prints, key=attrgetter("started_s"))
            for _, prints in itertools.groupby(sorted(prints_by_time, key=key), key):
                assert all(
                    record.ended_s <= next_record.started_s
                    for record, next_record in itertools.pairwise(prints)
                )
        assert {p.bed for p in books.printers.values()} == {Bed.CLEAR}
        # The printers fed the filament of every plate once, and at most the same length for each failed
        # print. If a board was reset during its last print, the filament is still at the nozzle.
        fed_per_print_mm = PRIMED_MM + self.fed_mm
        statuses = [self.read_emulator_status(name) for name in self.printers]
        fed_mm = sum(
            record.filament_mm - (record.filament_end_mm + ULTIMAKER2_PLUS.park_retraction_mm)
            for record in statuses
        )
        assert (
            len(done_prints) * fed_per_print_mm - 1.0 < fed_mm < len(started_prints) * fed_per_print_mm + 1.0
        ), (
            fed_mm,
            statuses,
        )
