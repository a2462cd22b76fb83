"""Inspection of a submitted model in the file store."""

import numpy as np
import pytest
import trimesh

from farm.model import JobOptions
from farm.planning.inspection.inspect_submission import inspect_model, read_inspected_model


def test_stored_solid_equals_the_submitted_one(tmp_path, files):
    path = tmp_path / "upload.stl"
    trimesh.creation.icosphere(2, 0.1).export(path)
    inspection = inspect_model(path, "ball.stl", JobOptions(longest_side_mm=77.0), files)
    model = read_inspected_model(files / inspection.file)
    assert model.scale == inspection.scale == pytest.approx(385.0)
    assert np.ptp(model.solid.arrays()[0], axis=0).max() == pytest.approx(77.0, rel=1e-12)
    unscaled_ball = trimesh.creation.icosphere(2, 0.1)
    assert model.solid.volume_mm3 == pytest.approx(unscaled_ball.volume * inspection.scale**3, rel=1e-5)
