"""Resolved settings, compared with those that Cura computed (`record_cura_settings.py`)."""

import gzip
import json
import math
import os
from pathlib import Path

import pytest

from slicing.errors import EngineMissing
from slicing.settings import Resources, find_resources
from slicing.settings.formula import Formula
from slicing.settings.resolver import ProfileIndex, Resolver, Scope
from slicing.settings.stacks import find_stacks

FIXTURES = Path(__file__).parents[1] / "fixtures"
SETTING_VERSIONS = {"4.13": 19, "5.0": 20}
RECORDED_SETTINGS = {
    version: json.loads(gzip.decompress((FIXTURES / f"cura-{version}.json.gz").read_bytes()))
    for version in SETTING_VERSIONS
}


def find_cura_resources(version):
    """Return Cura's files of a version: the installed ones, or those in `FARM_CURA_RESOURCES_<version>`."""
    folder_name = os.environ.get(f"FARM_CURA_RESOURCES_{version.replace('.', '_')}")
    try:
        result = Resources(Path(folder_name)) if folder_name else find_resources()
    except EngineMissing as error:
        pytest.skip(str(error))
    root = json.loads((result.root / "definitions" / "fdmprinter.def.json").read_text())
    if root["metadata"]["setting_version"] != SETTING_VERSIONS[version]:
        pytest.skip(f"the settings in {result.root} are not Cura {version}'s")
    return result


def are_equal(value, cura_value):
    """Compare values as the engine reads them, ignoring the last digit of numbers and the case of words."""
    try:
        return math.isclose(float(value), float(cura_value), rel_tol=1e-9)
    except ValueError:
        return value.lower() == cura_value.lower()


@pytest.mark.parametrize(
    ("version", "number"),
    [
        (version, number)
        for version, item in RECORDED_SETTINGS.items()
        for number in range(len(item["combinations"]))
    ],
)
def test_every_setting_equals_that_of_cura(version, number):
    recording, resources = RECORDED_SETTINGS[version], find_cura_resources(version)
    machine, nozzle, material, quality, user_changes = recording["combinations"][number]
    stacks = find_stacks(resources, machine, float(nozzle.split()[0]), material, quality)
    changes = {
        key: Formula(value[1:]) if isinstance(value, str) and value.startswith("=") else value
        for key, value in user_changes.items()
    }
    profiles = {scope: {ProfileIndex.USER: changes, **items} for scope, items in stacks.profiles.items()}
    resolver = Resolver(stacks.machine.settings, stacks.machine.extruder, profiles)
    for scope in Scope:
        values = {key: row[number] for key, row in recording[scope].items() if row[number] is not None}
        resolved_values = {key: str(resolver.compute_value(scope, key)) for key in resolver.list_keys(scope)}
        assert resolved_values.keys() == values.keys()
        assert {
            key: (resolved_values[key], value)
            for key, value in values.items()
            if not are_equal(resolved_values[key], value)
        } == {}
