"""Make the example model: a Roman aqueduct of three tiers, 330 mm long, as an STL.

Usage: python examples/make_aqueduct.py OUT.stl
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from decompose.errors import DecomposeError
from decompose.geometry import Solid, round_triangles, write_stl

LENGTH_MM = 330.0
# Each tier: floor, height, depth, number of arches, width of a pier between two, height of its arches' feet.
TIERS = (
    (0.0, 76.0, 27.0, 5, 12.0, 40.0),
    (76.0, 60.0, 22.0, 8, 8.0, 31.0),
    (136.0, 30.0, 17.0, 22, 4.2, 9.0),
)
CORNICE_MM = (3.0, 2.0)  # height, and how far it stands out
CHANNEL_MM = (8.0, 8.0)  # width and depth of the water channel on top


def prism(outline: list[tuple[float, float]], half_depth_mm: float) -> Solid:
    """Extrude a convex outline in (x, z), counter-clockwise seen from -y, along y to both sides."""
    n = len(outline)
    vertices = [(x, y, z) for y in (-half_depth_mm, half_depth_mm) for x, z in outline]
    faces = []
    for i in range(1, n - 1):
        faces += [(0, i, i + 1), (n, n + i + 1, n + i)]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, n + i, n + j), (i, n + j, j)]
    return Solid.from_arrays(np.array(vertices), np.array(faces))


def opening(left: float, right: float, floor: float, spring: float, segments: int, depth: float) -> Solid:
    """Make an arched opening: upright to the spring line, a half circle above."""
    radius, middle = (right - left) / 2.0, (left + right) / 2.0
    arc = [
        (middle + radius * math.cos(a), spring + radius * math.sin(a))
        for a in np.linspace(0.0, math.pi, segments + 1)
    ]
    return prism([(left, floor), (right, floor), *arc], depth)


def cutwater(x: float, width: float, depth: float, height: float) -> Solid:
    """Make the cutwaters of a pier on both sides, their tops sloping back to the wall."""
    half, reach = width / 2.0, depth / 2.0 + 0.7 * width
    outline = [(x - half, 0.0), (x, -reach), (x + half, 0.0), (x, reach)]
    vertices = [(a, b, 0.0) for a, b in outline]
    vertices += [(a, b, height + (0.0 if b else 0.7 * width)) for a, b in outline]
    faces = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    for i in range(4):
        j = (i + 1) % 4
        faces += [(i, j, 4 + j), (i, 4 + j, 4 + i)]
    return Solid.from_arrays(np.array(vertices), np.array(faces))


def aqueduct() -> Solid:
    """Make the whole model: long along x, deep along y, standing on z = 0, in mm."""
    solids, openings = [], []
    cornice, ledge = CORNICE_MM
    for floor, height, depth, arches, pier, spring in TIERS:
        top = floor + height
        solids.append(Solid.box((0.0, -depth / 2.0, floor), (LENGTH_MM, depth / 2.0, top)))
        solids.append(
            Solid.box((0.0, -depth / 2.0 - ledge, top - cornice), (LENGTH_MM, depth / 2.0 + ledge, top))
        )
        bay = (LENGTH_MM - pier) / arches
        foot = floor if floor > 0.0 else -1.0  # the lowest openings go through to the ground
        for i in range(arches):
            left = pier + i * bay
            segments = 16 if arches < 12 else 8
            openings.append(opening(left, left + bay - pier, foot, floor + spring, segments, 40.0))
        if floor == 0.0:
            solids += [cutwater(pier / 2.0 + i * bay, pier, depth, spring) for i in range(arches + 1)]
    width, deep = CHANNEL_MM
    top = TIERS[-1][0] + TIERS[-1][1]
    channel = Solid.box((-1.0, -width / 2.0, top - deep), (LENGTH_MM + 1.0, width / 2.0, top + 1.0))
    return Solid.union(solids).subtract(Solid.union([*openings, channel]))


def main() -> int:
    parser = argparse.ArgumentParser(description="Make the example model: a Roman aqueduct of three tiers.")
    parser.add_argument("out", type=Path, metavar="OUT.stl", help="the STL file")
    out = parser.parse_args().out
    try:
        solid = aqueduct()
        corners = round_triangles(*solid.arrays())
        if corners is None:
            raise DecomposeError("the aqueduct is not closed in single precision; change its measures")
        write_stl(out, corners)
    except (DecomposeError, OSError) as error:
        print(f"{out}: {error}", file=sys.stderr)
        return 1
    size = " x ".join(f"{v:.0f}" for v in np.ptp(solid.bounds_mm, axis=0))
    print(f"{out}: an aqueduct, {size} mm, {solid.volume_mm3 / 1000.0:.0f} cm3")
    return 0


if __name__ == "__main__":
    sys.exit(main())
