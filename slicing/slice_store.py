"""Store of slices by content, in which equal plates share a slice. `slicing.cache_limit` trims its folder."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slicing.checks import FeatureTimes, GcodeFacts, UnprintedWall
from slicing.engine import read_engine_version
from slicing.glued_parts import HiddenRecess, HiddenSide
from slicing.settings import EngineSettings

_FORMAT = "farm-slice-18"
"""Version in the cache's key; increase it with each change to the stored record or the checks."""


@dataclass(frozen=True, slots=True)
class CheckedSlice:
    """G-code that passed the checks, with its facts and the times of its features."""

    gcode: bytes
    facts: GcodeFacts
    unprinted_walls: tuple[UnprintedWall, ...]
    features: FeatureTimes


@dataclass(frozen=True, slots=True)
class StoredSlice:
    """Cache entry of a slice, named by a hash of all of its inputs."""

    folder: Path | None
    key: str

    @classmethod
    def locate(
        cls,
        cache: Path | None,
        engine: Path,
        settings: EngineSettings,
        model: bytes,
        hidden_sides: Sequence[HiddenSide] = (),
        hidden_recesses: Sequence[HiddenRecess] = (),
    ) -> StoredSlice:
        """Find the entry of a model (an STL's bytes) for these settings; it is empty without a cache."""
        if cache is None:
            return cls(None, "")
        hidden_faces = [*map(asdict, hidden_sides), *map(asdict, hidden_recesses)]
        walls: list[Any] = (
            [settings.hidden_wall_ratio, settings.has_single_hidden_walls] if hidden_faces else []
        )
        walls += hidden_faces
        settings_text = json.dumps([settings.global_, settings.extruder, walls], sort_keys=True)
        digest = hashlib.sha256(model)
        for text in (settings_text, read_engine_version(engine), _FORMAT):
            digest.update(hashlib.sha256(text.encode()).digest())
        return cls(cache, digest.hexdigest())

    def read(self) -> CheckedSlice | None:
        """Read the stored slice; None if there is none, or if it is damaged."""
        if self.folder is None:
            return None
        try:
            entry: Mapping[str, Any] = json.loads((self.folder / f"{self.key}.json").read_bytes())
            gcode = (self.folder / f"{self.key}.gcode").read_bytes()
            if hashlib.sha256(gcode).hexdigest() != entry["sha256"]:
                return None
            facts = dict(entry["facts"])
            facts |= {name: tuple(facts[name]) for name in ("min_mm", "max_mm")}
            unprinted_walls = tuple(UnprintedWall(**wall) for wall in entry["unprinted"])
            checked_slice = CheckedSlice(
                gcode, GcodeFacts(**facts), unprinted_walls, FeatureTimes(**entry["features"])
            )
        except (OSError, ValueError, KeyError, TypeError):
            return None
        with contextlib.suppress(OSError):  # `slicing.cache_limit` reads the file's time as its last use
            os.utime(self.folder / f"{self.key}.json")
        return checked_slice

    def write(self, checked_slice: CheckedSlice) -> None:
        """Store a slice; do nothing without a cache."""
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        entry = {
            "sha256": hashlib.sha256(checked_slice.gcode).hexdigest(),
            "facts": asdict(checked_slice.facts),
            "unprinted": [asdict(wall) for wall in checked_slice.unprinted_walls],
            "features": asdict(checked_slice.features),
        }
        write_atomically(self.folder / f"{self.key}.gcode", checked_slice.gcode)
        # The record is written last: it makes the entry valid.
        write_atomically(self.folder / f"{self.key}.json", json.dumps(entry).encode())


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file such that a reader sees either the whole file or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        Path(name).replace(path)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(path)  # the error for a full disk has no file name
        raise
