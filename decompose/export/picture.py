"""Picture of the assembly: the parts pulled apart, each in its colour with its number."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects

from decompose.arrays import Floats, Ints
from decompose.jit import jit
from decompose.results import Part

EXPLODE = 0.28  # move of parts from the middle, as a share of their distance to it
OVERSAMPLE = 3  # pixels of the buffer along each side of a pixel of the picture
AZIMUTH_DEG, ELEVATION_DEG = -58.0, 22.0  # the eye: from the front, a little from the right and above
LIGHT = np.array([-0.25, 0.62, 0.74]) / np.linalg.norm([-0.25, 0.62, 0.74])  # right, up, towards the eye
AMBIENT = 0.5
EDGE = 0.6  # brightness left on outlines
DPI = 100.0
LABEL_PT, SMALLEST_LABEL_PT = 13.0, 7.0
LABEL_PX = 10.0  # width of a letter of a label
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


@jit
def _rasterise(
    triangles: Floats, colours: Floats, owner: Ints, image: Floats, depth: Floats, visible: Ints
) -> None:
    """Draw triangles (m, 3, 3) in pixels, z towards the eye, each in one colour (m, 3).

    image (height, width, 3), depth (height, width) and seen (height, width) are filled in: colour, z, and the
    owner (m,) of the triangle in front.
    """
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
                    visible[y, x] = owner[t]


def part_colours(count: int) -> Floats:
    """Choose colours (count, 3), red, green and blue from 0 to 1: no two alike, and neighbours far apart."""
    from matplotlib.colors import hsv_to_rgb  # slow to load

    i = np.arange(count)
    saturation, value = 0.35 + 0.15 * (i % 3), 0.95 - 0.12 * (i // 3 % 2)
    return np.asarray(hsv_to_rgb(np.stack([(0.58 + GOLDEN * i) % 1.0, saturation, value], axis=1)))


def draw_assembly(parts: Sequence[Part], path: Path, longest_px: int = 1100) -> None:
    """Write a PNG of the parts, exploded, each with the number in its id; those behind others are named.

    Parameters
    ----------
    parts
        In the model's frame, in mm; at least one.
    path
        File to write.
    longest_px
        Longer side of the picture without its margin, in pixels.
    """
    frame = _camera()
    lo = np.min([p.solid.bounds_mm[0] for p in parts], axis=0)
    hi = np.max([p.solid.bounds_mm[1] for p in parts], axis=0)
    middle = (lo + hi) / 2.0
    shapes, colours, owner = [], [], []
    for i, (part, base) in enumerate(zip(parts, part_colours(len(parts)), strict=True)):
        vertices, faces = part.solid.arrays()
        offset_mm = EXPLODE * (part.solid.bounds_mm.mean(axis=0) - middle)
        triangles = ((vertices + offset_mm - middle) @ frame.T)[faces]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
        shade = AMBIENT + (1.0 - AMBIENT) * np.clip(normal @ LIGHT, 0.0, 1.0)
        shapes.append(triangles)
        colours.append(shade[:, None] * base)
        owner.append(np.full(len(triangles), i + 1))
    triangles = np.concatenate(shapes)
    least, greatest = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    margin = 0.04 * float((greatest - least)[:2].max())
    scale = OVERSAMPLE * longest_px / (float((greatest - least)[:2].max()) + 2.0 * margin)
    size = np.ceil((greatest - least + 2.0 * margin) * scale / OVERSAMPLE).astype(int) * OVERSAMPLE
    image = np.ones((size[1], size[0], 3))
    depth = np.full((size[1], size[0]), -np.inf)
    visible = np.zeros((size[1], size[0]), dtype=np.int64)
    placed = (triangles - least + margin) * scale
    _rasterise(placed, np.concatenate(colours), np.concatenate(owner), image, depth, visible)
    _outline(image, depth, step=0.012 * float(np.ptp(triangles[:, :, 2])) * scale)
    picture = image.reshape(size[1] // OVERSAMPLE, OVERSAMPLE, size[0] // OVERSAMPLE, OVERSAMPLE, 3)
    _write(picture.mean(axis=(1, 3)), visible[::OVERSAMPLE, ::OVERSAMPLE], [p.id for p in parts], path)


def _write(picture: Floats, visible: Ints, names: Sequence[str], path: Path) -> None:
    """Write the picture (h, w, 3), first row at the bottom, with each part's name where it is seen most."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to load
    from matplotlib.figure import Figure
    from matplotlib.patheffects import withStroke

    height, width = visible.shape
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.imshow(picture, origin="lower", interpolation="none", aspect="auto")
    outline = [withStroke(linewidth=2.5, foreground="white")]
    hidden = []
    for number, (name, window) in enumerate(zip(names, find_objects(visible, len(names)), strict=True), 1):
        label = name.lstrip("p").lstrip("0") or name
        if window is None:
            hidden.append(label)
            continue
        room = distance_transform_edt(np.pad(visible[window] == number, 1))
        row, column = np.unravel_index(int(room.argmax()), room.shape)
        points = float(np.clip(room.max() * 72.0 / DPI, SMALLEST_LABEL_PT, LABEL_PT))
        axes.text(
            window[1].start + column - 1, window[0].start + row - 1, label,
            ha="center", va="center", fontsize=points, weight="bold", path_effects=outline,
        )  # fmt: skip
    if hidden:
        lines = fill(f"behind: {', '.join(hidden)}", max(20, int(width / LABEL_PX)))
        axes.text(0.01, 0.01, lines, transform=axes.transAxes, fontsize=LABEL_PT, path_effects=outline)
    figure.savefig(path)


def _outline(image: Floats, depth: Floats, step: float) -> None:
    """Darken pixels beside which the depth jumps by more than a step."""
    filled = np.where(np.isfinite(depth), depth, depth[np.isfinite(depth)].min() - 2.0 * step)
    jump = np.zeros(depth.shape, dtype=np.bool_)
    jump[1:-1] |= np.abs(filled[2:] + filled[:-2] - 2.0 * filled[1:-1]) > step
    jump[:, 1:-1] |= np.abs(filled[:, 2:] + filled[:, :-2] - 2.0 * filled[:, 1:-1]) > step
    image[jump & np.isfinite(depth)] *= EDGE


def _camera() -> Floats:
    """Compute the directions of the screen's right, its up, and the eye, as rows (3, 3)."""
    azimuth, elevation = np.radians(AZIMUTH_DEG), np.radians(ELEVATION_DEG)
    eye = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(eye, right), eye])
