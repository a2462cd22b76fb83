"""Locations of CuraEngine and of Cura's files, and their parsed contents (see `definitions`)."""

from __future__ import annotations

import configparser
import json
import os
import shutil
import sys
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from slicing.errors import BadSetting, EngineMissing, ResourcesMissing, suggest_names
from slicing.settings.definitions import Setting, merge_definitions
from slicing.settings.material import read_material_kind
from slicing.settings.own_materials import MATERIAL_SUFFIX, list_own_materials, read_own_material

OWN_MATERIALS_VARIABLE = "FARM_MATERIALS"
"""Environment variable with the folder of a person's own material files."""
FOLDERS = ("definitions", "extruders", "variants", "quality", "materials")
_GENERIC_MACHINE = "fdmprinter"
"""Definition whose qualities apply, with any material, to machines without their own qualities."""
_ADVICE = "run 'farm setup', or set {}"
_PROJECT_ROOT = Path(__file__).resolve().parents[2]
INSTALLATION_FOLDER = (
    _PROJECT_ROOT / ".cura" / "resources"
    if (_PROJECT_ROOT / "pyproject.toml").is_file()
    else Path(sys.prefix) / "share" / "farm" / "cura"
)
"""Folder of Cura's files that `farm setup` creates: in the checkout, else in the environment."""


def find_engine(environ: Mapping[str, str] = os.environ) -> Path:
    """Find CuraEngine: `FARM_CURA_ENGINE`, else the one on PATH. Raises EngineMissing if there is none."""
    configured = environ.get("FARM_CURA_ENGINE")
    path = shutil.which(configured or "CuraEngine", path=environ.get("PATH"))
    if path is None:
        problem = (
            f"FARM_CURA_ENGINE={configured} cannot be run" if configured else "there is no CuraEngine on PATH"
        )
        raise EngineMissing(f"{problem}: {_ADVICE.format('FARM_CURA_ENGINE to the program')}")
    return Path(path)


def find_resources(environ: Mapping[str, str] = os.environ, own_materials: Path | None = None) -> Resources:
    """Find Cura's files: `FARM_CURA_RESOURCES`, else the folder of `farm setup`, else Debian's folder.

    Parameters
    ----------
    environ
        The environment.
    own_materials
        Folder with the user's material files; None for the folder in `FARM_MATERIALS`, if it is set.

    Raises
    ------
    ResourcesMissing
        If none of these folders is complete.
    """
    configured = environ.get("FARM_CURA_RESOURCES")
    roots = [Path(configured)] if configured else [INSTALLATION_FOLDER, Path("/usr/share/cura/resources")]
    for root in roots:
        if all((root / folder).is_dir() for folder in FOLDERS):
            folder = environ.get(OWN_MATERIALS_VARIABLE)
            return Resources(root, own_materials or (Path(folder) if folder else None))
    problem = f"FARM_CURA_RESOURCES={configured} lacks" if configured else "Cura's files are missing:"
    raise ResourcesMissing(
        f"{problem} the folders {', '.join(FOLDERS)}: {_ADVICE.format('FARM_CURA_RESOURCES to their folder')}"
    )


@dataclass(frozen=True, slots=True)
class Machine:
    """A printer model's merged definitions, and the facts that select its profiles."""

    model: str
    name: str  # the product's name in material files
    quality_definition: str
    has_variants: bool  # True if each nozzle has its own profile
    has_materials: bool  # True if each material has its own qualities
    excluded_materials: frozenset[str]
    nozzle_mm: float  # diameter of the nozzle if there is no variant
    diameter_mm: float  # of the filament
    settings: Mapping[str, Setting]
    extruder: Mapping[str, Setting]


@dataclass(frozen=True, slots=True)
class Profile:
    """An ``.inst.cfg`` file: the metadata that selects it, and its values as written."""

    metadata: Mapping[str, str]
    values: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Resources:
    """Cura's folder of resources, and the folder of the user's materials; a process reads each file once."""

    root: Path
    own_materials: Path | None = None

    def read_machine(self, model: str) -> Machine:
        """Read a printer model by Cura's definition id. Raises BadSetting if there is none."""
        return _read_machine(self.root, model)

    def read_profiles(self, kind: str, definition: str) -> tuple[Profile, ...]:
        """Read the profiles of a kind (``quality``, ``variants``) that a definition has, by file name."""
        return _read_profiles(self.root, kind, definition)

    def read_material(self, name: str) -> ET.Element:
        """Read a material's XML. Raises BadSetting if there is none, or the user's own file is not usable."""
        return _read_material(self.root, self.own_materials, name)

    def list_own_material_names(self) -> tuple[str, ...]:
        """List the names of a person's own materials. Raises BadSetting if their folder is not usable."""
        return tuple(_list_own_materials(self.root, self.own_materials))

    def list_material_names(self) -> tuple[str, ...]:
        """List the names of all materials, the user's own first."""
        return (*self.list_own_material_names(), *_list_cura_materials(self.root))

    def read_material_kind(self, name: str) -> str | None:
        """Read the kind of a material, such as PLA; None if there is no such material."""
        try:
            return read_material_kind(self.read_material(name))
        except BadSetting:
            return None


