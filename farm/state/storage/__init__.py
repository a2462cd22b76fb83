"""Books and files on disk: SQLite, migrations, nightly backups, files named by their hash."""

from farm.state.storage.backups import NightlyBackup, back_up, list_backups, open_books, parse_backup_time_s
from farm.state.storage.file_store import (
    NEW_FILE_GRACE_S,
    StoredFile,
    compute_sha256,
    delete_files,
    link_files,
    list_files,
    remove_broken_links,
    store_file,
)
from farm.state.storage.migrations import SCHEMA_VERSION
from farm.state.storage.store import Store, StoreError, read_books

__all__ = [
    "NEW_FILE_GRACE_S",
    "SCHEMA_VERSION",
    "NightlyBackup",
    "Store",
    "StoreError",
    "StoredFile",
    "back_up",
    "compute_sha256",
    "delete_files",
    "link_files",
    "list_backups",
    "list_files",
    "open_books",
    "parse_backup_time_s",
    "read_books",
    "remove_broken_links",
    "store_file",
]
