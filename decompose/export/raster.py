"""Rasterisation of triangles with flat shading, and with outlines where the depth changes abruptly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decompose.arrays import Floats, Ints
from decompose.geometry.rays import find_bounds
from decompose.jit import jit

Pixels = npt.NDArray[np.uint8]

# Direction towards the light: right, up, and towards the eye.
LIGHT_DIRECTION = np.array([-0.25, 0.62, 0.74]) / np.linalg.norm([-0.25, 0.62, 0.74])
AMBIENT_SHARE = 0.5
OUTLINE_BRIGHTNESS = 0.6  # brightness of an outline, as a share of the brightness of its shape
MARGIN_SHARE = 0.04  # margin as a share of the longer side
OUTLINE_DEPTH_SHARE = 0.012  # minimum jump of depth at an outline, as a share of the scene's depth


@jit
def _rasterise_triangles(triangles: Floats, depth: Floats, front_triangles: Ints) -> None:
    """Draw triangles into a depth buffer.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 corners in pixels, z towards the eye.
    depth, front_triangles
        (height, width) float64 z, and (height, width) int64 index, of the triangle in front; updated in
        place.
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
        # Barycentric coordinates and z are linear in x and y.
        inverse = 1.0 / doubled_area
        u_x, u_y = (b[1] - c[1]) * inverse, (c[0] - b[0]) * inverse
        v_x, v_y = (c[1] - a[1]) * inverse, (a[0] - c[0]) * inverse
        z_x, z_y = u_x * (a[2] - c[2]) + v_x * (b[2] - c[2]), u_y * (a[2] - c[2]) + v_y * (b[2] - c[2])
        for y in range(y0, y1 + 1):
            u0, v0, z0 = u_y * (y - c[1]), v_y * (y - c[1]), c[2] + z_y * (y - c[1])
            for x in range(x0, x1 + 1):
                u, v = u0 + u_x * (x - c[0]), v0 + v_x * (x - c[0])
                if u < 0.0 or v < 0.0 or u + v > 1.0:
                    continue
                z = z0 + z_x * (x - c[0])
                if z > depth[y, x]:
                    depth[y, x] = z
                    front_triangles[y, x] = t


@jit
def _project_triangles(triangles: Floats, frame: Floats, projected_triangles: Floats, shades: Floats) -> None:
    """Transform triangles into the frame of a camera, and compute their brightness in the light.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 corners in mm.
    frame
        (3, 3) float64 directions to the right, up, and towards the eye, as rows.
    projected_triangles
        (m, 3, 3) float64 corners in the frame; filled in.
    shades
        (m,) float64 brightness from 0 to 1; filled in.
    """
    normal = np.zeros(3)
    for t in range(len(triangles)):
        for corner in range(3):
            for axis in range(3):
                projected_triangles[t, corner, axis] = (
                    frame[axis, 0] * triangles[t, corner, 0]
                    + frame[axis, 1] * triangles[t, corner, 1]
                    + frame[axis, 2] * triangles[t, corner, 2]
                )
        a, b, c = projected_triangles[t, 0], projected_triangles[t, 1], projected_triangles[t, 2]
        for axis in range(3):
            j, k = (axis + 1) % 3, (axis + 2) % 3
            normal[axis] = (b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j])
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        light = 0.0
        if length > 0.0:
            for axis in range(3):
                light += normal[axis] / length * LIGHT_DIRECTION[axis]
        shades[t] = AMBIENT_SHARE + (1.0 - AMBIENT_SHARE) * min(max(light, 0.0), 1.0)


