"""File store with a submitted bar."""

import pytest
import trimesh

from decompose.export import files as decomposition_files
from farm.model import JobOptions
from farm.planning.inspection.inspect_submission import inspect_model


@pytest.fixture
def files(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    return folder


@pytest.fixture
def bar(tmp_path, files):
    """Submit a bar that is longer than a bed."""
    path = tmp_path / "upload.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    return inspect_model(path, "bar.stl", JobOptions(), files)


@pytest.fixture
def without_pictures(monkeypatch):
    """Write empty pictures and pages, because drawing takes as long as the search for the parts."""
    for name in ("draw_assembly", "write_instructions"):
        monkeypatch.setattr(decomposition_files, name, lambda _, path, *__: path.write_bytes(b""))
