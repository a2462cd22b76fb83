"""Files named by their SHA-256, never changed: models, part meshes, G-code."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path


def sha256_of(path: Path) -> str:
    """Compute the SHA-256 of a file's bytes, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def name_files(folder: Path, store: Path, names: Mapping[str, str]) -> None:
    """Create links into the store in a folder (name -> stored name), and remove its other links."""
    folder.mkdir(parents=True, exist_ok=True)
    relative = Path(os.path.relpath(store, folder))
    for link in folder.iterdir():
        if link.name in names or (link.is_symlink() and link.readlink().parent == relative):
            link.unlink()
    for name, stored in names.items():
        (folder / name).symlink_to(relative / stored)


def store_file(folder: Path, source: Path) -> str:
    """Move a finished file into the store, under its hash and suffix. Returns that name.

    The bytes are on the disk before the name exists, so every named file is complete.
    """
    name = sha256_of(source) + source.suffix.lower()
    target = folder / name
    if target.exists():
        source.unlink()
        return name
    with source.open("rb") as file:
        os.fsync(file.fileno())
    source.chmod(0o444)
    source.replace(target)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    return name
