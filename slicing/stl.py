"""What slicing wants to know of an STL: whether it is one, how high it is, and what lies above a height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slicing.errors import Rule, SliceRejected

_HEADER_BYTES = 84
_FACET = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, slots=True)
class Triangles:
    """The triangles of an STL: (n, 3 corners, xyz) in mm."""

    corners: npt.NDArray[np.float64]

    @property
    def min_z_mm(self) -> float:
        return float(self.corners[..., 2].min())

    @property
    def max_z_mm(self) -> float:
        return float(self.corners[..., 2].max())

    def volume_above_mm3(self, z_mm: float) -> float:
        """Volume of a closed mesh above a height: the divergence theorem, over the shadows of its facets."""
        a, b, c = (self.corners[:, i, :2] for i in range(3))
        shadow = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2  # signed, mm2
        height = np.sort(self.corners[..., 2] - z_mm, axis=1)
        mean = np.clip(height, 0, None).mean(axis=1)  # right for facets on one side
        one = (height[:, 2] > 0) & (height[:, 1] <= 0)  # a corner of it is above
        two = (height[:, 1] > 0) & (height[:, 0] < 0)  # a corner of it is below
        mean[one] = _corner(height[one, 2], height[one, 1], height[one, 0])
        below = -height[two]
        mean[two] = height[two].mean(axis=1) + _corner(below[:, 0], below[:, 1], below[:, 2])
        return float((shadow * mean).sum())


def _corner(
    top: npt.NDArray[np.float64], other: npt.NDArray[np.float64], another: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Mean over a triangle of the height above 0, where only one of its corners is above."""
    return top**3 / (3 * (top - other) * (top - another))


def read_stl(stl: bytes) -> Triangles:
    """Read a binary STL.

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
    corners = np.frombuffer(stl, _FACET, offset=_HEADER_BYTES)["vertices"].astype(np.float64)
    if not np.isfinite(corners).all():
        raise SliceRejected(Rule.BROKEN_MESH, "the STL has a coordinate that is not a finite number")
    return Triangles(corners)


def scale_stl_xy(stl: bytes, share: float) -> bytes:
    """A binary STL that is wider and deeper by a share of its size, about X 0, Y 0."""
    facets = np.frombuffer(stl, _FACET, offset=_HEADER_BYTES).copy()
    facets["vertices"][..., :2] *= 1.0 + share
    return stl[:_HEADER_BYTES] + facets.tobytes()


def binary_stl(corners: npt.NDArray[np.float64]) -> bytes:
    """A binary STL of triangles (n, 3, 3); its normals are left to whoever reads it."""
    facets = np.zeros(len(corners), _FACET)
    facets["vertices"] = corners
    return bytes(_HEADER_BYTES - 4) + len(corners).to_bytes(4, "little") + facets.tobytes()
