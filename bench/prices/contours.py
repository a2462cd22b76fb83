"""Prices and slices of small shapes that differ in the number and form of their contours.

Usage: python -m bench.prices.contours [--settings paper,even] [--json]

Each shape has a feature that a sum over faces does not capture: many islands, fins, legs, holes, bars or
ledges. Whole shapes are sliced in their given pose, which takes a second each.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bench.models.shapes import make_rod
from bench.prices.parts import ENDLESS_BED, make_print_time_settings, resolve_named_settings
from decompose.geometry import Solid, round_triangles, write_stl
from decompose.print_time import CostModel, measure_pose
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import find_engine


def make_block(
    x_mm: float, y_mm: float, z_mm: float, width_mm: float, depth_mm: float, height_mm: float
) -> Solid:
    """Make a block by its corner and its size."""
    return Solid.box((x_mm, y_mm, z_mm), (x_mm + width_mm, y_mm + depth_mm, z_mm + height_mm))


def make_plate() -> Solid:
    """Make a flat plate."""
    return make_block(0, 0, 0, 60, 60, 3)


def make_grille() -> Solid:
    """Make a plate with square holes."""
    holes = [make_block(3 + 9 * i, 3 + 9 * j, -1, 6, 6, 9) for i in range(6) for j in range(6)]
    return make_plate().subtract(Solid.union(holes))


def make_fins(thickness_mm: float) -> Callable[[], Solid]:
    """Return a function that makes upright fins of a thickness on a plate."""
    return lambda: Solid.union(
        [make_block(0, 0, 0, 50, 50, 2), *(make_block(0, 8 * i, 1, 50, thickness_mm, 40) for i in range(7))]
    )


def make_bored_block() -> Solid:
    """Make a block with vertical bores."""
    bores = [
        make_rod((10 + 20 * i, 10 + 20 * j, -1.0), (10 + 20 * i, 10 + 20 * j, 30.0), 4.0)
        for i in range(3)
        for j in range(3)
    ]
    return make_block(0, 0, 0, 60, 60, 20).subtract(Solid.union(bores))


def make_posts() -> Solid:
    """Make square posts on a plate."""
    pillars = [make_block(10 * i, 10 * j, 1, 4, 4, 30) for i in range(6) for j in range(6)]
    return Solid.union([make_block(0, 0, 0, 60, 60, 2), *pillars])


def make_table() -> Solid:
    """Make a plate on four legs."""
    legs = [make_block(x, y, 0, 8, 8, 41) for x in (0, 52) for y in (0, 52)]
    return Solid.union([make_block(0, 0, 40, 60, 60, 3), *legs])


def make_legs() -> Solid:
    """Make four legs on a plate."""
    pillars = [make_block(x, y, 2, 14, 14, 41) for x in (0, 46) for y in (0, 46)]
    return Solid.union([make_block(0, 0, 0, 60, 60, 3), *pillars])


def make_ledges() -> Solid:
    """Make a wall with six ledges, one above another."""
    return Solid.union(
        [make_block(0, 0, 0, 12, 60, 42), *(make_block(0, 0, 6 * i + 5, 40, 60, 1.6) for i in range(6))]
    )


SHAPES: Mapping[str, Callable[[], Solid]] = {
    "plate": make_plate,
    "grille": make_grille,
    "fins 1.5 mm": make_fins(1.5),
    "fins 2.5 mm": make_fins(2.5),
    "bored": make_bored_block,
    "posts": make_posts,
    "table": make_table,
    "legs": make_legs,
    "ledges": make_ledges,
}


@dataclass(frozen=True, slots=True)
class Row:
    """Price and sliced time of a shape in seconds."""

    shape: str
    settings: str
    price_s: float
    sliced_s: float

    @property
    def error(self) -> float:
        """Relative error of the price."""
        return self.price_s / self.sliced_s - 1.0


def measure(shape: str, settings: str) -> Row:
    """Price and slice a shape in its given pose."""
    vertices, faces = SHAPES[shape]().arrays()
    lo, hi = vertices.min(axis=0), vertices.max(axis=0)
    placed_mm = vertices - [*(lo + hi)[:2] / 2.0, lo[2]]
    cost = CostModel.from_settings(make_print_time_settings(settings))
    pose = measure_pose(placed_mm, faces, np.zeros(len(faces), np.bool_), np.eye(3), cost, False)
    with tempfile.TemporaryDirectory() as folder:
        stl = Path(folder) / "shape.stl"
        corners = round_triangles(placed_mm, faces)
        assert corners is not None
        write_stl(stl, corners)
        path = stl.with_suffix(".gcode")
        request = PlateRequest(stl, resolve_named_settings(settings), path, find_engine(), ENDLESS_BED)
        return Row(shape, settings, pose.price_s, slice_plate(request).sliced_s)


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--settings", default="paper")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = [measure(shape, name) for name in args.settings.split(",") for shape in SHAPES]
    if args.json:
        print(json.dumps([asdict(row) | {"error": row.error} for row in rows], indent=1))
        return
    for row in rows:
        print(f"{row.settings:6} {row.shape:12} {row.sliced_s:7.0f} s, price {row.error:+6.1%}")
    print(f"mean error {np.mean([abs(row.error) for row in rows]):.1%}")


if __name__ == "__main__":
    main()
