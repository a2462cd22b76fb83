"""Simulated printers, agents and a person that outlive a daemon, with a record of all prints."""

import shutil
from dataclasses import dataclass, field

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Commands, make_fleet
from farm.control.controller import Controller
from farm.errors import FarmError
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Bed,
    FilamentState,
    JobOptions,
    JobState,
    Link,
    PrintState,
    Verdict,
)
from farm.planning.plan import Plan
from farm.planning.printer_settings import list_bed_boxes
from farm.scheduling.admission import StartPlanning
from farm.state import events as ev
from farm.state.storage.store import Store
from hosts.manual_clock import ManualClock

STEP_S = 60.0
NEXT_STATES = {
    PrintState.ASSIGNED: PrintState.HEATING,
    PrintState.HEATING: PrintState.PRINTING,
    PrintState.PRINTING: PrintState.ENDING,
    PrintState.ENDING: PrintState.DONE,
}


class DaemonKilled(BaseException):
    """Simulated SIGKILL of the daemon."""


class KillingStore(Store):
    """A store that kills the daemon just before or just after given commits."""

    def __init__(self, path, simulation):
        super().__init__(path)
        self._db.execute("PRAGMA synchronous = OFF")  # a killed process loses no written data
        self._simulation = simulation

    def commit(self, event, old_books, new_books):
        self._simulation.commit_count += 1
        is_killed = self._simulation.commit_count in self._simulation.kills
        if is_killed and not self._simulation.is_killed_after:
            raise DaemonKilled
        super().commit(event, old_books, new_books)
        if is_killed:
            raise DaemonKilled


@dataclass
class Agent:
    """A printer and its agent, which keeps its only print until the daemon has recorded the end."""

    name: str
    print_id: str | None = None
    plate: str | None = None
    state: PrintState = PrintState.ASSIGNED
    started_s: float | None = None
    ended_s: float | None = None
    plate_on_bed: str | None = None
    sha256: str = ""
    journal: list = field(default_factory=list)  # reports of the prints that ended

    def make_report(self):
        return AgentPrint(
            print_id=self.print_id, state=self.state, fault=None, reason=None, progress_s=1.0,
            print_time_s=90.0, extruded=self.extruded, started_s=self.started_s, ended_s=self.ended_s,
            sha256=self.sha256,
        )  # fmt: skip

    def list_prints(self, since_s):
        """List the open print and the prints that ended after `since_s`."""
        ended_prints = [report for report in self.journal if report.ended_s >= since_s]
        return (
            ended_prints if self.print_id is None or self.state.ended else [*ended_prints, self.make_report()]
        )

    def make_snapshot(self):
        report = None if self.print_id is None else self.make_report()
        is_busy = report is not None and not self.state.ended
        link = Link.BUSY if is_busy else Link.READY
        is_clear = self.plate_on_bed is None
        return AgentSnapshot(
            printer=self.name, link=link, filament=FilamentState.PARKED, bed_clear=is_clear, print=report
        )

    @property
    def extruded(self):
        return self.state not in (PrintState.ASSIGNED, PrintState.HEATING) and self.plate_on_bed is not None


