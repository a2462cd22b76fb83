"""Files in an agent's folder: its journal, its start file and its log."""

from drivers.records.journal import ESTOP_REASON, JOURNAL, Journal, read_journal
from drivers.records.journal_state import Alarm, BoardState, JournalState, Suspicion
from drivers.records.start_file import AGENT_LOG, StartFile

__all__ = [
    "AGENT_LOG",
    "ESTOP_REASON",
    "JOURNAL",
    "Alarm",
    "BoardState",
    "Journal",
    "JournalState",
    "StartFile",
    "Suspicion",
    "read_journal",
]
