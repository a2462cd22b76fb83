"""Books and files on disk: SQLite, migrations, nightly backups, files named by their hash."""

from farm.state.storage.backups import NightlyBackup, back_up, backup_time_s, list_backups, open_books
from farm.state.storage.file_store import (
    GRACE_S,
    StoredFile,
    delete_files,
    list_files,
    name_files,
    sha256_of,
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
    "backup_time_s",
    "delete_files",
    "list_backups",
    "list_files",
    "name_files",
    "open_books",
    "read_books",
    "sha256_of",
    "store_file",
    "unlink_missing_files",
]
