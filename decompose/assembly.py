"""The assembly picture: the parts, pulled apart, one colour each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from decompose.report import Part

Floats = npt.NDArray[np.float64]

MAX_TRIANGLES = 250_000  # drawn; beyond that every n-th of the smallest would not be seen anyway
EXPLODE = 0.28  # how far parts move from the middle, as a share of their distance to it


def draw_assembly(parts: Sequence[Part], path: Path, size_px: int = 1100) -> None:
    """Write a PNG of the parts, exploded, seen from the front right and above."""
    view, up = _camera(azimuth_deg=-58.0, elevation_deg=22.0)
    right = np.cross(up, view)
    right /= np.linalg.norm(right)
    above = np.cross(view, right)
    frame = np.stack([right, above, view])  # rows: screen x, screen y, towards the eye
    light = np.array([0.35, 0.65, 0.68]) / np.linalg.norm([0.35, 0.65, 0.68])
    lo = np.min([p.solid.bounds_mm[0] for p in parts], axis=0)
    hi = np.max([p.solid.bounds_mm[1] for p in parts], axis=0)
    middle = (lo + hi) / 2.0
    polygons, colours, depths = [], [], []
    palette = colormaps["tab20" if len(parts) > 10 else "tab10"]
    for i, part in enumerate(parts):
        vertices, faces = part.solid.arrays()
        away = EXPLODE * (part.solid.bounds_mm.mean(axis=0) - middle)
        seen = (vertices + away - middle) @ frame.T
        triangles = seen[faces]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        length = np.linalg.norm(normal, axis=1)
        front = (normal[:, 2] > 0.0) & (length > 0.0)
        triangles, normal = triangles[front], normal[front] / length[front, None]
        shade = 0.42 + 0.58 * np.clip(normal @ light, 0.0, 1.0)
        base = np.array(palette(i % palette.N)[:3])
        base = 0.78 * base + 0.22 * 0.92
        polygons.append(triangles[:, :, :2])
        colours.append(np.clip(shade[:, None] * base, 0.0, 1.0))
        depths.append(triangles[:, :, 2].mean(axis=1))
    flat, colour, depth = (np.concatenate(v) for v in (polygons, colours, depths))
    order = np.argsort(depth, kind="stable")
    figure = Figure(figsize=(size_px / 100.0, size_px / 100.0), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.add_collection(
        PolyCollection(list(flat[order]), facecolors=colour[order], edgecolors=colour[order], linewidths=0.35)
    )
    least, greatest = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    margin = 0.04 * float((greatest - least).max())
    axes.set_xlim(least[0] - margin, greatest[0] + margin)
    axes.set_ylim(least[1] - margin, greatest[1] + margin)
    axes.set_aspect("equal")
    axes.set_axis_off()
    aspect = float((greatest - least)[1] / (greatest - least)[0])
    figure.set_size_inches(size_px / 100.0 * min(1.0, 1.0 / aspect), size_px / 100.0 * min(1.0, aspect))
    figure.savefig(path, metadata={"Software": None})


def _camera(azimuth_deg: float, elevation_deg: float) -> tuple[Floats, Floats]:
    """The direction towards the eye, and the world's up."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return eye, np.array([0.0, 0.0, 1.0])
