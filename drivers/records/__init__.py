"""Files in an agent's folder: its journal and its start file."""

from drivers.records.journal import ESTOPPED, JOURNAL, Journal, read_journal
from drivers.records.journal_state import Alarm, BoardState, JournalState, Suspicion
from drivers.records.start_file import StartFile

__all__ = [
    "ESTOPPED",
    "JOURNAL",
    "Alarm",
    "BoardState",
    "Journal",
    "JournalState",
    "StartFile",
    "Suspicion",
    "read_journal",
]
