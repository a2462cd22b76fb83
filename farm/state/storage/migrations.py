"""Schema of the books on disk, and migrations from earlier versions, as SQL. Pure.

A row's `crc` is the CRC-32 of its body's bytes; the store defines the function `crc32` in SQLite.
"""

from __future__ import annotations

from farm.model import Entity, Job, Key, Outage, Part, Plate, Print, Printer

SCHEMA_VERSION = 4
CHECKSUMS_VERSION = 3
"""First schema version whose rows have checksums."""
TABLES: dict[type[Entity], str] = {
    Job: "job",
    Part: "part",
    Plate: "plate",
    Print: "print",
    Printer: "printer",
    Outage: "outage",
    Key: "access_key",
}
FIRST_VERSIONS: dict[type[Entity], int] = {Key: 4}
"""First schema version that has the table, for each table that was added after version 1."""
_COPIED_TABLE = "copied (at_s REAL NOT NULL)"
COPIED_TABLE_STATEMENT = f"CREATE TABLE IF NOT EXISTS {_COPIED_TABLE}"
"""Statement that creates the table `copied`; in a backup it has one row, the time of the backup."""
CHANGED_ROW_QUERY = "SELECT id FROM {} WHERE crc IS NOT crc32(CAST(body AS BLOB)) LIMIT 1"
"""Query for a row of a table whose body does not match its checksum."""

_TABLE_STATEMENT = "CREATE TABLE {} (id TEXT PRIMARY KEY, body TEXT NOT NULL, crc INTEGER)"
_INITIAL_SCHEMA = (
    *(_TABLE_STATEMENT.format(table) for table in TABLES.values()),
    "CREATE TABLE event"
    " (seq INTEGER PRIMARY KEY, at_s REAL NOT NULL, kind TEXT NOT NULL, body TEXT NOT NULL)",
)
EXPECTED_TABLE_STATEMENTS = frozenset((*_INITIAL_SCHEMA, f"CREATE TABLE {_COPIED_TABLE}"))
"""Statements that create the tables, as SQLite lists them; others show that the schema is damaged."""
_PRINTS_ON_BEDS_QUERY = """
    SELECT json_extract(p.body, '$.id') AS id, json_extract(p.body, '$.job') AS job
    FROM print AS p JOIN printer ON printer.id = json_extract(p.body, '$.printer')
    WHERE json_extract(printer.body, '$.bed') IS NOT 'clear' AND json_extract(p.body, '$.ended_s') = (
        SELECT max(json_extract(q.body, '$.ended_s')) FROM print AS q
        WHERE json_extract(q.body, '$.printer') = printer.id
    )
"""
_MIGRATION_FROM_1 = (  # verdicts on parts become verdicts on prints, which people give when they clear beds
    "UPDATE part SET body = json_remove(body, '$.verdict')",
    f"CREATE TEMP TABLE on_bed AS {_PRINTS_ON_BEDS_QUERY}",
    "UPDATE print SET body = json_set(body, '$.verdict', 'good')"
    " WHERE json_extract(body, '$.state') = 'done' AND id NOT IN (SELECT id FROM on_bed)",
    "UPDATE job SET body = json_set(body, '$.state', 'done')"
    " WHERE json_extract(body, '$.state') = 'printed'"
    " AND CAST(id AS INTEGER) NOT IN (SELECT job FROM on_bed)",
    "DROP TABLE on_bed",
)
"""Parts that were removed from their beds before version 2 count as good; the others can be judged."""
_MIGRATION_FROM_3 = (_TABLE_STATEMENT.format(TABLES[Key]),)
_MIGRATION_FROM_2 = (
    *(
        statement
        for kind, table in TABLES.items()
        if kind not in FIRST_VERSIONS
        for statement in (
            f"ALTER TABLE {table} ADD COLUMN crc INTEGER",
            f"UPDATE {table} SET crc = crc32(CAST(body AS BLOB))",
        )
    ),
    *_MIGRATION_FROM_3,
)
MIGRATIONS = {
    0: _INITIAL_SCHEMA,
    1: (*_MIGRATION_FROM_1, *_MIGRATION_FROM_2),
    2: _MIGRATION_FROM_2,
    3: _MIGRATION_FROM_3,
    SCHEMA_VERSION: (),
}
"""Statements that migrate books to the current version, by the version of the books; 0: an empty file."""
