"""Versions that determine the bytes of parts and slices, and must be equal on all computers of a cluster."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Self

import farm
from slicing.engine import read_engine_version
from slicing.settings import find_engine, find_resources

_LIBRARIES = ("numpy", "scipy", "numba", "manifold3d", "pymeshfix", "scikit-learn", "shapely", "trimesh")
_PACKAGES = ("farm", "drivers", "decompose", "slicing")
_PYTHON_VERSION = f"Python {sys.version_info.major}.{sys.version_info.minor}"
_HASH_DIGITS = 12  # number of hexadecimal digits of a hash


@dataclass(frozen=True, slots=True)
class Installation:
    """Versions on one computer, and the paths of CuraEngine and of Cura's files there.

    Attributes
    ----------
    farm, engine, settings
        Version and hash of farm's code and of CuraEngine; hash of Cura's settings and the user's materials.
    libraries
        Versions of the libraries that compute parts.
    engine_path, resources_path, materials_path
        Paths; the last is empty if the user has no materials.
    """

    farm: str
    engine: str
    settings: str
    libraries: str
    engine_path: str
    resources_path: str
    materials_path: str

    @classmethod
    def from_record(cls, record: dict[str, str]) -> Self:
        """Build an installation from a record made by `as_record`, possibly by another version of farm."""
        return cls(**{name: str(record.get(name, "?")) for name in cls.__dataclass_fields__})

    def as_record(self) -> dict[str, str]:
        """Convert the installation to a dictionary of strings."""
        return asdict(self)

    def describe_difference(self, expected_installation: Installation) -> str | None:
        """Describe the first difference from the expected versions; None if both give the same bytes."""
        titles = {"farm": "farm", "engine": "CuraEngine", "settings": "Cura's settings", "libraries": ""}
        for name, title in titles.items():
            own_value, expected_value = getattr(self, name), getattr(expected_installation, name)
            if own_value != expected_value:
                if name == "libraries":
                    own_value, expected_value = _find_differing_entries(own_value, expected_value)
                return f"it has {title} {own_value}, not {expected_value}".replace("  ", " ")
        return None

    def pair_paths(self, other_installation: Installation) -> list[tuple[str, str]]:
        """Pair the paths of this installation with those of another; omit paths that one of them lacks."""
        names = ("engine_path", "resources_path", "materials_path")
        pairs = [(getattr(self, name), getattr(other_installation, name)) for name in names]
        return [pair for pair in pairs if all(pair)]


def read_installation() -> Installation:
    """Read the versions on this computer. Takes a second, because it reads every file of Cura's settings.

    Raises
    ------
    SlicingError
        If there is no CuraEngine, or no files of Cura.
    """
    engine, resources = find_engine(), find_resources()
    sources = Path(farm.__file__).parents[1]
    code = (file for package in _PACKAGES for file in sorted((sources / package).rglob("*.py")))
    own_materials = resources.own_materials
    settings = sorted(file for file in resources.root.rglob("*") if file.is_file())
    if own_materials is not None:
        settings += sorted(file for file in own_materials.rglob("*") if file.is_file())
    roots = [resources.root, *([own_materials] if own_materials else [])]
    return Installation(
        farm=f"{farm.__version__} ({_hash_files(code, [sources])})",
        engine=f"{read_engine_version(engine).rpartition(' ')[2]} ({_hash_files([engine], [engine.parent])})",
        settings=_hash_files(settings, roots),
        libraries=", ".join([_PYTHON_VERSION, *(f"{name} {_find_version(name)}" for name in _LIBRARIES)]),
        engine_path=str(engine),
        resources_path=str(resources.root),
        materials_path=str(own_materials or ""),
    )


def _hash_files(files: Iterable[Path], roots: list[Path]) -> str:
    """Hash the relative path and the content of each file, in the given order."""
    digest = hashlib.sha256()
    for file in files:
        root = next(root for root in reversed(roots) if file.is_relative_to(root))
        digest.update(f"{file.relative_to(root)}\0".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:_HASH_DIGITS]


def _find_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


def _find_differing_entries(own_versions: str, expected_versions: str) -> tuple[str, str]:
    """Return the entries that differ between two lists of versions."""
    entries = zip(own_versions.split(", "), expected_versions.split(", "), strict=False)
    pairs = [(a, b) for a, b in entries if a != b]
    if not pairs:
        return own_versions, expected_versions
    return ", ".join(a for a, _ in pairs), ", ".join(b for _, b in pairs)
