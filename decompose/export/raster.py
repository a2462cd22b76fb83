"""Drawing of triangles into a picture: flat colours, light from one side, outlines where the depth jumps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.jit import jit

LIGHT_DIRECTION = np.array([-0.25, 0.62, 0.74]) / np.linalg.norm(
    [-0.25, 0.62, 0.74]
)  # right, up, towards the eye
AMBIENT_SHARE = 0.5
EDGE = 0.6  # brightness left on outlines
MARGIN = 0.04  # of the longer side
OUTLINE_DEPTH_SHARE = 0.012  # share of the depth of the scene from which a jump of depth is an outline


@jit
def _rasterise(
    triangles: Floats, colours: Floats, owner: Ints, image: Floats, depth: Floats, visible: Ints
) -> None:
    """Draw triangles (m, 3, 3) in pixels, z towards the eye, each in one colour (m, 3).

    image (height, width, 3), depth (height, width) and visible (height, width) are filled in: colour, z, and
    the owner (m,) of the triangle in front.
    """
    height, width = depth.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        doubled_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if doubled_area <= 0.0:  # seen from behind, or on edge
            continue
        x0 = max(0, int(np.ceil(min(a[0], b[0], c[0]))))
        x1 = min(width - 1, int(max(a[0], b[0], c[0])))
        y0 = max(0, int(np.ceil(min(a[1], b[1], c[1]))))
        y1 = min(height - 1, int(max(a[1], b[1], c[1])))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / doubled_area
                v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / doubled_area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * a[2] + v * b[2] + w * c[2]
                if z > depth[y, x]:
                    depth[y, x] = z
                    image[y, x] = colours[t]
                    visible[y, x] = owner[t]


@jit
def _reduce(image: Floats, depth: Floats, step: float, oversample: int) -> Floats:
    """Darken pixels beside which the depth jumps by more than a step, and average squares of pixels.

    image (height, width, 3) and depth (height, width), -inf where nothing is drawn, in pixels; both sides are
    multiples of oversample. Returns (height / oversample, width / oversample, 3).
    """
    height, width = depth.shape
    lowest = np.inf
    for y in range(height):
        for x in range(width):
            if depth[y, x] != -np.inf:
                lowest = min(lowest, depth[y, x])
    background = lowest - 2.0 * step
    picture = np.zeros((height // oversample, width // oversample, 3))
    share = 1.0 / oversample**2
    for y in range(height):
        for x in range(width):
            weight = share
            if depth[y, x] != -np.inf:
                doubled_depth = 2.0 * depth[y, x]
                vertical_jump = horizontal_jump = 0.0
                if 0 < y < height - 1:
                    vertical_jump = (
                        max(depth[y - 1, x], background) + max(depth[y + 1, x], background) - doubled_depth
                    )
                if 0 < x < width - 1:
                    horizontal_jump = (
                        max(depth[y, x - 1], background) + max(depth[y, x + 1], background) - doubled_depth
                    )
                if abs(vertical_jump) > step or abs(horizontal_jump) > step:
                    weight *= EDGE
            for channel in range(3):
                picture[y // oversample, x // oversample, channel] += weight * image[y, x, channel]
    return picture


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Triangles (m, 3, 3) in mm, outside first, in one colour (red, green, blue from 0 to 1)."""

    triangles: Floats
    colour: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """Picture of some shapes, its first row at the bottom.

    Attributes
    ----------
    picture
        (h, w, 3) from 0 to 1.
    visible
        (h, w): 1 + the number of the shape in front; 0 for none.
    frame
        Directions of the screen's right, its up, and the eye, as rows (3, 3).
    origin_mm, pixels_per_mm
        Of the picture's lower left corner in the frame, and the scale.
    """

    picture: Floats
    visible: Ints
    frame: Floats
    origin_mm: Floats
    pixels_per_mm: float

    def place(self, points: Floats) -> Floats:
        """Return the places (n, 2) of points (n, 3) in the picture: column and row in pixels."""
        pixels: Floats = ((points @ self.frame.T)[:, :2] - self.origin_mm) * self.pixels_per_mm
        return pixels


def make_camera(azimuth_deg: float, elevation_deg: float) -> Floats:
    """Compute the directions of the screen's right, its up, and the eye, as rows (3, 3)."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    eye = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(eye, right), eye])


def draw(shapes: Sequence[Shape], frame: Floats, longest_px: int, oversample: int = 3) -> Drawing:
    """Draw shapes without perspective.

    Parameters
    ----------
    shapes
        At least one triangle, in one frame.
    frame
        Camera of `make_camera`.
    longest_px
        Longer side of the picture without its margin, in pixels.
    oversample
        Pixels of the buffer along each side of a pixel of the picture.
    """
    screen_triangles, colours, owner = [], [], []
    for i, shape in enumerate(shapes):
        triangles = shape.triangles @ frame.T
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
        shade = AMBIENT_SHARE + (1.0 - AMBIENT_SHARE) * np.clip(normal @ LIGHT_DIRECTION, 0.0, 1.0)
        screen_triangles.append(triangles)
        colours.append(shade[:, None] * shape.colour)
        owner.append(np.full(len(triangles), i + 1))
    triangles = np.concatenate(screen_triangles)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    margin = MARGIN * float((high - low)[:2].max())
    scale = oversample * longest_px / (float((high - low)[:2].max()) + 2.0 * margin)
    size = np.ceil((high - low + 2.0 * margin) * scale / oversample).astype(int) * oversample
    image = np.ones((size[1], size[0], 3))
    depth = np.full((size[1], size[0]), -np.inf)
    visible = np.zeros((size[1], size[0]), dtype=np.int64)
    pixels = (triangles - low + margin) * scale
    _rasterise(pixels, np.concatenate(colours), np.concatenate(owner), image, depth, visible)
    step = OUTLINE_DEPTH_SHARE * float(np.ptp(triangles[:, :, 2])) * scale
    return Drawing(
        picture=_reduce(image, depth, step, oversample),
        visible=visible[::oversample, ::oversample],
        frame=frame,
        origin_mm=low[:2] - margin,
        pixels_per_mm=scale / oversample,
    )
