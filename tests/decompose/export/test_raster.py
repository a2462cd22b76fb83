"""Drawing of triangles: depth, light and outlines."""

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


def draw_plate_and_cube(oversampling: int, long_side_px: int = 100) -> Drawing:
    """Draw a plate of 40 x 20 mm from above, with a cube of 10 mm at its centre."""
    plate = trimesh.creation.box((40.0, 20.0, 1.0)).triangles
    cube = trimesh.creation.box((10.0, 10.0, 10.0)).triangles + np.array([0.0, 0.0, 5.5])
    shapes = [Shape(plate, COLOUR), Shape(cube, np.array([0.9, 0.9, 0.9]))]
    return draw_shapes(shapes, make_camera(-90.0, 90.0), long_side_px, oversampling)


@pytest.mark.parametrize("oversampling", [1, 2, 3])
def test_horizontal_faces_have_their_colour_in_the_light(oversampling: int) -> None:
    drawing = draw_plate_and_cube(oversampling)
    shade = AMBIENT_SHARE + (1.0 - AMBIENT_SHARE) * LIGHT_DIRECTION[2]
    column, row = drawing.find_pixels(np.array([[-12.0, 0.0, 0.5]]))[0].astype(int)
    pixel = drawing.pixels[oversampling * row, oversampling * column]
    assert pixel == pytest.approx(255.0 * shade * COLOUR, abs=0.5)
    assert (drawing.pixels[0, 0] == 255).all()
    assert drawing.oversampling == oversampling


def test_outlines_are_drawn_only_at_steps_in_depth() -> None:
    drawing = draw_plate_and_cube(1)
    shade = (AMBIENT_SHARE + (1.0 - AMBIENT_SHARE) * LIGHT_DIRECTION[2]) * COLOUR[2]
    row = int(drawing.find_pixels(np.array([[0.0, 0.0, 0.5]]))[0, 1])
    blue = drawing.pixels[row, drawing.front_shapes[row] == 1, 2] / 255.0
    is_outline = blue < shade * (1.0 + OUTLINE_BRIGHTNESS) / 2.0
    assert blue[is_outline] == pytest.approx(shade * OUTLINE_BRIGHTNESS, abs=0.002)
    assert blue[~is_outline] == pytest.approx(shade, abs=0.002)
    # The rim of the plate and its edges beside the cube are outlined, but not its middle.
    assert is_outline[0] and is_outline[-1] and 4 <= is_outline.sum() <= 6
