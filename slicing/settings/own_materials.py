"""A person's own material files, in Cura's format: checked as untrusted input."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from slicing.errors import BadSetting
from slicing.settings.limits import find_reserved_reason
from slicing.settings.material import CURA_SETTING, NAMESPACES, read_material_kind

MATERIAL_SUFFIX = ".xml.fdm_material"
MAX_FILE_BYTES = 256 * 1024  # Cura's own files have up to 40 KiB
MAX_FILES = 500
_NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,60}")
_KIND_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,30}")
_DENSITY_BOUNDS_G_CM3 = (0.1, 20.0)
_DIAMETER_BOUNDS_MM = (1.0, 4.0)
_ROOT_TAG = f"{{{NAMESPACES['m']}}}fdmmaterial"

# For each kind of material that Cura does not have, the kind whose profiles a user's material may use.
# [assumed] Both are printed in much the same way; temperatures and cooling come from the material's file.
RELATED_KINDS = {
    "PETG": "CPE",
    "PET": "CPE",
    "PLA+": "PLA",
    "Tough PLA": "PLA",
    "ASA": "ABS",
    "HIPS": "ABS",
    "PA": "Nylon",
    "TPU": "TPU 95A",
    "TPE": "TPU 95A",
}


class _DoctypeRefusingBuilder(ET.TreeBuilder):
    """Builder of elements that refuses a DOCTYPE: entities can expand without bound, or name other files."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise BadSetting("a DOCTYPE is not allowed")


def list_own_materials(folder: Path) -> dict[str, Path]:
    """Find the material files in a folder, by the names of their materials.

    Raises
    ------
    BadSetting
        If the folder cannot be read, has too many files, or a name is not usable.
    """
    try:
        paths = sorted(path for path in folder.iterdir() if path.name.endswith(MATERIAL_SUFFIX))
    except OSError as error:
        raise BadSetting(f"the folder of materials {folder} cannot be read ({error.strerror})") from error
    if len(paths) > MAX_FILES:
        raise BadSetting(f"{folder} has {len(paths)} materials; at most {MAX_FILES} are allowed")
    path_by_name = {path.name.removesuffix(MATERIAL_SUFFIX): path for path in paths}
    for name in path_by_name:
        if not _NAME_PATTERN.fullmatch(name):
            raise BadSetting(
                f"{folder}: {name + MATERIAL_SUFFIX!r}: name it with letters, digits, '.', '_', '+' and '-'"
            )
    return path_by_name


def read_own_material(path: Path) -> ET.Element:
    """Read and check a material file.

    Raises
    ------
    BadSetting
        If it is not a Cura material file, or has a setting that a material must not set.
    """
    try:
        root = _parse_file(path)
        _check_properties(root)
        _check_settings(root)
    except BadSetting as error:
        raise BadSetting(f"{path}: {error}") from error
    return root


def _parse_file(path: Path) -> ET.Element:
    try:
        if not path.is_file():
            raise BadSetting("is not a file")
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise BadSetting(f"cannot be read ({error.strerror})") from error
    if len(data) > MAX_FILE_BYTES:
        raise BadSetting(f"is larger than {MAX_FILE_BYTES // 1024} KiB: not a material file")
    try:
        root = ET.fromstring(data, ET.XMLParser(target=_DoctypeRefusingBuilder()))
    except (ET.ParseError, ValueError, LookupError) as error:  # LookupError: an unknown encoding
        raise BadSetting(f"is not XML: {error}") from error
    if root.tag != _ROOT_TAG:
        raise BadSetting("is not a Cura material file: its first element is not `fdmmaterial`")
    return root


def _check_properties(root: ET.Element) -> None:
    if not _KIND_PATTERN.fullmatch(read_material_kind(root)):
        raise BadSetting("needs its kind, like PETG, in metadata/name/material")
    for name, (minimum, maximum) in (("density", _DENSITY_BOUNDS_G_CM3), ("diameter", _DIAMETER_BOUNDS_MM)):
        text = root.findtext(f"m:properties/m:{name}", default="", namespaces=NAMESPACES)
        number = _parse_number(text)
        if number is None or not minimum <= number <= maximum:
            raise BadSetting(
                f"properties/{name} must be a number from {minimum:g} to {maximum:g}, not {text!r}"
            )


def _check_settings(root: ET.Element) -> None:
    for entry in root.iter(CURA_SETTING):
        key, text = entry.get("key", ""), (entry.text or "").strip()
        reason = find_reserved_reason(key)
        if reason is not None:
            raise BadSetting(f"{key}: {reason}")
        if text.startswith("="):
            raise BadSetting(f"{key}: formulas are not read in a material file; write the value")
    for point in root.iter(f"{{{NAMESPACES['m']}}}point"):
        if None in (_parse_number(point.get("flow", "0")), _parse_number(point.get("temperature", "0"))):
            raise BadSetting("a point of its temperature graph is not a pair of numbers")
    for entry in root.iter(f"{{{NAMESPACES['m']}}}setting"):
        if (entry.text or "").strip().startswith("="):
            raise BadSetting(f"{entry.get('key')}: formulas are not read in a material file; write the value")


def _parse_number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
