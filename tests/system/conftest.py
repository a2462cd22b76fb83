"""Fixtures that make farms for system tests, and end them after the test."""

from __future__ import annotations

import pytest
import trimesh

from farms.real_farm import RealFarm


@pytest.fixture
def make_farm(tmp_path):
    """Return a function that makes a farm of {name: (model, port)} without starting it; end all farms."""
    farms = []

    def make(printers):
        farms.append(RealFarm(tmp_path, printers))
        return farms[-1]

    yield make
    for farm in farms:
        farm.end()


@pytest.fixture
def farm(make_farm):
    """Start a farm of two simulated printers."""
    model = "ultimaker2_plus"
    farm = make_farm({"one": (model, f"sim://{model}?seed=1"), "two": (model, f"sim://{model}?seed=2")})
    farm.up()
    return farm


@pytest.fixture(scope="session")
def bar(tmp_path_factory):
    """Write a model that is longer than a bed, and that two printers print in a few hundred moves."""
    path = tmp_path_factory.mktemp("models") / "bar.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    return path
