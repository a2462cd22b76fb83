"""Disk after a power cut in the worst case, in which only synced data survives."""

import os
from pathlib import Path


class PowerCut:
    """Recorder of the syncs of files in a folder.

    A file keeps the bytes of its last sync. A name survives if its folder was synced after the name was
    assigned. Files that existed before the recording count as synced.
    """

    def __init__(self, monkeypatch, folder):
        self._bytes = {}  # contents of files by their inodes
        self._names = {}  # names and inodes of entries by their folders
        for path in (folder, *folder.rglob("*")):
            self._record_sync(path)
        sync = os.fsync

        def fsync(descriptor):
            sync(descriptor)
            self._record_sync(Path(f"/proc/self/fd/{descriptor}").readlink())

        monkeypatch.setattr(os, "fsync", fsync)
        monkeypatch.setattr(os, "fdatasync", fsync)
        self._folder = folder

    def _record_sync(self, path):
        if path.is_dir():
            self._names[path] = {entry.name: entry.stat().st_ino for entry in path.iterdir()}
        else:
            self._bytes[path.stat().st_ino] = path.read_bytes()

    def copy_synced_files(self, destination):
        """Copy the files that survive a power cut into a new folder."""
        self._rebuild(self._folder, destination)
        return destination

    def _rebuild(self, folder, destination):
        destination.mkdir(parents=True)
        for name, inode in self._names.get(folder, {}).items():
            if (folder / name).is_dir():
                self._rebuild(folder / name, destination / name)
            else:
                (destination / name).write_bytes(self._bytes.get(inode, b""))
