"""Choice among the places of keys."""

from __future__ import annotations

import numpy as np
import pytest

from decompose.connectors.keys.placer import _find_largest


@pytest.mark.parametrize("count", [1, 5, 20, 60])
def test_largest_values_are_those_of_a_stable_sort(count):
    values = np.random.default_rng(count).integers(0, 8, 50).astype(np.float64)
    assert _find_largest(values, count) == np.argsort(-values, kind="stable")[:count].tolist()
