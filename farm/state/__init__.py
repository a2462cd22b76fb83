"""State of the farm: the books, the events that change them, and the consequences of events. Pure.

`events` defines the events, `transitions` applies those that the tables in `lifecycles` allow, and `storage`
keeps the books on disk.
"""

from farm.state.books import Books, put, replace_fields
from farm.state.faults import FAULTS_BY_PEOPLE, LOSSES, FarmFault
from farm.state.outage import compute_outage_window_s
from farm.state.plate_state import PlateState, find_stopped_print
from farm.state.reconciliation import (
    detect_alarm,
    handle_unknown_print,
    import_agent_journal,
    list_pending_instructions,
    make_refused_print_end,
    reconcile_idle_printer,
    reconcile_print,
)
from farm.state.reels import apply_reel, apply_reels
from farm.state.salvaged_parts import (
    find_failed_print,
    find_part_id,
    find_possibly_complete_print,
    list_reprinting_printers,
)
from farm.state.validation import validate_books

__all__ = [
    "FAULTS_BY_PEOPLE",
    "LOSSES",
    "Books",
    "FarmFault",
    "PlateState",
    "apply_reel",
    "apply_reels",
    "compute_outage_window_s",
    "detect_alarm",
    "find_failed_print",
    "find_part_id",
    "find_possibly_complete_print",
    "find_stopped_print",
    "handle_unknown_print",
    "import_agent_journal",
    "list_pending_instructions",
    "list_reprinting_printers",
    "make_refused_print_end",
    "put",
    "reconcile_idle_printer",
    "reconcile_print",
    "replace_fields",
    "validate_books",
]
