"""Scheduling: assignment of plates, reasons for waiting, admission of jobs, and the forecast. Pure.

Every decision is a function of one `Situation`.
"""

from farm.scheduling.admission import (
    SPARE_PURPOSE,
    Availability,
    HoldJob,
    JobAdmission,
    JobRequest,
    StartPlanning,
    limit_availability,
    list_pending_printers,
    list_reservations,
    list_usable_printers,
)
from farm.scheduling.assignment import (
    LARGE_FLEET_SIZE,
    MAX_STARTS,
    Assignment,
    assign_plates,
    find_holds,
    select_possible_assignments,
)
from farm.scheduling.forecast import Forecast, Slot, compute_printing_s, forecast_prints, make_idle_printer
from farm.scheduling.forecast_cache import ForecastCache
from farm.scheduling.holds import find_held_back_plates, find_next_change_s, join_names
from farm.scheduling.hours import Hours, parse_moment_s
from farm.scheduling.matching import (
    Capabilities,
    Demand,
    FleetPrinter,
    Requirements,
    WaitingPlate,
    may_take_spare,
)
from farm.scheduling.plate_queue import JobPlates, PlateQueue
from farm.scheduling.situation import Situation
from farm.scheduling.situation_builder import (
    BuildVolumeFinder,
    PrintLimits,
    SituationBuilder,
    count_spares,
    derive_job_requirements,
    derive_plate_requirements,
    describe_capabilities,
    describe_plates,
    estimate_remaining_s,
    find_print_limits,
    may_start_now,
    select_scheduling_fields,
    update_print_ends,
)
from farm.scheduling.start_rules import StartRules, find_filament_shortage

__all__ = [
    "LARGE_FLEET_SIZE",
    "MAX_STARTS",
    "SPARE_PURPOSE",
    "Assignment",
    "Availability",
    "BuildVolumeFinder",
    "Capabilities",
    "Demand",
    "FleetPrinter",
    "Forecast",
    "ForecastCache",
    "HoldJob",
    "Hours",
    "JobAdmission",
    "JobPlates",
    "JobRequest",
    "PlateQueue",
    "PrintLimits",
    "Requirements",
    "Situation",
    "SituationBuilder",
    "Slot",
    "StartPlanning",
    "StartRules",
    "WaitingPlate",
    "assign_plates",
    "compute_printing_s",
    "count_spares",
    "derive_job_requirements",
    "derive_plate_requirements",
    "describe_capabilities",
    "describe_plates",
    "estimate_remaining_s",
    "find_filament_shortage",
    "find_held_back_plates",
    "find_holds",
    "find_next_change_s",
    "find_print_limits",
    "forecast_prints",
    "join_names",
    "limit_availability",
    "list_pending_printers",
    "list_reservations",
    "list_usable_printers",
    "make_idle_printer",
    "may_start_now",
    "may_take_spare",
    "parse_moment_s",
    "select_possible_assignments",
    "select_scheduling_fields",
    "update_print_ends",
]