@jit
def _colour_pixels(front_triangles: Ints, depth: Floats, colours: Floats, jump_px: float) -> Pixels:
    """Colour the pixels of the triangles in front, and darken those at jumps of depth.

    Parameters
    ----------
    front_triangles, depth
        (height, width) int64 index, and (height, width) float64 z in pixels, of the triangle in front; -1 and
        -inf where nothing is drawn.
    colours
        (m, 3) float64 colours of the triangles from 0 to 1.
    jump_px
        Minimum jump of depth in pixels that gets an outline.

    Returns
    -------
    ndarray
        (height, width, 3) uint8, white where nothing is drawn.
    """
    height, width = depth.shape
    lowest = np.inf
    for y in range(height):
        for x in range(width):
            if front_triangles[y, x] >= 0:
                lowest = min(lowest, depth[y, x])
    background = lowest - 2.0 * jump_px
    picture = np.full((height, width, 3), 255, np.uint8)
    for y in range(height):
        for x in range(width):
            t = front_triangles[y, x]
            if t < 0:
                continue
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
            brightness = (
                OUTLINE_BRIGHTNESS if abs(vertical_jump) > jump_px or abs(horizontal_jump) > jump_px else 1.0
            )
            for channel in range(3):
                picture[y, x, channel] = np.uint8(255.0 * brightness * colours[t, channel] + 0.5)
    return picture


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Triangles (m, 3, 3) in mm, facing outward, and their colour (3,): red, green and blue from 0 to 1."""

    triangles: Floats
    colour: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """A picture of shapes; its first row is at the bottom.

    Attributes
    ----------
    pixels
        (oversampling * h, oversampling * w, 3) uint8 colours of a buffer; each pixel of the picture is a
        square of `oversampling` by `oversampling` buffer pixels.
    front_shapes
        (h, w) int64: 1 + the number of the shape in front; 0 for none.
    frame
        (3, 3) directions to the right, up, and towards the eye, as rows.
    origin_mm, pixels_per_mm
        Coordinates (2,) of the picture's lower left corner in the frame, and the scale of `front_shapes`.
    """

    pixels: Pixels
    front_shapes: Ints
    frame: Floats
    origin_mm: Floats
    pixels_per_mm: float

    @property
    def oversampling(self) -> int:
        """Number of buffer pixels along each side of a picture pixel."""
        return len(self.pixels) // len(self.front_shapes)

    def find_pixels(self, points: Floats) -> Floats:
        """Find the column and the row (n, 2) of points (n, 3) in the picture, in pixels."""
        pixels: Floats = ((points @ self.frame.T)[:, :2] - self.origin_mm) * self.pixels_per_mm
        return pixels


def make_camera(azimuth_deg: float, elevation_deg: float) -> Floats:
    """Make the frame of a camera.

    Parameters
    ----------
    azimuth_deg, elevation_deg
        Direction towards the eye: angle from x about z, and angle above the horizontal plane.

    Returns
    -------
    ndarray
        (3, 3) directions to the right, up, and towards the eye, as rows.
    """
    azimuth_rad, elevation_rad = np.radians(azimuth_deg), np.radians(elevation_deg)
    eye = np.array(
        [
            np.cos(elevation_rad) * np.cos(azimuth_rad),
            np.cos(elevation_rad) * np.sin(azimuth_rad),
            np.sin(elevation_rad),
        ]
    )
    right = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    return np.stack([right, np.cross(eye, right), eye])


def draw_shapes(shapes: Sequence[Shape], frame: Floats, long_side_px: int, oversampling: int = 2) -> Drawing:
    """Draw shapes without perspective.

    Parameters
    ----------
    shapes
        Shapes in one frame, with at least one triangle.
    frame
        Camera from `make_camera`.
    long_side_px
        Longer side of the picture without its margin, in pixels.
    oversampling
        As in `Drawing`.
    """
    ends = np.cumsum([0, *(len(shape.triangles) for shape in shapes)])
    triangles, shades = np.empty((ends[-1], 3, 3)), np.empty(ends[-1])
    owners = np.zeros(1 + ends[-1], dtype=np.int64)  # number of the shape of each triangle; 0 for none
    colours = np.empty((ends[-1], 3))
    for i, (shape, begin, end) in enumerate(zip(shapes, ends, ends[1:], strict=False), 1):
        _project_triangles(
            np.ascontiguousarray(shape.triangles), frame, triangles[begin:end], shades[begin:end]
        )
        owners[1 + begin : 1 + end] = i
        colours[begin:end] = shades[begin:end, None] * shape.colour
    low_mm, high_mm = find_bounds(triangles)
    margin_mm = MARGIN_SHARE * float((high_mm - low_mm)[:2].max())
    px_per_mm = oversampling * long_side_px / (float((high_mm - low_mm)[:2].max()) + 2.0 * margin_mm)
    size_px = (
        np.ceil((high_mm - low_mm + 2.0 * margin_mm) * px_per_mm / oversampling).astype(int) * oversampling
    )
    depth = np.full((size_px[1], size_px[0]), -np.inf)
    front_triangles = np.full((size_px[1], size_px[0]), -1)
    _rasterise_triangles((triangles - low_mm + margin_mm) * px_per_mm, depth, front_triangles)
    outline_jump_px = OUTLINE_DEPTH_SHARE * float(high_mm[2] - low_mm[2]) * px_per_mm
    return Drawing(
        pixels=_colour_pixels(front_triangles, depth, colours, outline_jump_px),
        front_shapes=owners[front_triangles[::oversampling, ::oversampling] + 1],
        frame=frame,
        origin_mm=low_mm[:2] - margin_mm,
        pixels_per_mm=px_per_mm / oversampling,
    )
