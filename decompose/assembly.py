"""The assembly picture: the parts, pulled apart, one colour each, drawn by a small depth-buffer renderer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.image import imsave

from decompose.jit import jit

if TYPE_CHECKING:
    from decompose.report import Part

Floats = npt.NDArray[np.float64]

EXPLODE = 0.28  # how far parts move from the middle, as a share of their distance to it
OVERSAMPLE = 3  # pixels of the buffer along each side of a pixel of the picture
AZIMUTH_DEG, ELEVATION_DEG = -58.0, 22.0  # the eye: from the front, a little from the right and above
LIGHT = np.array([-0.25, 0.62, 0.74]) / np.linalg.norm([-0.25, 0.62, 0.74])  # right, up, towards the eye
AMBIENT = 0.5
EDGE = 0.6  # brightness left on outlines


@jit
def _rasterise(triangles: Floats, colours: Floats, image: Floats, depth: Floats) -> None:
    """Draw triangles (m, 3, 3) in pixels, z towards the eye, each in one colour (m, 3)."""
    height, width = depth.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        whole = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if whole <= 0.0:  # seen from behind, or on edge
            continue
        x0 = max(0, int(np.ceil(min(a[0], b[0], c[0]))))
        x1 = min(width - 1, int(max(a[0], b[0], c[0])))
        y0 = max(0, int(np.ceil(min(a[1], b[1], c[1]))))
        y1 = min(height - 1, int(max(a[1], b[1], c[1])))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / whole
                v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / whole
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * a[2] + v * b[2] + w * c[2]
                if z > depth[y, x]:
                    depth[y, x] = z
                    image[y, x] = colours[t]


def draw_assembly(parts: Sequence[Part], path: Path, longest_px: int = 1100) -> None:
    """Write a PNG of the parts, exploded."""
    frame = _camera()
    lo = np.min([p.solid.bounds_mm[0] for p in parts], axis=0)
    hi = np.max([p.solid.bounds_mm[1] for p in parts], axis=0)
    middle = (lo + hi) / 2.0
    palette = colormaps["tab20" if len(parts) > 10 else "tab10"]
    seen, colours = [], []
    for i, part in enumerate(parts):
        vertices, faces = part.solid.arrays()
        away = EXPLODE * (part.solid.bounds_mm.mean(axis=0) - middle)
        triangles = ((vertices + away - middle) @ frame.T)[faces]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
        shade = AMBIENT + (1.0 - AMBIENT) * np.clip(normal @ LIGHT, 0.0, 1.0)
        base = 0.78 * np.array(palette(i % palette.N)[:3]) + 0.2
        seen.append(triangles)
        colours.append(np.clip(shade[:, None] * base, 0.0, 1.0))
    triangles = np.concatenate(seen)
    least, greatest = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    margin = 0.03 * float((greatest - least)[:2].max())
    scale = OVERSAMPLE * longest_px / (float((greatest - least)[:2].max()) + 2.0 * margin)
    size = np.ceil((greatest - least + 2.0 * margin) * scale / OVERSAMPLE).astype(int) * OVERSAMPLE
    image = np.ones((size[1], size[0], 3))
    depth = np.full((size[1], size[0]), -np.inf)
    _rasterise((triangles - least + margin) * scale, np.concatenate(colours), image, depth)
    _outline(image, depth, step=0.012 * float(np.ptp(triangles[:, :, 2])) * scale)
    picture = image.reshape(size[1] // OVERSAMPLE, OVERSAMPLE, size[0] // OVERSAMPLE, OVERSAMPLE, 3)
    imsave(path, np.flipud(picture.mean(axis=(1, 3))))


def _outline(image: Floats, depth: Floats, step: float) -> None:
    """Darken pixels beside which the depth jumps by more than a step."""
    filled = np.where(np.isfinite(depth), depth, depth[np.isfinite(depth)].min() - 2.0 * step)
    jump = np.zeros(depth.shape, dtype=np.bool_)
    jump[1:-1] |= np.abs(filled[2:] + filled[:-2] - 2.0 * filled[1:-1]) > step
    jump[:, 1:-1] |= np.abs(filled[:, 2:] + filled[:, :-2] - 2.0 * filled[:, 1:-1]) > step
    image[jump & np.isfinite(depth)] *= EDGE


def _camera() -> Floats:
    """Rows: the directions of the screen's right, its up, and the eye."""
    azimuth, elevation = np.radians(AZIMUTH_DEG), np.radians(ELEVATION_DEG)
    eye = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(eye, right), eye])
