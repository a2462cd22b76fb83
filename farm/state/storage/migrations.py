"""Form of the books on disk, and migrations of older forms to it, as SQL. Pure.

A row's `crc` is that of its body's bytes: `crc32` is a function that the store gives SQLite.
"""

from __future__ import annotations

from farm.model import Entity, Job, Outage, Part, Plate, Print, Printer

SCHEMA_VERSION = 3
TABLES: dict[type[Entity], str] = {
    Job: "job",
    Part: "part",
    Plate: "plate",
    Print: "print",
    Printer: "printer",
    Outage: "outage",
}
_COPIED = "copied (at_s REAL NOT NULL)"
CREATE_COPIED = f"CREATE TABLE IF NOT EXISTS {_COPIED}"
"""Table with the time at which these books were copied, until they are restored."""
FIND_CHANGED_ROW = "SELECT id FROM {} WHERE crc IS NOT crc32(CAST(body AS BLOB)) LIMIT 1"
"""Query for a row of a table that is not as it was written."""

_EMPTY = (
    *(f"CREATE TABLE {t} (id TEXT PRIMARY KEY, body TEXT NOT NULL, crc INTEGER)" for t in TABLES.values()),
    "CREATE TABLE event"
    " (seq INTEGER PRIMARY KEY, at_s REAL NOT NULL, kind TEXT NOT NULL, body TEXT NOT NULL)",
)
EXPECTED_TABLES = frozenset((*_EMPTY, f"CREATE TABLE {_COPIED}"))
"""Tables as SQLite lists them: with one letter of that damaged, it would go on with another table."""
_LAST_ON_BED = """
    SELECT json_extract(p.body, '$.id') AS id, json_extract(p.body, '$.job') AS job
    FROM print AS p JOIN printer ON printer.id = json_extract(p.body, '$.printer')
    WHERE json_extract(printer.body, '$.bed') <> 'clear' AND json_extract(p.body, '$.ended_s') = (
        SELECT max(json_extract(q.body, '$.ended_s')) FROM print AS q
        WHERE json_extract(q.body, '$.printer') = printer.id
    )
"""
_FROM_1 = (  # a verdict was the part's, and of no use; it is the print's, and asked for by its bed
    "UPDATE part SET body = json_remove(body, '$.verdict')",
    f"CREATE TEMP TABLE lying AS {_LAST_ON_BED}",
    "UPDATE print SET body = json_set(body, '$.verdict', 'good')"
    " WHERE json_extract(body, '$.state') = 'done' AND id NOT IN (SELECT id FROM lying)",
    "UPDATE job SET body = json_set(body, '$.state', 'done')"
    " WHERE json_extract(body, '$.state') = 'printed' AND CAST(id AS INTEGER) NOT IN (SELECT job FROM lying)",
    "DROP TABLE lying",
)
"""Parts that had left their beds before anybody was asked count as good; the others can be judged."""
_FROM_2 = tuple(
    statement
    for table in TABLES.values()
    for statement in (
        f"ALTER TABLE {table} ADD COLUMN crc INTEGER",
        f"UPDATE {table} SET crc = crc32(CAST(body AS BLOB))",
    )
)
STEPS = {0: _EMPTY, 1: (*_FROM_1, *_FROM_2), 2: _FROM_2, SCHEMA_VERSION: ()}
"""Statements that lead from each form to the present one; 0 is that of an empty file."""
