"""Disjoint sets, compared with the connected components of a graph."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from decompose.disjoint_sets import DisjointSets, join_sets

COUNT = 12
PAIRS = st.lists(st.tuples(st.integers(0, COUNT - 1), st.integers(0, COUNT - 1)), max_size=20)


def label_elements(pairs: list[tuple[int, int]]) -> tuple[int, np.ndarray]:
    first, second = np.array(pairs, np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(pairs)), (first, second)), shape=(COUNT, COUNT))
    return connected_components(graph, directed=False)


@pytest.mark.parametrize("dtype", [np.int32, np.int64])
@given(pairs=PAIRS)
def test_joins_of_different_sets_are_counted(dtype: type, pairs: list[tuple[int, int]]):
    parent = np.arange(COUNT, dtype=dtype)
    joined_count = sum(join_sets(parent, a, b) for a, b in pairs)
    assert COUNT - joined_count == label_elements(pairs)[0]


@given(pairs=PAIRS)
def test_sets_are_components_with_their_sizes(pairs: list[tuple[int, int]]):
    sets = DisjointSets(COUNT)
    for pair in pairs:
        sets.join(*pair)
    _, labels = label_elements(pairs)
    for a in range(COUNT):
        for b in range(COUNT):
            assert (sets.find(a) == sets.find(b)) == (labels[a] == labels[b])
            assert sets.compute_joined_size(a, b) == np.isin(labels, labels[[a, b]]).sum()
