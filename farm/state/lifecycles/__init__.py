"""Lifecycles of jobs, plates, prints and printers as tables, and the error for an event that violates one."""

from farm.state.lifecycles.lifecycle import (
    NO_STATE,
    InvalidTransition,
    Lifecycle,
    PrinterState,
    State,
    Transition,
)
from farm.state.lifecycles.tables import (
    FARM_WIDE_EVENTS,
    JOB_LIFECYCLE,
    LIFECYCLES,
    PLATE_LIFECYCLE,
    PRINT_LIFECYCLE,
    PRINTER_LIFECYCLE,
    find_printer_state,
)

__all__ = [
    "FARM_WIDE_EVENTS",
    "JOB_LIFECYCLE",
    "LIFECYCLES",
    "NO_STATE",
    "PLATE_LIFECYCLE",
    "PRINTER_LIFECYCLE",
    "PRINT_LIFECYCLE",
    "InvalidTransition",
    "Lifecycle",
    "PrinterState",
    "State",
    "Transition",
    "find_printer_state",
]
