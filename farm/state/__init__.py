"""State of the farm: the books, the events that change them, and their consequences. Pure.

`events` defines the events, `transitions` applies them as the tables in `lifecycles` allow, `storage` keeps
the books on disk.
"""

from farm.state.books import Books, put, replace_fields
from farm.state.faults import BY_PEOPLE, LOSSES, OwnFault
from farm.state.outage import outage_window_s
from farm.state.plate_state import PlateState, stopped_print
from farm.state.reconciliation import (
    detect_alarm,
    handle_unknown_print,
    import_agent_journal,
    observe_idle_printer,
    pending_instructions,
    reconcile_print,
    refused_print_end,
)
from farm.state.reels import fleet_with_reels, section_with_reel
from farm.state.salvaged_parts import failed_print_on, part_name, possibly_whole_print, reprinting_printers
from farm.state.validation import validate_books

__all__ = [
    "BY_PEOPLE",
    "LOSSES",
    "Books",
    "OwnFault",
    "PlateState",
    "detect_alarm",
    "failed_print_on",
    "fleet_with_reels",
    "handle_unknown_print",
    "import_agent_journal",
    "observe_idle_printer",
    "outage_window_s",
    "part_name",
    "pending_instructions",
    "possibly_whole_print",
    "put",
    "reconcile_print",
    "refused_print_end",
    "replace_fields",
    "reprinting_printers",
    "section_with_reel",
    "stopped_print",
    "validate_books",
]
