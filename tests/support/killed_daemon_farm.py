"""Real farm whose daemon is killed and restarted again and again, with checks of its prints."""

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
from make_gcode import marlin, square
from real_farm import PATIENCE_S, RealFarm, wait_for

KEPT = Path(__file__).with_name("restarted_daemon.py")
MODEL = "ultimaker2_plus"
PRIMED_MM = 7.8  # filament of every print beside its plate's own, from parked to parked
LOOK_S = 0.05  # between two looks of the operator


class KilledFarm(RealFarm):
    """Two simulated printers, jobs of one plate each, and a person who clears beds.

    With a `disk` (`SmallDisk`) its state folder is on that: only the daemon and what it starts have it there.
    """

    def __init__(self, folder, disk=None):
        super().__init__(folder, dict.fromkeys(("one", "two"), (MODEL, f"sim://{MODEL}")))
        self.fleet.write_text(self.fleet.read_text().replace("time_scale: 150", "time_scale: 300"))
        self.gcode = folder / "plate.gcode"
        tower = square(side_mm=60.0, layers=8)
        self.gcode.write_text("\n".join([*marlin(tower), ""]).replace("F1800", "F240"))
        self.fed_mm = sum(move[3] for layer in tower for move in layer)
        self.keeper = None
        self.submitted = 0
        self.disk, self.state_option = disk, self.state
        self.socket, self.log_file = folder / "farm.sock", folder / "daemon.log"
        if disk is not None:
            self.state = disk.seen
            full_disk = "uploads: {free_gb: 0}, time_scale: 300"
            self.fleet.write_text(self.fleet.read_text().replace("time_scale: 300", full_disk))

    def keep(self, fates):
        """Start daemons that die by these fates; the last one survives."""
        self.stop_keeping()
        self.state.mkdir(exist_ok=True)
        command = [sys.executable, "-P", KEPT, json.dumps(fates), *self.daemon()]
        if self.disk is not None:
            command = self.disk.command(command)
        with self.log_file.open("ab") as log:
            self.keeper = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def daemon(self):
        """Return the arguments of `farm` that run its daemon."""
        return ["daemon", "--state", self.state_option, "--socket", self.socket, "--fleet", self.fleet]

    def stop_keeping(self):
        """Kill the daemon permanently."""
        if self.keeper is not None:
            self.keeper.terminate()
            self.keeper.wait()

    def deaths(self):
        """List the moments at which daemons died, in order."""
        return re.findall(r"^dies (.*)$", self.log_file.read_text(), re.MULTILINE)

    def log(self):
        return self.log_file.read_text()[-4000:]

    def clock(self):
        """Return the farm's clock."""
        return Clock(*read_anchor(StateFolder(self.state).clock))

    def ask(self, method, path, body=None):
        """One daemon's answer and its status; None if it died before it answered, or is not there."""
        assert self.keeper.poll() is None, self.log()
        with contextlib.closing(SocketConnection(self.socket, PATIENCE_S, PATIENCE_S)) as connection:
            try:
                connection.request(method, path, body, {"Content-Type": "application/json"})
                answer = connection.getresponse()
                return answer.status, json.loads(answer.read())
            except (OSError, http.client.HTTPException):
                return None

    def ask_until_answered(self, method, path, body=None):
        """Return the answer of the first daemon that lives long enough to give it."""
        status, answer = self.answer(method, path, body)
        assert status == 200, answer
        return answer

    def answer(self, method, path, body=None):
        """Return the status and the body of any answer."""
        return wait_for("an answer", lambda: self.ask(method, path, body))

    def submit(self, count, **options):
        """Submit a number of jobs."""
        for number in range(self.submitted, self.submitted + count):
            self.ask_until_answered("POST", *self.submission(number, **options))
        self.submitted += count

    def submission(self, number, **options):
        """Return the path and the body of a submission."""
        text, options_text = self.gcode.read_bytes(), quote(json.dumps(options))
        query = f"request_id=request-{number}&name=plate.gcode&size={len(text)}&options={options_text}"
        return f"/jobs?{query}", text

    def approve(self):
        """Approve all held jobs."""
        for job in self.ask_until_answered("GET", "/status")["jobs"]:
            self.ask_until_answered("POST", f"/jobs/{job['id']}/approve", json.dumps({"plan": job["plan"]}))

    def find_good(self, failing=()):
        """Find all printed jobs good; `failing` are the numbers of the prints that fail."""
        started = []
        give_up = time.monotonic() + PATIENCE_S
        while True:
            view = self.ask_until_answered("GET", "/status")
            if {job["state"] for job in view["jobs"]} == {"done"}:  # what has ended long ago is not shown
                return
            assert time.monotonic() < give_up, (view, self.log())
            for printer in view["printers"]:
                key = printer["print"] and (printer["name"], printer["print"]["plate"])
                if key and printer["print"]["layer"] and key not in started:
                    if len(started) in failing:
                        control(self.emulator(printer["name"]), Command.RESET)
                    started.append(key)
            self.clear_beds(view)
            time.sleep(LOOK_S)

    def clear_beds(self, view):
        """Clear all beds that `view` shows as full or in need of an inspection."""
        for item in view["todo"]:
            for name in item["printers"] if item["code"] in ("clear", "look") else ():
                # Where it dies meanwhile, or things have changed, the next look shows it.
                self.ask("POST", f"/printers/{name}/cleared", "{}")

    def end(self):
        self.stop_keeping()
        super().end()

    # -- what became of it ------------------------------------------------------------------------------

    def journals(self):
        """Return the printer and the last journal record of each print, by print id."""
        results = {}
        for name in self.printers:
            for line in (self.state / "agents" / name / JOURNAL).read_text().splitlines():
                message = json.loads(line).get("print")
                if message is not None:
                    results[message["print_id"]] = (name, message)
        return results

    def books(self):
        """Read a copy of the books that a killed daemon left."""
        copy = self.folder / "books"
        copy.mkdir()
        for end in ("", "-wal"):
            shutil.copy(self.state / f"farm.db{end}", copy)
        with Store(copy / "farm.db") as store:
            return store.load()

    def check(self):
        """Assert that no plate is lost or printed twice, and that all times match the agents' records."""
        self.stop_keeping()
        books = self.books()
        assert len(books.jobs) == self.submitted
        started = [p for p in books.prints.values() if p.started_s is not None]
        booked = {p.id: (p.printer, p.state, p.started_s, p.ended_s) for p in started}
        journals = {
            name: (printer, message["phase"], message["started_s"], message["ended_s"])
            for name, (printer, message) in self.journals().items()
        }
        assert booked == journals
        done = [p for p in started if p.state is PrintState.DONE]
        assert sorted(p.plate for p in done) == sorted(books.plates)
        for key in (attrgetter("plate"), attrgetter("printer")):  # one after the other
            in_turn = sorted(started, key=attrgetter("started_s"))
            for _, prints in itertools.groupby(sorted(in_turn, key=key), key):
                assert all(
                    record.ended_s <= following.started_s for record, following in itertools.pairwise(prints)
                )
        assert {p.bed for p in books.printers.values()} == {Bed.CLEAR}
        # What the printers themselves fed: every plate once, and of a failed print no more than a plate. A
        # board that was reset in its last print has its filament at the nozzle yet.
        each_mm = PRIMED_MM + self.fed_mm
        observed = [self.emulator_status(name) for name in self.printers]
        fed_mm = sum(
            record.filament_mm - (record.filament_end_mm + ULTIMAKER2_PLUS.parked_mm) for record in observed
        )
        assert len(done) * each_mm - 1.0 < fed_mm < len(started) * each_mm + 1.0, (fed_mm, observed)
