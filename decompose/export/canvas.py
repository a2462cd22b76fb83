"""Canvas: a rendered drawing on which labels and lines are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from io import BytesIO
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects

from decompose.arrays import Floats
from decompose.export.raster import Drawing

PX_PER_PT = 100.0 / 72.0
LABEL_PT, MIN_LABEL_PT = 13.0, 7.0
OUTLINE_PT = 1.25  # width of the white outline of a text, which keeps it legible on any colour
ARROW_PT, ARROW_HEAD_PT = 4.0, 13.0  # width of an arrow, and length of its head
DOT_SPACING = 2.5  # distance between the dots of a dotted line, as a multiple of the line's width
COLOUR_COUNT = 128


class Canvas:
    """A drawing at the resolution at which it was rendered, on which labels and lines are drawn.

    Positions are given as column and row in pixels of the final picture, from its lower left corner.
    """

    def __init__(self, drawing: Drawing) -> None:
        """Start with a drawing without labels."""
        self.drawing = drawing

    @cached_property
    def _image(self) -> Any:
        from PIL import Image  # slow to load

        return Image.fromarray(np.ascontiguousarray(self.drawing.pixels[::-1]))

    @cached_property
    def _draw(self) -> Any:
        from PIL import ImageDraw

        return ImageDraw.Draw(self._image)

    def _find_image_position(self, x: float, y: float) -> tuple[float, float]:
        """Convert the position of a pixel's centre to the image, whose first row is at the top."""
        scale = self.drawing.oversampling
        return (x + 0.5) * scale, self._image.height - (y + 0.5) * scale

    def write_text(
        self, x: float, y: float, text: str, size_pt: float = LABEL_PT, anchor: str = "mm", ink: str = "black"
    ) -> None:
        """Write a text with a white outline; it is moved if it would extend beyond the picture.

        Parameters
        ----------
        x, y
            Position of the anchor.
        text
            ASCII text; Pillow's own font lacks some other characters.
        size_pt
            Height of the font in pt.
        anchor
            Point of the text that is at the position: "l", "m" or "r", then "a" (top), "m" or "s" (baseline).
        ink
            Colour of the text.
        """
        scale = self.drawing.oversampling * PX_PER_PT
        font, outline_px = _load_font(round(size_pt * scale)), round(OUTLINE_PT * scale)
        position = np.array(self._find_image_position(x, y))
        bounds = np.reshape(
            self._draw.textbbox(tuple(position), text, font, anchor, stroke_width=outline_px), (2, 2)
        )
        position -= np.maximum(bounds[1] - self._image.size, 0.0)
        position += np.maximum(-bounds[0], 0.0)
        self._draw.text(
            tuple(position), text, ink, font, anchor, stroke_width=outline_px, stroke_fill="white"
        )

    def write_lines(self, x: float, y: float, lines: str, size_pt: float = LABEL_PT) -> None:
        """Write lines of text, aligned to the left; the last line is at the position."""
        for number, line in enumerate(reversed(lines.splitlines())):
            self.write_text(x, y + 1.2 * number * size_pt * PX_PER_PT, line, size_pt, "ls")

    def draw_line(self, ends: Floats, width_pt: float, ink: str) -> None:
        """Draw a line between two positions (2, 2)."""
        width_px = round(width_pt * PX_PER_PT * self.drawing.oversampling)
        self._draw.line([self._find_image_position(*end) for end in ends], ink, width_px)

    def draw_dots(self, ends: Floats, width_pt: float, ink: str) -> None:
        """Draw a dotted line between two positions (2, 2)."""
        radius_px = width_pt * PX_PER_PT / 2.0
        length_px = float(np.linalg.norm(ends[1] - ends[0]))
        count = max(2, 1 + int(length_px / (DOT_SPACING * 2.0 * radius_px)))
        for x, y in np.linspace(ends[0], ends[1], count):
            self._draw.circle(self._find_image_position(x, y), radius_px * self.drawing.oversampling, ink)

    def draw_arrow(self, start: Floats, end: Floats, ink: str) -> None:
        """Draw an arrow from one position (2,) to another."""
        length_px = float(np.linalg.norm(end - start))
        if length_px < 1.0:
            return
        along = (end - start) / length_px
        across = np.array([-along[1], along[0]])
        head_px = ARROW_HEAD_PT * PX_PER_PT
        neck = end - head_px * along
        if length_px > head_px:
            self.draw_line(np.array([start, neck]), ARROW_PT, ink)
        corners = [end, neck + head_px / 2.0 * across, neck - head_px / 2.0 * across]
        self._draw.polygon([self._find_image_position(*corner) for corner in corners], ink)

    def write_labels(self, labels: Sequence[str]) -> list[str]:
        """Write label n on shape n, where that shape is widest; return the labels of hidden shapes."""
        hidden_labels = []
        front_shapes = self.drawing.front_shapes
        windows = find_objects(front_shapes, len(labels))
        for number, (label, window) in enumerate(zip(labels, windows, strict=True), 1):
            if window is None:
                hidden_labels.append(label)
                continue
            distances_px = distance_transform_edt(np.pad(front_shapes[window] == number, 1))
            row, column = np.unravel_index(int(distances_px.argmax()), distances_px.shape)
            size_pt = float(np.clip(distances_px.max() / PX_PER_PT, MIN_LABEL_PT, LABEL_PT))
            self.write_text(window[1].start + column - 1, window[0].start + row - 1, label, size_pt)
        return hidden_labels

    def encode_png(self, colour_count: int = COLOUR_COUNT) -> bytes:
        """Reduce the image to the size of the final picture, and encode the picture as a small PNG."""
        from PIL import Image

        file = BytesIO()
        picture = self._image.reduce(self.drawing.oversampling)
        method = Image.Quantize.MAXCOVERAGE  # half the time of the default, and files 5 % larger
        picture.quantize(colour_count, method).save(file, "PNG")
        return file.getvalue()


@lru_cache(maxsize=64)
def _load_font(size_px: int) -> Any:
    """Load the font that comes with Pillow."""
    from PIL import ImageFont

    return ImageFont.load_default(size_px)
