"""Disjoint sets (union-find): elements that belong together, joined pair by pair."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from decompose.jit import jit


@jit
def join_sets(parent: npt.NDArray[np.signedinteger[Any]], a: int, b: int) -> int:
    """Join the sets of two elements; return 1 if the sets were different, else 0.

    Parameters
    ----------
    parent
        (elements,) int32 or int64 parents of the elements in a forest, updated in place; a root is its own
        parent.
    a, b
        Numbers of the elements.
    """
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    while parent[b] != b:
        parent[b] = parent[parent[b]]
        b = parent[b]
    if a == b:
        return 0
    if a < b:
        parent[b] = a
    else:
        parent[a] = b
    return 1


class DisjointSets:
    """Disjoint sets of the elements 0 to `count` - 1, with the size of each set."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))
        self._size = [1] * count

    def find(self, element: int) -> int:
        """Find the root of an element's set."""
        while self._parent[element] != element:
            self._parent[element] = self._parent[self._parent[element]]
            element = self._parent[element]
        return element

    def join(self, a: int, b: int) -> None:
        """Join the sets of two elements."""
        a, b = sorted((self.find(a), self.find(b)))
        if a != b:
            self._parent[b] = a
            self._size[a] += self._size[b]

    def compute_joined_size(self, *elements: int) -> int:
        """Compute the size of the set that would result if the sets of these elements were joined."""
        return sum(self._size[root] for root in {self.find(element) for element in elements})
