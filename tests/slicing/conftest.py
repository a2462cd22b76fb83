"""Fixtures: real Cura files, the real engine, and generated models."""

from pathlib import Path

import pytest
import trimesh

from model_files.make_stl import write_stl_bytes
from printers.slicing_printers import PRINTERS
from slicing.errors import EngineMissing
from slicing.plate import PlateRequest
from slicing.settings import SettingsRequest, find_engine, find_resources, resolve_settings

WHOLE_BED = ((-111.5, -111.5, 111.5, 111.5, 205.0),)


@pytest.fixture(scope="session")
def resources():
    try:
        return find_resources()
    except EngineMissing as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def engine():
    try:
        return find_engine()
    except EngineMissing as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def make_settings(resources):
    """Return a function that resolves settings for a printer; keyword arguments override them."""

    def resolve(quality="glue", model="ultimaker2_plus", **overrides):
        return resolve_settings(SettingsRequest(PRINTERS[model], quality, overrides=overrides), resources)

    return resolve


@pytest.fixture
def make_request(tmp_path, engine, make_settings):
    """Return a function that makes a PlateRequest for a mesh, centred on the bed, or for a file's bytes."""

    def make(model, *, settings=None, bed=WHOLE_BED, cache=None, out="part.gcode", **fields):
        stl = tmp_path / "part.stl"
        stl.write_bytes(model if isinstance(model, bytes) else write_stl_bytes(model))
        return PlateRequest(
            stl=stl,
            settings=settings or make_settings(),
            output_path=tmp_path / out,
            engine=engine,
            bed=bed,
            cache=cache,
            **{"timeout_s": 60.0, **fields},
        )

    return make


@pytest.fixture
def write_script(tmp_path):
    """Return a function that writes a script to run in place of the engine."""

    def make(body):
        path = Path(tmp_path / "engine.sh")
        help_command = 'if [ "$1" = help ]; then echo "Cura_SteamEngine version 4.13.0"; exit; fi'
        path.write_text(f"#!/bin/sh\n{help_command}\n{body}\n")
        path.chmod(0o755)
        return path

    return make


@pytest.fixture(scope="session")
def cube_20():
    return trimesh.creation.box((20, 20, 20))
