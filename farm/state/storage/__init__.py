"""Books and files on disk: SQLite, migrations, nightly backups, files named by their hash."""

from farm.state.storage.backups import NightlyBackup, back_up, list_backups, open_books, parse_backup_time_s
from farm.state.storage.file_store import (
    GRACE_S,
    StoredFile,
    compute_sha256,
    delete_files,
    list_files,
    name_files,
    store_file,
    unlink_missing_files,
)
from farm.state.storage.migrations import SCHEMA_VERSION
from farm.state.storage.store import Store, StoreError, read_books

__all__ = [
    "GRACE_S",
    "SCHEMA_VERSION",
    "NightlyBackup",
    "Store",
    "StoreError",
    "StoredFile",
    "back_up",
    "compute_sha256",
    "delete_files",
    "list_backups",
    "list_files",
    "name_files",
    "open_books",
    "parse_backup_time_s",
    "read_books",
    "store_file",
    "unlink_missing_files",
]
