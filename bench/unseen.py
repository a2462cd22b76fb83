"""Decompositions of random shapes on which nothing was tuned, generated from a seed.

Usage: python -m bench.unseen [--seed 1] [--kinds organic,bust,...] [--printers 20] [--side 450]
       [--budget 20] [--json] [--scheduler tls://HOST:PORT --certificates DIR]

Each kind is a family: limbs of ellipsoids, a rough head on shoulders, a lattice of struts, a thin shell,
a block with bores, a flat sheet with ribs. Times are prices of the cost model, compared with the whole model
in its best pose; nothing is sliced (`bench.decompose` slices). `wall_s` is the wall time on this machine,
`effort_s` the counted work.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from time import perf_counter

import numpy as np
from trimesh import creation

from bench.clusters.calls import add_cluster_options, count_calls, open_calls
from bench.models.shapes import make_ellipsoid, make_rod, make_solid
from bench.search.peak_memory import read_peak_mb
from decompose.decompose import decompose_model
from decompose.errors import DecomposeError
from decompose.geometry import Model, Solid
from decompose.options import BUDGET_S, BestOptions, Options
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter
from farm.compute import DeferredFunction, TaskFiles

# Usable build volumes of an Ultimaker 2+, without the margin of the brim.
USABLE_VOLUMES_MM = (
    (206.9, 190.9, 205.0),
    (173.9, 197.9, 205.0),
    (164.9, 206.9, 205.0),
)


def draw_organic_body(rng: np.random.Generator) -> Solid:
    """Draw a body with limbs that bend and taper."""
    bodies = [make_ellipsoid((0.0, 0.0, 0.0), tuple(rng.uniform(30.0, 60.0, 3)))]
    for _ in range(int(rng.integers(4, 7))):
        point, direction = np.zeros(3), rng.normal(size=3)
        for radius in np.linspace(22.0, rng.uniform(5.0, 9.0), 8):
            direction = direction / np.linalg.norm(direction) + rng.normal(scale=0.25, size=3)
            next_point = point + 24.0 * direction / np.linalg.norm(direction)
            bodies += [
                make_ellipsoid(tuple(next_point), (radius,) * 3),
                make_rod(tuple(point), tuple(next_point), float(radius)),
            ]
            point = next_point
    return Solid.union(bodies)


def draw_bust(rng: np.random.Generator) -> Solid:
    """Draw a head with a rough face on shoulders, with a flat base."""
    sphere = creation.icosphere(5, 1.0)
    waves = rng.normal(scale=4.0, size=(24, 3))
    phases = rng.uniform(0.0, 2.0 * math.pi, 24)
    roughness = np.sin(sphere.vertices @ waves.T + phases).sum(axis=1) / 24.0
    sphere.vertices *= (1.0 + 0.35 * roughness)[:, None] * rng.uniform(50.0, 70.0, 3)
    sphere.apply_translation((0.0, 0.0, 130.0))
    shoulders = make_ellipsoid((0.0, 0.0, 10.0), (55.0, float(rng.uniform(80.0, 110.0)), 60.0))
    neck = make_rod((0.0, 0.0, 30.0), (0.0, 0.0, 110.0), float(rng.uniform(20.0, 30.0)))
    ground = Solid.box((-300.0, -300.0, -300.0), (300.0, 300.0, 0.0))
    return Solid.union([make_solid(sphere), shoulders, neck]).subtract(ground)


def draw_lattice(rng: np.random.Generator) -> Solid:
    """Draw struts between the nodes of a crooked grid."""
    nodes = {
        (i, j, k): np.array([i, j, k]) * 60.0 + rng.uniform(-12.0, 12.0, 3)
        for i in range(3)
        for j in range(3)
        for k in range(4)
    }
    radius_mm = float(rng.uniform(4.0, 8.0))
    struts = [make_ellipsoid(tuple(point), (1.2 * radius_mm,) * 3) for point in nodes.values()]
    for index, point in nodes.items():
        for axis in range(3):
            neighbour = tuple(n + (a == axis) for a, n in enumerate(index))
            if neighbour in nodes:
                struts.append(make_rod(tuple(point), tuple(nodes[neighbour]), radius_mm))
    return Solid.union(struts)


def draw_shell(rng: np.random.Generator) -> Solid:
    """Draw a thin, open bowl with an uneven rim."""
    radii_mm = rng.uniform(70.0, 120.0, 3)
    thickness_mm = float(rng.uniform(2.5, 6.0))
    bowl = make_ellipsoid((0.0, 0.0, 0.0), tuple(radii_mm)).subtract(
        make_ellipsoid((0.0, 0.0, 0.0), tuple(radii_mm - thickness_mm))
    )
    slope = rng.uniform(-0.3, 0.3, 2)
    normal = np.array([*slope, 1.0]) / math.sqrt(1.0 + float(slope @ slope))
    return bowl.split_by_plane(normal, float(rng.uniform(-20.0, 30.0)))[0]


def draw_mechanical_part(rng: np.random.Generator) -> Solid:
    """Draw a block with pads, pockets and bores."""
    size = rng.uniform(80.0, 220.0, 3)
    bodies, bores = [Solid.box((0.0, 0.0, 0.0), tuple(size))], []
    for _ in range(4):
        lo = rng.uniform(0.0, 0.7, 3) * size
        bodies.append(Solid.box(tuple(lo), tuple(lo + rng.uniform(20.0, 80.0, 3))))
    for _ in range(6):
        axis, position_mm = int(rng.integers(3)), rng.uniform(0.2, 0.8, 3) * size
        start, end = position_mm.copy(), position_mm.copy()
        start[axis], end[axis] = -10.0, size[axis] + 10.0
        bores.append(make_rod(tuple(start), tuple(end), float(rng.uniform(5.0, 22.0))))
    return Solid.union(bodies).subtract(Solid.union(bores))


def draw_flat_sheet(rng: np.random.Generator) -> Solid:
    """Draw a wide sheet with ribs."""
    width_mm, depth_mm = rng.uniform(200.0, 400.0, 2)
    bodies = [Solid.box((0.0, 0.0, 0.0), (width_mm, depth_mm, 3.0))]
    for _ in range(5):
        x, y = rng.uniform(0.0, 0.6, 2) * (width_mm, depth_mm)
        length_mm = float(rng.uniform(60.0, 140.0))
        size_mm = (length_mm, 4.0) if rng.random() < 0.5 else (4.0, length_mm)
        bodies.append(
            Solid.box((x, y, 0.0), (x + size_mm[0], y + size_mm[1], float(rng.uniform(10.0, 30.0))))
        )
    return Solid.union(bodies)


KINDS: Mapping[str, Callable[[np.random.Generator], Solid]] = {
    "organic": draw_organic_body,
    "bust": draw_bust,
    "lattice": draw_lattice,
    "shell": draw_shell,
    "mechanical": draw_mechanical_part,
    "flat": draw_flat_sheet,
}


def draw_model(kind: str, seed: int, side_mm: float) -> Model:
    """Draw a model of a kind with a longest side; the same seed draws the same model."""
    solid = KINDS[kind](np.random.default_rng([seed, sorted(KINDS).index(kind)]))
    vertices, faces = solid.arrays()
    scale = side_mm / float(np.ptp(vertices, axis=0).max())
    return Model(Solid.from_arrays(scale * vertices, faces), (), scale)


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of one decomposition; if it failed, those of its result are None, and `reason` says why.

    Attributes
    ----------
    efficiency
        Time of the whole model in its best pose, divided by the number of printers times the makespan.
    balance
        Mean time of the parts, divided by the longest.
    gap
        Share by which the makespan on the grid exceeds its lower bound.
    small_feet
        Number of parts that stand high on a small foot.
    peak_mb
        Peak memory of the process so far.
    """

    kind: str
    seed: int
    triangles: int
    parts: int | None
    efficiency: float | None
    balance: float | None
    gap: float | None
    small_feet: int | None
    effort_s: float | None
    wall_s: float
    peak_mb: float
    reason: str = ""


