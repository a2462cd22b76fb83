"""The little that slicing wants to know of an STL: that it is one, and how high it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slicing.errors import Rule, SliceRejected

_HEADER_BYTES = 84
_FACET = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])


class Extent(NamedTuple):
    """Lowest and highest Z of a mesh in mm."""

    min_z_mm: float
    max_z_mm: float


def z_extent(stl: bytes) -> Extent:
    """Lowest and highest Z of a binary STL.

    Raises
    ------
    SliceRejected
        `BROKEN_MESH` where it is no binary STL, cut short, without facets, or with a number not finite.
    """
    if len(stl) < _HEADER_BYTES:
        raise SliceRejected(Rule.BROKEN_MESH, f"{len(stl)} bytes are no binary STL")
    facets = int.from_bytes(stl[80:84], "little")
    if len(stl) != _HEADER_BYTES + facets * _FACET.itemsize:
        raise SliceRejected(
            Rule.BROKEN_MESH,
            f"not a binary STL, or cut short: it names {facets} facets and has {len(stl)} bytes",
        )
    if facets == 0:
        raise SliceRejected(Rule.BROKEN_MESH, "the STL has no facets")
    vertices = np.frombuffer(stl, _FACET, offset=_HEADER_BYTES)["vertices"]
    if not np.isfinite(vertices).all():
        raise SliceRejected(Rule.BROKEN_MESH, "the STL has a coordinate that is not a finite number")
    return Extent(float(vertices[..., 2].min()), float(vertices[..., 2].max()))
