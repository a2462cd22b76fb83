"""3MF: triangles of the objects that its build places, in mm."""

from __future__ import annotations

from decompose.geometry.threemf.build import read_3mf

__all__ = ["read_3mf"]
