"""Records of the farm: jobs, parts, plates, prints, printers, and the snapshots of agents.

Everything here is frozen. Times are seconds since the epoch on the farm's clock (`drivers.clock`), spans are
seconds, lengths millimetres, temperatures degrees Celsius.
"""

from farm.model.agent import AgentPrint, AgentSnapshot, Link
from farm.model.entity import FORMER_NAMES, Entity, share_field_set
from farm.model.hold import Hold, HoldCode, ShortReel, TextTime
from farm.model.job import (
    Gluing,
    Job,
    JobOptions,
    JobState,
    ModelSize,
    OwnGcode,
    PlanProgress,
    PlanStep,
    Reopening,
    compute_assembly_ratio,
)
from farm.model.key import Key, KeyKind, Role
from farm.model.plate import DEFAULT_PRINT_OPTIONS, Part, PartGeometry, PartPrintOptions, Plate
from farm.model.print import Moment, Print, PrintState, Still, Verdict
from farm.model.printer import Bed, FilamentState, HostLoss, Outage, Printer, Reel, Temperatures

__all__ = [
    "DEFAULT_PRINT_OPTIONS",
    "FORMER_NAMES",
    "AgentPrint",
    "AgentSnapshot",
    "Bed",
    "Entity",
    "FilamentState",
    "Gluing",
    "Hold",
    "HoldCode",
    "HostLoss",
    "Job",
    "JobOptions",
    "JobState",
    "Key",
    "KeyKind",
    "Link",
    "ModelSize",
    "Moment",
    "Outage",
    "OwnGcode",
    "Part",
    "PartGeometry",
    "PartPrintOptions",
    "PlanProgress",
    "PlanStep",
    "Plate",
    "Print",
    "PrintState",
    "Printer",
    "Reel",
    "Reopening",
    "Role",
    "ShortReel",
    "Still",
    "Temperatures",
    "TextTime",
    "Verdict",
    "compute_assembly_ratio",
    "share_field_set",
]
