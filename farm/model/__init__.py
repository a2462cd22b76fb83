"""Records of the farm: jobs, parts, plates, prints, printers, and the snapshots of agents.

All records are frozen. Times are in seconds since the epoch on the farm's clock (`drivers.clock`), durations
in seconds, lengths in millimetres, and temperatures in degrees Celsius.
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
from farm.model.plate import (
    DEFAULT_PRINT_OPTIONS,
    NOMINAL_TIME_FACTORS,
    FeatureFactors,
    FeatureSeconds,
    Part,
    PartGeometry,
    PartPrintOptions,
    Plate,
    Shares,
    TimeFactors,
    name_plate,
)
from farm.model.print import Moment, Print, PrintState, Still, Verdict
from farm.model.printer import (
    Bed,
    FilamentState,
    HostLoss,
    Outage,
    Printer,
    Reel,
    Temperatures,
)

__all__ = [
    "DEFAULT_PRINT_OPTIONS",
    "FORMER_NAMES",
    "NOMINAL_TIME_FACTORS",
    "AgentPrint",
    "AgentSnapshot",
    "Bed",
    "Entity",
    "FeatureFactors",
    "FeatureSeconds",
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
    "Shares",
    "ShortReel",
    "Still",
    "Temperatures",
    "TextTime",
    "TimeFactors",
    "Verdict",
    "compute_assembly_ratio",
    "name_plate",
    "share_field_set",
]
