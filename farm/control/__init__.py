"""Control of the farm: the controller, commands of people, effects, timers and notices."""

from farm.control.access import (
    LINK_LIFETIME_S,
    MAX_SESSION_S,
    AppKeyRequests,
    KeyCommands,
    SessionCommands,
    find_key,
)
from farm.control.controller import Controller
from farm.control.effects import FarmEffectPerformer
from farm.control.job_commands import (
    PAGE_DRY_RUN_TIMEOUT_S,
    DryRuns,
    JobCommands,
    abort_prints,
    find_successor,
)
from farm.control.notifier import Notifier, delete_record
from farm.control.part_commands import PartCommands
from farm.control.printer_commands import PrinterCommands
from farm.control.timers import Timers

__all__ = [
    "LINK_LIFETIME_S",
    "MAX_SESSION_S",
    "PAGE_DRY_RUN_TIMEOUT_S",
    "AppKeyRequests",
    "Controller",
    "DryRuns",
    "FarmEffectPerformer",
    "JobCommands",
    "KeyCommands",
    "Notifier",
    "PartCommands",
    "PrinterCommands",
    "SessionCommands",
    "Timers",
    "abort_prints",
    "delete_record",
    "find_key",
    "find_successor",
]
