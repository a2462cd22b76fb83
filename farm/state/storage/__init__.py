"""Books and files on disk: SQLite, migrations, nightly backups, files named by their hash."""

from farm.state.storage.backups import NightlyBackup, open_books
from farm.state.storage.file_store import name_files, sha256_of, store_file
from farm.state.storage.migrations import SCHEMA_VERSION
from farm.state.storage.store import Store, StoreError, read_books

__all__ = [
    "SCHEMA_VERSION",
    "NightlyBackup",
    "Store",
    "StoreError",
    "name_files",
    "open_books",
    "read_books",
    "sha256_of",
    "store_file",
]
