"""Exploded picture of the assembly: each part in its own colour, with its number."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects

from decompose.arrays import Floats
from decompose.export.raster import Drawing, Shape, draw_shapes, make_camera
from decompose.files.names import find_part_number
from decompose.results import Part

EXPLODED_SHARE = 0.28  # movement of a part away from the middle, as a share of its distance from the middle
AZIMUTH_DEG, ELEVATION_DEG = -58.0, 22.0  # position of the eye: in front, slightly to the right and above
DPI = 100.0
LABEL_PT, SMALLEST_LABEL_PT = 13.0, 7.0
LETTER_WIDTH_PX = 10.0  # width of a letter of a label
GOLDEN_RATIO = (np.sqrt(5.0) - 1.0) / 2.0


def make_part_colours(count: int) -> Floats:
    """Make distinct colours (count, 3), red, green and blue from 0 to 1; consecutive ones differ most."""
    from matplotlib.colors import hsv_to_rgb  # slow to load

    i = np.arange(count)
    saturation, value = 0.35 + 0.15 * (i % 3), 0.95 - 0.12 * (i // 3 % 2)
    return np.asarray(hsv_to_rgb(np.stack([(0.58 + GOLDEN_RATIO * i) % 1.0, saturation, value], axis=1)))


def draw_assembly(parts: Sequence[Part], path: Path, longest_px: int = 1100) -> None:
    """Write a PNG of the parts, exploded, each with the number in its id; hidden parts are listed below.

    Parameters
    ----------
    parts
        Parts in the model's frame, in mm; at least one.
    path
        File to write.
    longest_px
        Longer side of the picture without its margin, in pixels.
    """
    lo_mm = np.min([p.solid.bounds_mm[0] for p in parts], axis=0)
    hi_mm = np.max([p.solid.bounds_mm[1] for p in parts], axis=0)
    middle_mm = (lo_mm + hi_mm) / 2.0
    shapes = []
    for part, colour in zip(parts, make_part_colours(len(parts)), strict=True):
        vertices, faces = part.solid.arrays()
        offset_mm = EXPLODED_SHARE * (part.solid.bounds_mm.mean(axis=0) - middle_mm)
        shapes.append(Shape((vertices + offset_mm - middle_mm)[faces], colour))
    drawing = draw_shapes(shapes, make_camera(AZIMUTH_DEG, ELEVATION_DEG), longest_px)
    figure, axes = make_figure(drawing)
    hidden_labels = write_labels(axes, drawing, [find_part_number(part.id) for part in parts])
    if hidden_labels:
        lines = fill(
            f"behind: {', '.join(hidden_labels)}", max(20, int(drawing.visible.shape[1] / LETTER_WIDTH_PX))
        )
        axes.text(
            0.01, 0.01, lines, transform=axes.transAxes, fontsize=LABEL_PT, path_effects=make_white_outline()
        )
    figure.savefig(path)


def make_figure(drawing: Drawing) -> tuple[Any, Any]:
    """Make a matplotlib figure of a drawing; return the figure and its axes, which are in pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to load
    from matplotlib.figure import Figure

    height_px, width_px = drawing.visible.shape
    figure = Figure(figsize=(width_px / DPI, height_px / DPI), dpi=DPI)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    picture = np.rint(255.0 * drawing.picture).astype(np.uint8)
    axes.imshow(picture, origin="lower", interpolation="none", aspect="auto")
    return figure, axes


def write_labels(axes: Any, drawing: Drawing, labels: Sequence[str]) -> list[str]:
    """Write labels on the first shapes where they are most visible; return the labels of hidden shapes.

    Parameters
    ----------
    axes
        Axes of `make_figure`.
    drawing
        Drawing of the shapes.
    labels
        Labels of the first shapes, in their order.
    """
    hidden_labels = []
    windows = find_objects(drawing.visible, len(labels))
    for number, (label, window) in enumerate(zip(labels, windows, strict=True), 1):
        if window is None:
            hidden_labels.append(label)
            continue
        distances_px = distance_transform_edt(np.pad(drawing.visible[window] == number, 1))
        row, column = np.unravel_index(int(distances_px.argmax()), distances_px.shape)
        label_pt = float(np.clip(distances_px.max() * 72.0 / DPI, SMALLEST_LABEL_PT, LABEL_PT))
        axes.text(
            window[1].start + column - 1, window[0].start + row - 1, label,
            ha="center", va="center", fontsize=label_pt, weight="bold", path_effects=make_white_outline(),
        )  # fmt: skip
    return hidden_labels


def make_white_outline() -> list[Any]:
    """Make the text effect that keeps a label legible on any colour."""
    from matplotlib.patheffects import withStroke  # slow to load

    return [withStroke(linewidth=2.5, foreground="white")]


def encode_png(figure: Any) -> bytes:
    """Encode a figure as a small PNG with 128 colours."""
    from PIL import Image  # comes with matplotlib; slow to load

    figure.canvas.draw()
    file = BytesIO()
    picture = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3])
    picture.quantize(128).save(file, "PNG", optimize=True)
    return file.getvalue()
