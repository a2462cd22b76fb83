"""Labels and lines on a drawing, and its PNG."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
import trimesh
from PIL import Image

from decompose.export.canvas import Canvas
from decompose.export.raster import Shape, draw_shapes, make_camera

GREEN = np.array([0.2, 0.9, 0.3])


def make_canvas(oversampling: int = 2) -> Canvas:
    """Draw a plate of 40 x 20 mm from above."""
    plate = trimesh.creation.box((40.0, 20.0, 1.0)).triangles
    return Canvas(draw_shapes([Shape(plate, GREEN)], make_camera(-90.0, 90.0), 200, oversampling))


def read_pixels(canvas: Canvas) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(canvas.encode_png())).convert("RGB")).astype(int)


@pytest.mark.parametrize("oversampling", [1, 2, 3])
def test_picture_has_the_size_of_the_drawing(oversampling: int) -> None:
    canvas = make_canvas(oversampling)
    pixels = read_pixels(canvas)
    assert pixels.shape[:2] == canvas.drawing.front_shapes.shape
    fine = canvas.drawing.pixels[::-1].astype(float)
    height, width = pixels.shape[:2]
    mean = fine.reshape(height, oversampling, width, oversampling, 3).mean(axis=(1, 3))
    assert np.abs(pixels - mean).max() <= 4  # a picture has a limited number of colours


def test_places_are_counted_from_the_lower_left_corner() -> None:
    canvas = make_canvas()
    canvas.draw_dots(np.array([[20.0, 30.0], [20.0, 30.0]]), 4.0, "red")
    rows, columns = np.nonzero((read_pixels(canvas)[:, :, 0] > 200) & (read_pixels(canvas)[:, :, 1] < 60))
    height = len(canvas.drawing.front_shapes)
    assert columns.mean() == pytest.approx(20.0, abs=0.6)
    assert height - 1 - rows.mean() == pytest.approx(30.0, abs=0.6)


def test_label_is_written_where_its_shape_is_visible() -> None:
    canvas = make_canvas()
    assert canvas.write_labels(["7", "hidden"]) == ["hidden"]
    rows, columns = np.nonzero(read_pixels(canvas).max(axis=2) < 60)
    height, width = canvas.drawing.front_shapes.shape
    assert len(rows) > 10
    assert height - 1 - rows.mean() == pytest.approx(height / 2, abs=3)
    assert (np.ptp(columns), np.ptp(rows)) < (20, 30)
    assert 0.2 * width < columns.mean() < 0.8 * width


def test_text_at_the_edge_stays_in_the_picture() -> None:
    inks = []
    for x in (100.0, 10_000.0, -10_000.0):
        canvas = make_canvas()
        canvas.write_text(x, 50.0, "5 x 2.85", 12.0, "ls")
        inks.append(int((read_pixels(canvas).max(axis=2) < 60).sum()))
    assert min(inks) > 50
    assert max(inks) < 1.2 * min(inks)


def test_arrow_points_to_its_end() -> None:
    canvas = make_canvas()
    canvas.draw_arrow(np.array([40.0, 20.0]), np.array([160.0, 20.0]), "#303030")
    is_ink = read_pixels(canvas).max(axis=2) < 80
    heights = is_ink.sum(axis=0)
    widest = int(heights.argmax())
    assert 135 < widest < 150
    assert heights[158] < heights[widest] / 2
    assert heights[60:130].max() < heights[widest] / 2
