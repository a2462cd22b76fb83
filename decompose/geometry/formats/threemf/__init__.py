"""Reader of 3MF files: the triangles, in mm, of the objects that their build places."""

from __future__ import annotations

from decompose.geometry.formats.threemf.build import read_3mf

__all__ = ["read_3mf"]
