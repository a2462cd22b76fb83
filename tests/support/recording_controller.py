"""A core with hands that only write down what they are told."""

from drivers.clock import Clock
from farm.config import Fleet
from farm.control.controller import Core
from farm.control.print_commands import Desk
from farm.model import AgentSnapshot, FilamentState, Link
from farm.planning.parts.part_rooms import bed_boxes
from farm.planning.plan import InspectedSubmission
from farm.state.storage.store import Store

MODEL = InspectedSubmission("m.npz", ("closed 3 holes",), 1000.0)


class Hands:
    def __init__(self):
        self.told = []
        self.plans = []
        self.replans = []

    def perform(self, instruction):
        self.told.append(instruction)

    def plan(self, job, printers, rounds):
        self.plans.append((job.id, [p.name for p in printers], rounds))

    def replan(self, plate, printers, cut):
        self.replans.append((plate.id, [p.name for p in printers], cut))


PLUS = "ultimaker2_plus"


def fleet(models=(PLUS, PLUS), **house):
    """Printers a, b, ... of these models."""
    names = zip("abcdefgh", models, strict=False)
    printers = [{"name": name, "model": model, "port": f"sim://{model}"} for name, model in names]
    return Fleet.model_validate({"fleet": house, "printers": printers})


class Farm:
    """A core on a store in a folder; made again, it is a daemon that was killed and started again."""

    def __init__(self, folder, models=(PLUS, PLUS), clock=None, **house):
        self.hands = Hands()
        folder.mkdir(exist_ok=True)
        self.store = Store(folder / "farm.db")
        self.core = Core(fleet(models, **house), self.store, clock or Clock(), bed_boxes, self.hands)
        self.desk = Desk(self.core)
        self.core.start()

    def ready(self, *names, **changes):
        facts = {"link": Link.READY, "agent_pid": 9, "filament": FilamentState.PARKED, "bed_clear": True}
        for name in names:
            self.core.heard(AgentSnapshot(printer=name, **{**facts, **changes}))

    def tell(self, name, *prints):
        """An agent says what it printed since the books were copied, and how things are."""
        facts = {"link": Link.READY, "agent_pid": 9, "filament": FilamentState.PARKED}
        said = AgentSnapshot(printer=name, print=prints[-1] if prints else None, **facts)
        self.core.recounted(said, prints)
        self.core.heard(said)
