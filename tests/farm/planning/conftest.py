"""A file store, and a submitted bar in it."""

import pytest
import trimesh

from farm.model import JobOptions
from farm.planning.inspection.inspect_submission import inspect_model


@pytest.fixture
def files(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    return folder


@pytest.fixture
def bar(tmp_path, files):
    """A bar longer than a bed, as submitted."""
    path = tmp_path / "upload.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    return inspect_model(path, "bar.stl", JobOptions(), files)