def _read_json(path: Path) -> dict[str, Any]:
    try:
        parsed = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ResourcesMissing(f"{path}: {error}: {_ADVICE.format('FARM_CURA_RESOURCES')}") from error
    if not isinstance(parsed, dict):
        raise ResourcesMissing(f"{path} is not a definition: {_ADVICE.format('FARM_CURA_RESOURCES')}")
    return parsed


def _read_chain(root: Path, folders: tuple[str, ...], name: str) -> list[dict[str, Any]]:
    """Read the definition files from the root of the inheritance down to `name`."""
    chain: list[dict[str, Any]] = []
    current: str | None = name
    while current is not None:
        paths = [root / folder / f"{current}.def.json" for folder in folders]
        chain.insert(0, _read_json(next((path for path in paths if path.is_file()), paths[0])))
        current = chain[0].get("inherits")
        if len(chain) > 20:
            raise ResourcesMissing(f"{name}.def.json inherits from itself")
    return chain


@lru_cache(maxsize=16)
def _read_machine(root: Path, model: str) -> Machine:
    folder = root / "definitions"
    names = {path.name.removesuffix(".def.json") for path in folder.glob("*.def.json")}
    if model not in names:
        raise BadSetting(f"{model}: Cura has no such printer model{suggest_names(model, names)}")
    chain = _read_chain(root, ("definitions",), model)
    metadata: dict[str, Any] = {}
    for file in chain:
        metadata |= file.get("metadata", {})
    extruder = merge_definitions(
        _read_chain(root, ("extruders", "definitions"), metadata["machine_extruder_trains"]["0"])
    )
    has_own_qualities = bool(metadata.get("has_machine_quality", False))
    return Machine(
        model=model,
        name=chain[-1]["name"],
        quality_definition=metadata.get("quality_definition", model)
        if has_own_qualities
        else _GENERIC_MACHINE,
        has_variants=bool(metadata.get("has_variants", False)),
        has_materials=has_own_qualities and bool(metadata.get("has_materials", False)),
        excluded_materials=frozenset(metadata.get("exclude_materials", ())),
        nozzle_mm=float(extruder["machine_nozzle_size"].default),
        diameter_mm=float(extruder["material_diameter"].default),
        settings=merge_definitions(chain),
        extruder=extruder,
    )


@lru_cache(maxsize=32)
def _read_profiles(root: Path, kind: str, definition: str) -> tuple[Profile, ...]:
    # Qualities have a folder for each machine, or in one for each maker; all variants are in one folder.
    folder, pattern = root / kind, f"{definition}_*.inst.cfg"
    for path in (folder / definition, folder / definition.replace("_", "/", 1)):
        if path.is_dir():
            folder, pattern = path, "*.inst.cfg"
            break
    if definition == _GENERIC_MACHINE:
        pattern = "*.inst.cfg"  # beside the folders
    profiles = []
    for path in sorted(folder.glob(pattern)):
        parser = configparser.ConfigParser(interpolation=None)
        try:
            parser.read_string(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, configparser.Error) as error:
            raise ResourcesMissing(f"{path}: {error}") from error
        if parser.get("general", "definition", fallback="") == definition:
            metadata = dict(parser["metadata"]) | {"name": parser.get("general", "name", fallback="")}
            profiles.append(Profile(metadata, dict(parser["values"]) if parser.has_section("values") else {}))
    return tuple(profiles)


@lru_cache(maxsize=4)
def _list_cura_materials(root: Path) -> Mapping[str, Path]:
    paths = sorted((root / "materials").glob(f"*{MATERIAL_SUFFIX}"))
    return {path.name.removesuffix(MATERIAL_SUFFIX): path for path in paths}


@lru_cache(maxsize=4)
def _list_own_materials(root: Path, folder: Path | None) -> Mapping[str, Path]:
    materials = {} if folder is None else list_own_materials(folder)
    for name in materials:
        if name in _list_cura_materials(root):
            raise BadSetting(f"{materials[name]}: Cura has a material {name} of its own; rename the file")
    return materials


@lru_cache(maxsize=1024)
def _read_material(root: Path, folder: Path | None, name: str) -> ET.Element:
    own_names, cura_paths = _list_own_materials(root, folder), _list_cura_materials(root)
    if name in own_names:
        return read_own_material(own_names[name])
    names = {*own_names, *cura_paths}
    if name not in names:
        # PLA is a kind of material; Cura has a generic material of each kind.
        generic = f"generic_{name.lower()}"
        hint = suggest_names(generic if generic in names else name, names)
        raise BadSetting(f"{name}: Cura has no such material{hint}")
    try:
        return ET.fromstring(cura_paths[name].read_text(encoding="utf-8"))
    except (OSError, ET.ParseError) as error:
        raise ResourcesMissing(f"{cura_paths[name]}: {error}") from error
