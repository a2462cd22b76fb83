"""Controller whose effects are recorded instead of executed."""

from drivers.clock import Clock
from farm.api import ClearedRequest
from farm.config import Fleet
from farm.control.controller import Controller
from farm.control.job_commands import JobCommands
from farm.control.part_commands import PartCommands
from farm.control.printer_commands import PrinterCommands
from farm.model import AgentSnapshot, FilamentState, Link, Verdict
from farm.planning.plan import InspectedSubmission
from farm.planning.printer_settings import list_bed_boxes
from farm.planning.replanning.coordinator import StartReplan
from farm.scheduling.admission import StartPlanning
from farm.state.storage.store import Store

INSPECTED_MODEL = InspectedSubmission("m.npz", ("closed 3 holes",), 1000.0)


class RecordedEffects:
    """Recorder of instructions to agents, plans and replans."""

    def __init__(self):
        self.instructions = []
        self.plans = []
        self.replans = []

    def perform(self, effect, books):
        if isinstance(effect, StartPlanning):
            self.plans.append((effect.job, list(effect.printers), effect.round_count))
        elif isinstance(effect, StartReplan):
            self.replans.append((effect.plate, list(effect.printers), effect.is_cut))
        else:
            self.instructions.append(effect)


PLUS_MODEL = "ultimaker2_plus"


def make_fleet(models=(PLUS_MODEL, PLUS_MODEL), **fleet_options):
    """Make printers a, b, ... of these models."""
    names = zip("abcdefgh", models, strict=False)
    printers = [{"name": name, "model": model, "port": f"sim://{model}"} for name, model in names]
    return Fleet.model_validate({"fleet": fleet_options, "printers": printers})


class Commands:
    """Commands of people to a controller."""

    def __init__(self, controller):
        self.printers = PrinterCommands(controller)
        self.parts = PartCommands(controller, self.printers)
        self.jobs = JobCommands(controller, self.printers)

    def clear_bed(self, printer, filament=None, verdict=Verdict.GOOD, reason=None, good=None, seen=None):
        is_bad = verdict is Verdict.BAD
        request = ClearedRequest(filament=filament, bad=is_bad, why=reason, good=good, seen=seen)
        return self.printers.clear_bed(printer, request, "ann")


class Farm(Commands):
    """A controller on a store in a folder; a second one on the same folder acts as a restarted daemon."""

    def __init__(self, folder, models=(PLUS_MODEL, PLUS_MODEL), clock=None, **fleet_options):
        self.effects = RecordedEffects()
        folder.mkdir(exist_ok=True)
        self.store = Store(folder / "farm.db")
        self.controller = Controller(
            make_fleet(models, **fleet_options), self.store, clock or Clock(), list_bed_boxes
        )
        super().__init__(self.controller)
        self.controller.start(self.effects)

    def report_ready(self, *names, **changes):
        facts = {"link": Link.READY, "agent_pid": 9, "filament": FilamentState.PARKED, "bed_clear": True}
        for name in names:
            self.controller.on_snapshot(AgentSnapshot(printer=name, **{**facts, **changes}))

    def build_view_context(self, state):
        return self.controller.build_view_context(state)

    def report(self, name, *prints):
        """Report the state of an agent, and the prints that restored books may lack."""
        facts = {"link": Link.READY, "agent_pid": 9, "filament": FilamentState.PARKED}
        snapshot = AgentSnapshot(printer=name, print=prints[-1] if prints else None, **facts)
        self.controller.on_journal(snapshot, prints)
        self.controller.on_snapshot(snapshot)
