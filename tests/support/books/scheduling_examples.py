"""Example printers, plates and situations for the scheduler."""

from zoneinfo import ZoneInfo

from farm.model import Bed, FilamentState, Link
from farm.scheduling.hours import Hours
from farm.scheduling.matching import Capabilities, FleetPrinter, Requirements, WaitingPlate
from farm.scheduling.plate_queue import PlateQueue
from farm.scheduling.situation import Situation
from farm.scheduling.start_rules import StartRules
from farm.week_windows import parse_window

LOW_BOXES = ((-111.0, -104.0, 111.0, 102.0, 205.0),)
TALL_BOXES = ((-111.0, -104.0, 111.0, 102.0, 305.0),)
UTC = ZoneInfo("UTC")


def make_hours(*texts):
    return Hours(tuple(map(parse_window, texts)), UTC)


def make_rules(attended=(), quiet=(), **changes):
    return StartRules(make_hours(*attended), make_hours(*quiet), **changes)


def make_printer(name, boxes=LOW_BOXES, material="generic_pla", colour=None, nozzle_mm=0.4, **changes):
    facts = {
        "bed": Bed.CLEAR,
        "filament": FilamentState.PARKED,
        "link": Link.READY,
        "is_booked": False,
        "attention_reason": None,
    }
    return FleetPrinter(
        name=name, capabilities=Capabilities(boxes, material, colour, nozzle_mm), **{**facts, **changes}
    )


def make_box(height_mm, half_width_mm=50.0):
    return (-half_width_mm, -half_width_mm, half_width_mm, half_width_mm, height_mm)


def make_plate(name, planned_printer, **changes):
    facts = {
        "requirements": Requirements("generic_pla", None, 0.4, make_box(100.0)),
        "job": 1,
        "expected_s": 3600.0,
        "failed_on": frozenset(),
    }
    return WaitingPlate(id=name, planned_printer=planned_printer, **{**facts, **changes})


def make_situation(plates, fleet, start_rules=None, now_s=0.0, spares=0, **changes):
    spares_by_printer = {0: spares} if spares else {}
    return Situation(
        PlateQueue.from_plates(plates),
        tuple(fleet),
        start_rules or make_rules(),
        now_s,
        spares=spares_by_printer,
        **changes,
    )
