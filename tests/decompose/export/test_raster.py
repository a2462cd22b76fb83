"""Drawing of triangles: depth, light, outlines, and averages of pixels."""

import numpy as np
import pytest
import trimesh

from decompose.export.raster import (
    AMBIENT_SHARE,
    LIGHT_DIRECTION,
    OUTLINE_BRIGHTNESS,
    Drawing,
    Shape,
    draw_shapes,
    make_camera,
)

COLOUR = np.array([0.2, 0.6, 0.9])


def draw_from_above(oversample: int, longest_px: int = 100) -> Drawing:
    """Draw a plate of 40 x 20 mm from above, with a cube of 10 mm on its middle."""
    plate = trimesh.creation.box((40.0, 20.0, 1.0)).triangles
    cube = trimesh.creation.box((10.0, 10.0, 10.0)).triangles + np.array([0.0, 0.0, 5.5])
    shapes = [Shape(plate, COLOUR), Shape(cube, np.array([0.9, 0.9, 0.9]))]
    return draw_shapes(shapes, make_camera(-90.0, 90.0), longest_px, oversample)


@pytest.mark.parametrize("oversample", [1, 2, 3])
def test_level_faces_have_their_colour_in_the_light(oversample: int) -> None:
    drawing = draw_from_above(oversample)
    shade = AMBIENT_SHARE + (1.0 - AMBIENT_SHARE) * LIGHT_DIRECTION[2]
    column, row = drawing.find_pixels(np.array([[-12.0, 0.0, 0.5]]))[0].astype(int)
    assert drawing.picture[row, column] == pytest.approx(shade * COLOUR)
    assert drawing.picture[0, 0] == pytest.approx(1.0)


def test_only_jumps_of_depth_are_outlined() -> None:
    drawing = draw_from_above(1)
    shade = (AMBIENT_SHARE + (1.0 - AMBIENT_SHARE) * LIGHT_DIRECTION[2]) * COLOUR[2]
    row = int(drawing.find_pixels(np.array([[0.0, 0.0, 0.5]]))[0, 1])
    blue = drawing.picture[row, drawing.visible[row] == 1, 2]
    is_outline = blue < shade * (1.0 + OUTLINE_BRIGHTNESS) / 2.0
    assert blue[is_outline] == pytest.approx(shade * OUTLINE_BRIGHTNESS)
    assert blue[~is_outline] == pytest.approx(shade)
    # Outlines are on both sides at the rim of the plate and at its edge beside the cube, not in its middle.
    assert is_outline[0] and is_outline[-1] and 4 <= is_outline.sum() <= 6


@pytest.mark.parametrize("oversample", [2, 3])
def test_a_pixel_is_the_average_of_the_finer_picture(oversample: int) -> None:
    coarse_picture = draw_from_above(oversample).picture
    fine_picture = draw_from_above(1, 100 * oversample).picture
    height, width = (fine_picture.shape[0] // oversample, fine_picture.shape[1] // oversample)
    squares = fine_picture[: height * oversample, : width * oversample]
    average = squares.reshape(height, oversample, width, oversample, 3).mean(axis=(1, 3))
    assert coarse_picture[:height, :width] == pytest.approx(average)
