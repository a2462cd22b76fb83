"""A core with hands that only write down what they are told."""

from drivers.clock import Clock
from farm.config import Fleet
from farm.daemon.core import Core
from farm.daemon.desk import Desk
from farm.model import AgentSnapshot, FilamentState, Link
from farm.services.models import Inspected
from farm.services.rooms import bed_boxes
from farm.tracking.store import Store

MODEL = Inspected("m.npz", ("closed 3 holes",), 1000.0)


class Hands:
    def __init__(self):
        self.told = []
        self.plans = []

    def perform(self, instruction):
        self.told.append(instruction)

    def plan(self, job, printers, rounds):
        self.plans.append((job.id, [p.name for p in printers], rounds))


def fleet(**house):
    printers = [{"name": n, "model": "ultimaker2_plus", "port": "sim://ultimaker2_plus"} for n in ("a", "b")]
    return Fleet.model_validate({"fleet": house, "printers": printers})


class Farm:
    """A core on a store in a folder; made again, it is a daemon that was killed and started again."""

    def __init__(self, folder, **house):
        self.hands = Hands()
        folder.mkdir(exist_ok=True)
        self.store = Store(folder / "farm.db")
        self.core = Core(fleet(**house), self.store, Clock(), bed_boxes, self.hands)
        self.desk = Desk(self.core)
        self.core.start()

    def ready(self, *names, **changes):
        facts = {"link": Link.READY, "agent_pid": 9, "filament": FilamentState.PARKED, "bed_clear": True}
        for name in names:
            self.core.heard(AgentSnapshot(printer=name, **{**facts, **changes}))
