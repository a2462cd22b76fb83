"""Make the example model: a Roman aqueduct with three tiers, 330 mm long, as an STL file.

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
# Each tier: floor, height, depth, number of arches, width of a pier, height of the spring line; in mm.
TIERS = (
    (0.0, 76.0, 27.0, 5, 12.0, 40.0),
    (76.0, 60.0, 22.0, 8, 8.0, 31.0),
    (136.0, 30.0, 17.0, 22, 4.2, 9.0),
)
CORNICE_MM = (3.0, 2.0)  # height and overhang
CHANNEL_MM = (8.0, 8.0)  # width and depth of the water channel on top


def extrude_outline(outline_mm: list[tuple[float, float]], half_depth_mm: float) -> Solid:
    """Extrude a convex outline in (x, z), counter-clockwise seen from -y, along y to both sides."""
    n = len(outline_mm)
    vertices_mm = [(x, y, z) for y in (-half_depth_mm, half_depth_mm) for x, z in outline_mm]
    faces = []
    for i in range(1, n - 1):
        faces += [(0, i, i + 1), (n, n + i + 1, n + i)]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, n + i, n + j), (i, n + j, j)]
    return Solid.from_arrays(np.array(vertices_mm), np.array(faces))


def make_opening(
    left_mm: float, right_mm: float, floor_mm: float, spring_mm: float, segments: int, half_depth_mm: float
) -> Solid:
    """Make an arched opening: upright to the spring line, a half circle above."""
    radius_mm, middle_mm = (right_mm - left_mm) / 2.0, (left_mm + right_mm) / 2.0
    arc_mm = [
        (middle_mm + radius_mm * math.cos(angle_rad), spring_mm + radius_mm * math.sin(angle_rad))
        for angle_rad in np.linspace(0.0, math.pi, segments + 1)
    ]
    return extrude_outline([(left_mm, floor_mm), (right_mm, floor_mm), *arc_mm], half_depth_mm)


def make_cutwaters(x_mm: float, width_mm: float, depth_mm: float, height_mm: float) -> Solid:
    """Make the cutwaters on both sides of a pier, with tops that slope back to the wall."""
    half_mm, reach_mm = width_mm / 2.0, depth_mm / 2.0 + 0.7 * width_mm
    outline_mm = [(x_mm - half_mm, 0.0), (x_mm, -reach_mm), (x_mm + half_mm, 0.0), (x_mm, reach_mm)]
    vertices_mm = [(x, y, 0.0) for x, y in outline_mm]
    vertices_mm += [(x, y, height_mm + (0.0 if y else 0.7 * width_mm)) for x, y in outline_mm]
    faces = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    for i in range(4):
        j = (i + 1) % 4
        faces += [(i, j, 4 + j), (i, 4 + j, 4 + i)]
    return Solid.from_arrays(np.array(vertices_mm), np.array(faces))


def make_aqueduct() -> Solid:
    """Make the whole model: long along x, deep along y, standing on z = 0, in mm."""
    solids, openings = [], []
    cornice_mm, overhang_mm = CORNICE_MM
    for floor_mm, height_mm, depth_mm, arches, pier_mm, spring_mm in TIERS:
        top_mm, half_mm = floor_mm + height_mm, depth_mm / 2.0
        solids.append(Solid.box((0.0, -half_mm, floor_mm), (LENGTH_MM, half_mm, top_mm)))
        edge_mm = half_mm + overhang_mm
        solids.append(Solid.box((0.0, -edge_mm, top_mm - cornice_mm), (LENGTH_MM, edge_mm, top_mm)))
        bay_mm = (LENGTH_MM - pier_mm) / arches
        foot_mm = floor_mm if floor_mm > 0.0 else -1.0  # the lowest openings reach the ground
        for i in range(arches):
            left_mm = pier_mm + i * bay_mm
            right_mm = left_mm + bay_mm - pier_mm
            segments = 16 if arches < 12 else 8
            openings.append(make_opening(left_mm, right_mm, foot_mm, floor_mm + spring_mm, segments, 40.0))
        if floor_mm == 0.0:
            solids += [
                make_cutwaters(pier_mm / 2.0 + i * bay_mm, pier_mm, depth_mm, spring_mm)
                for i in range(arches + 1)
            ]
    width_mm, depth_mm = CHANNEL_MM
    top_mm = TIERS[-1][0] + TIERS[-1][1]
    channel = Solid.box(
        (-1.0, -width_mm / 2.0, top_mm - depth_mm), (LENGTH_MM + 1.0, width_mm / 2.0, top_mm + 1.0)
    )
    return Solid.union(solids).subtract(Solid.union([*openings, channel]))


def main() -> int:
    """Write the model to the file named on the command line, and return the exit code."""
    parser = argparse.ArgumentParser(description="Make the example model: a Roman aqueduct with three tiers.")
    parser.add_argument("out", type=Path, metavar="OUT.stl", help="the STL file")
    out = parser.parse_args().out
    try:
        solid = make_aqueduct()
        corners = round_triangles(*solid.arrays())
        if corners is None:
            raise DecomposeError("the aqueduct is not closed in single precision; change its dimensions")
        write_stl(out, corners)
    except (DecomposeError, OSError) as error:
        print(f"{out}: {error}", file=sys.stderr)
        return 1
    size = " x ".join(f"{v:.0f}" for v in np.ptp(solid.bounds_mm, axis=0))
    print(f"{out}: an aqueduct, {size} mm, {solid.volume_mm3 / 1000.0:.0f} cm3")
    return 0


if __name__ == "__main__":
    sys.exit(main())