class FarmSimulation:
    """Simulation of a job on two printers, from its submission until a person has found all parts good.

    Parameters
    ----------
    kills
        Numbers of the commits, from 1, just before which the daemon is killed.
    is_killed_after
        Kill the daemon just after these commits instead.
    failing_prints
        Numbers of the prints that fail.
    bad_prints
        Numbers of the finished prints that a person finds bad.
    files
        Number of different G-code files of the plates.
    """

    def __init__(
        self,
        folder,
        plates=3,
        kills=(),
        is_killed_after=False,
        failing_prints=(1,),
        bad_prints=(0,),
        files=100,
    ):
        self.path = folder / "farm.db"
        self.kills, self.is_killed_after = frozenset(kills), is_killed_after
        self.failing_prints, self.bad_prints = failing_prints, bad_prints
        self.clock = ManualClock()
        self.agents = {name: Agent(name) for name in "ab"}
        self.commit_count = self.started_count = self.restart_count = 0
        self.completed_prints = []  # [plate, printer, verdict] of each completed print
        self.prints = {}  # print id -> (printer, start, end) of the simulated print
        self.plates, self.files = plates, files
        self.job_to_plan = None
        self.is_restored = False  # True after the books were replaced by a copy
        self.unreachable_agents = frozenset()  # names of agents that cannot reach the daemon
        self.restart_if_killed(self.start_daemon)

    # -- the daemon -------------------------------------------------------------------------------------

    def start_daemon(self):
        self.store = KillingStore(self.path, self)
        self.controller = Controller(make_fleet(), self.store, self.clock, list_bed_boxes)
        commands = Commands(self.controller)
        self.jobs, self.clear_bed = commands.jobs, commands.clear_bed
        self.controller.start(self, self.store.copied_s)

    def restore(self, copy):
        """Kill the daemon, and start the next one with a copy of its books."""
        self.store.close()
        for path in self.path.parent.glob(f"{self.path.name}*"):
            path.unlink()
        shutil.copy(copy, self.path)
        self.restart_count += 1
        self.job_to_plan = None
        self.is_restored = True
        self.restart_if_killed(self.start_daemon)

    def restart_if_killed(self, function):
        """Call a function of the daemon, and restart a killed daemon; return True if the call succeeded."""
        try:
            function()
        except DaemonKilled:
            self.store.close()
            self.restart_count += 1
            self.job_to_plan = None
            self.restart_if_killed(self.start_daemon)
            return False
        except FarmError:  # the books cannot be written, or the call is refused
            return False
        return True

    def perform(self, instruction, books):
        if isinstance(instruction, StartPlanning):
            self.job_to_plan = instruction.job
        agent = self.agents.get(getattr(instruction, "printer", None))
        if isinstance(instruction, ev.SendStart):
            if agent.print_id is None:
                assert agent.plate_on_bed is None, "a print is started on a full bed"
                agent.print_id, agent.state = instruction.print_id, PrintState.ASSIGNED
                agent.plate = books.prints[instruction.print_id].plate
                agent.sha256 = books.plates[agent.plate].sha256
                agent.started_s = agent.ended_s = None
        elif isinstance(instruction, ev.SendForget) and agent.print_id == instruction.print_id:
            assert agent.state.ended
            agent.print_id = None

    # -- printers and person ----------------------------------------------------------------------------

    def advance_prints(self):
        """Advance every print by a minute, with or without a daemon."""
        self.clock.now_s += STEP_S
        for agent in self.agents.values():
            if agent.print_id is None or agent.state.ended:
                continue
            agent.state = NEXT_STATES[agent.state]
            if agent.state is PrintState.HEATING:
                agent.started_s = self.clock.now_s
                agent.will_fail = self.started_count in self.failing_prints
                self.started_count += 1
            elif agent.state is PrintState.PRINTING:
                agent.plate_on_bed = agent.plate
            elif agent.state is PrintState.ENDING and agent.will_fail:
                agent.state = PrintState.FAILED
            if agent.state.ended:
                agent.ended_s = self.clock.now_s
                self.prints[agent.print_id] = (agent.name, agent.started_s, agent.ended_s)
                agent.journal.append(agent.make_report())
                if agent.state is PrintState.DONE:
                    self.completed_prints.append([agent.plate, agent.name, None])

    def report_to_daemon(self):
        for agent in self.agents.values():
            if agent.name not in self.unreachable_agents:
                self.restart_if_killed(lambda agent=agent: self.report_agent(agent))
        self.restart_if_killed(self.controller.handle)
        if self.job_to_plan is not None:
            job, self.job_to_plan = self.job_to_plan, None
            event = make_plan_event(1, self.plates)
            plates = tuple(
                plate.model_copy(update={"sha256": f"{i % self.files:064x}"})
                for i, plate in enumerate(event.plates)
            )
            plan = Plan(event.parts, plates, event.repairs, 1.0, 500.0)
            restart_count = self.restart_count
            if (
                not self.restart_if_killed(lambda: self.controller.on_plan(job, plan))
                and self.restart_count == restart_count
            ):
                self.job_to_plan = job  # as `JobPlanner` does if the disk is full

    def report_agent(self, agent):
        since_s = self.controller.find_unreported_since_s(agent.name)
        if since_s is not None:
            self.controller.on_journal(agent.make_snapshot(), agent.list_prints(since_s))
        self.controller.on_snapshot(agent.make_snapshot())

    def clear_and_judge(self):
        """Clear beds and judge their parts, as a person does; repeat interrupted commands."""
        for agent in self.agents.values():
            printer = self.controller.books.printers.get(agent.name)
            is_printing = agent.print_id is not None and not agent.state.ended
            if printer is None or printer.bed is Bed.CLEAR or is_printing:
                continue
            if agent.plate_on_bed is None and not self.is_restored:
                continue
            indices = [
                i
                for i, (_, name, verdict) in enumerate(self.completed_prints)
                if name == agent.name and not verdict
            ]
            verdict = Verdict.BAD if indices and indices[-1] in self.bad_prints else Verdict.GOOD
            if self.controller.books.find_print_to_judge(agent.name) is None:
                verdict = Verdict.GOOD
            agent_bed, agent.plate_on_bed = agent.plate_on_bed, None
            is_recorded = self.restart_if_killed(
                lambda name=agent.name, verdict=verdict: self.clear_bed(name, verdict=verdict)
            )
            if not is_recorded and self.controller.books.printers[agent.name].bed is not Bed.CLEAR:
                agent.plate_on_bed = agent_bed
                continue
            if indices:
                self.completed_prints[indices[-1]][2] = verdict

    def step(self):
        """Advance printers, person and daemon by one minute."""
        if not self.controller.books.jobs:
            self.restart_if_killed(lambda: self.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions()))
        self.report_to_daemon()
        self.clear_and_judge()
        self.advance_prints()

    def run(self, max_minutes=200):
        """Run until the job is done; return the number of minutes."""
        for minute in range(max_minutes):
            self.step()
            if self.controller.books.jobs and self.controller.books.jobs[1].state is JobState.DONE:
                return minute
        raise AssertionError(f"not done: {self.controller.books}")
