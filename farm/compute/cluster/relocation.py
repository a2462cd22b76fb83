"""Pickled calls and results, in which every path is mapped to the folders of another computer."""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any


@dataclass(frozen=True, slots=True)
class Relocation:
    """Mapping of paths: a path at or below the first path of a pair is mapped to the second.

    If several pairs match, the one with the longest first path is used.
    """

    pairs: tuple[tuple[str, str], ...] = ()

    @classmethod
    def from_pairs(cls, pairs: Iterable[tuple[Path | str, Path | str]]) -> Relocation:
        """Build a relocation from pairs in any order."""
        texts = {(str(source), str(target)) for source, target in pairs}
        return cls(tuple(sorted(texts, key=lambda pair: (-len(pair[0]), pair))))

    def reverse(self) -> Relocation:
        """Return the relocation in the opposite direction."""
        return Relocation.from_pairs((target, source) for source, target in self.pairs)

    def map_path(self, path: str) -> str:
        """Return the path that a path is mapped to; the path itself if no pair matches."""
        for source, target in self.pairs:
            if path == source:
                return target
            if path.startswith(f"{source}/"):
                return target + path[len(source) :]
        return path


class _Pickler(pickle.Pickler):
    """Pickler that writes paths as text, mapped by a relocation."""

    def __init__(self, sink: io.BytesIO, relocation: Relocation) -> None:
        super().__init__(sink, protocol=pickle.HIGHEST_PROTOCOL)
        self._relocation = relocation

    def persistent_id(self, item: object) -> str | None:
        return self._relocation.map_path(str(item)) if isinstance(item, PurePath) else None


class _Unpickler(pickle.Unpickler):
    """Unpickler that maps the paths that it reads."""

    def __init__(self, data: bytes, relocation: Relocation) -> None:
        super().__init__(io.BytesIO(data))
        self._relocation = relocation

    def persistent_load(self, pid: str) -> Path:
        return Path(self._relocation.map_path(pid))


_NO_RELOCATION = Relocation()


def dump(item: object, relocation: Relocation = _NO_RELOCATION) -> bytes:
    """Pickle an object, and map its paths."""
    sink = io.BytesIO()
    _Pickler(sink, relocation).dump(item)
    return sink.getvalue()


def load(data: bytes, relocation: Relocation = _NO_RELOCATION) -> Any:
    """Read a pickled object, and map its paths."""
    return _Unpickler(data, relocation).load()


def run_relocated(call: bytes, relocation: Relocation) -> bytes:
    """Run a call that `dump` wrote on another computer; runs in a worker process.

    Parameters
    ----------
    call
        A function and its arguments.
    relocation
        Mapping from the paths of the call to those of this computer.

    Returns
    -------
    bytes
        The result as written by `dump`, with its paths mapped back.
    """
    work, args = load(call, relocation)
    return dump(work(*args), relocation.reverse())