def measure(kind: str, seed: int, printers: int, side_mm: float, budget_s: float) -> Figures:
    """Decompose one model with default settings."""
    model = draw_model(kind, seed, side_mm)
    target_printers = [TargetPrinter(str(number), USABLE_VOLUMES_MM) for number in range(printers)]
    options = Options(best=BestOptions(budget_s))
    start_s, result, reason = perf_counter(), None, ""
    with ThreadPoolExecutor() as executor:
        try:
            result = decompose_model(
                model, target_printers, options, CostModel.from_settings(PrintTimeSettings()), executor
            )
        except DecomposeError as error:
            reason = str(error)
    wall_s = perf_counter() - start_s
    peak_mb = read_peak_mb()
    if result is None:
        no_figures = (None,) * 6
        return Figures(kind, seed, model.solid.face_count, *no_figures, wall_s, peak_mb, reason)
    return Figures(
        kind,
        seed,
        model.solid.face_count,
        len(result.parts),
        result.serial_s / (printers * result.makespan_s),
        result.sum_s / len(result.parts) / result.makespan_s,
        result.gap,
        sum(part.small_foot_mm2 is not None for part in result.parts),
        sum(attempt.effort_s for attempt in result.attempts),
        wall_s,
        peak_mb,
    )


def list_files(*_: object) -> TaskFiles:
    """Return the files of `measure`: none."""
    return TaskFiles()


deferred_measure = DeferredFunction("bench.unseen:measure", list_files)


def format_row(row: Figures) -> str:
    """Format the figures of one model."""
    figures = row.reason or (
        f"{row.parts} parts, E {row.efficiency:.3f}, balance {row.balance:.3f}, gap {row.gap:.1%}, "
        f"{row.small_feet} small feet, effort {row.effort_s:.1f} s"
    )
    return f"{row.kind:10} {row.triangles:7} faces: {figures}, {row.wall_s:.0f} s, {row.peak_mb:.0f} MB"


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--printers", type=int, default=20)
    parser.add_argument("--side", type=float, default=450.0)
    parser.add_argument("--budget", type=float, default=BUDGET_S)
    parser.add_argument("--json", action="store_true")
    add_cluster_options(parser)
    options = parser.parse_args()
    rows = []
    with open_calls(options) as call, ThreadPoolExecutor(count_calls(options)) as threads:

        def measure_kind(kind: str) -> Figures:
            size = options.printers, options.side, options.budget
            figures: Figures = call(deferred_measure, kind, options.seed, *size)
            return figures

        for row in threads.map(measure_kind, options.kinds.split(",")):
            rows.append(row)
            if not options.json:
                print(format_row(row), flush=True)
    efficiencies = [row.efficiency for row in rows if row.efficiency is not None]
    mean = math.exp(sum(map(math.log, efficiencies)) / len(efficiencies)) if efficiencies else None
    if options.json:
        print(json.dumps({"models": [asdict(row) for row in rows], "efficiency": mean}, indent=1))
    elif mean is not None:
        print(f"geometric mean of E {mean:.3f}, worst {min(efficiencies):.3f}")


if __name__ == "__main__":
    main()
