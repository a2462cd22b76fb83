"""Choice among the places of keys."""

from __future__ import annotations

import numpy as np
import pytest

from decompose.connectors.keys import KeyPlacer
from decompose.connectors.keys.placer import _find_largest


@pytest.mark.parametrize("count", [1, 5, 20, 60])
def test_largest_values_are_those_of_a_stable_sort(count):
    values = np.random.default_rng(count).integers(0, 8, 50).astype(np.float64)
    assert _find_largest(values, count) == np.argsort(-values, kind="stable")[:count].tolist()


@pytest.mark.parametrize("used_mm", [(), (30.0,), (50.0, 30.0, 31.0)])
def test_distances_differ_from_all_used_ones(used_mm):
    placer = KeyPlacer(None, [], np.zeros((0, 3)), [], used_mm, 1.5)
    separations_mm = np.arange(0.0, 80.0, 0.25).reshape(4, -1)
    expected = np.array([all(abs(s - u) > 1.5 for u in used_mm) for s in separations_mm.ravel()])
    assert (placer._differs_from_used_distances(separations_mm).ravel() == expected).all()
