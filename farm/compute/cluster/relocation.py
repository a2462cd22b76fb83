"""Calls and results as bytes in which every path can be moved to another computer's folders."""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any


@dataclass(frozen=True, slots=True)
class Relocation:
    """Pairs of paths: paths at or below the first of a pair move to the second. The longest match is used."""

    pairs: tuple[tuple[str, str], ...] = ()

    @classmethod
    def from_pairs(cls, pairs: Iterable[tuple[Path | str, Path | str]]) -> Relocation:
        """Build a relocation from pairs in any order."""
        texts = {(str(source), str(target)) for source, target in pairs}
        return cls(tuple(sorted(texts, key=lambda pair: (-len(pair[0]), pair))))

    def reverse(self) -> Relocation:
        """Return the relocation in the opposite direction."""
        return Relocation.from_pairs((target, source) for source, target in self.pairs)

    def move(self, path: str) -> str:
        """Return a path moved by the pair that matches it, or unchanged if no pair does."""
        for source, target in self.pairs:
            if path == source:
                return target
            if path.startswith(f"{source}/"):
                return target + path[len(source) :]
        return path


class _Pickler(pickle.Pickler):
    """Pickler that writes paths as text, moved by a relocation."""

    def __init__(self, sink: io.BytesIO, relocation: Relocation) -> None:
        super().__init__(sink, protocol=pickle.HIGHEST_PROTOCOL)
        self._relocation = relocation

    def persistent_id(self, item: object) -> str | None:
        return self._relocation.move(str(item)) if isinstance(item, PurePath) else None


class _Unpickler(pickle.Unpickler):
    """Unpickler that moves the paths that it reads."""

    def __init__(self, data: bytes, relocation: Relocation) -> None:
        super().__init__(io.BytesIO(data))
        self._relocation = relocation

    def persistent_load(self, pid: str) -> Path:
        return Path(self._relocation.move(pid))


_NO_RELOCATION = Relocation()


def dump(item: object, relocation: Relocation = _NO_RELOCATION) -> bytes:
    """Write an object as bytes, with its paths moved."""
    sink = io.BytesIO()
    _Pickler(sink, relocation).dump(item)
    return sink.getvalue()


def load(data: bytes, relocation: Relocation = _NO_RELOCATION) -> Any:
    """Read an object from bytes, with its paths moved."""
    return _Unpickler(data, relocation).load()


def run_relocated(call: bytes, relocation: Relocation) -> bytes:
    """Run a call that `dump` wrote, with its paths moved, in a worker process.

    Parameters
    ----------
    call
        A function and its arguments.
    relocation
        Relocation from the paths of the call to those of this computer.

    Returns
    -------
    bytes
        The result as written by `dump`, with its paths moved back.
    """
    work, args = load(call, relocation)
    return dump(work(*args), relocation.reverse())
