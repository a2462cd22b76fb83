"""Further models of 150 to 300 mm, on which no rule or factor was tuned."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from trimesh import creation
from trimesh.transformations import rotation_matrix

from bench.models.shapes import make_ellipsoid, make_loft, make_rod, make_solid
from decompose.geometry import Solid


def _revolve_profile(profile: list[tuple[float, float]]) -> Solid:
    return make_solid(creation.revolve(np.array(profile), sections=60))


def _make_prism(outline: list[tuple[float, float]], start_mm: float, end_mm: float, axis: int) -> Solid:
    """Extrude an outline along an axis."""
    rings = [np.insert(np.array(outline), axis, offset_mm, axis=1) for offset_mm in (start_mm, end_mm)]
    return make_loft(rings)


def make_mug() -> Solid:
    """Make a cylinder with a handle."""
    wall = _revolve_profile([(0.0, 0.0), (70.0, 0.0), (70.0, 150.0), (63.0, 150.0), (63.0, 8.0), (0.0, 8.0)])
    handle = creation.torus(38.0, 9.0, major_sections=48, minor_sections=24)
    handle.apply_transform(rotation_matrix(math.pi / 2.0, [1.0, 0.0, 0.0]))
    handle.apply_translation((72.0, 0.0, 78.0))
    return Solid.union(
        [wall, make_solid(handle).subtract(make_rod((0.0, 0.0, 8.0), (0.0, 0.0, 160.0), 63.0))]
    )


def make_chair() -> Solid:
    """Make a seat on four legs, and a back of bars."""
    bodies = [Solid.box((0.0, 0.0, 90.0), (110.0, 110.0, 102.0))]
    bodies += [Solid.box((x, y, 0.0), (x + 12.0, y + 12.0, 95.0)) for x in (0.0, 98.0) for y in (0.0, 98.0)]
    bodies += [Solid.box((x, 99.0, 95.0), (x + 10.0, 110.0, 210.0)) for x in (0.0, 33.0, 67.0, 100.0)]
    return Solid.union([*bodies, Solid.box((0.0, 97.0, 195.0), (110.0, 110.0, 215.0))])


def make_rocket() -> Solid:
    """Make a body of revolution that ends in a tip, with fins below it."""
    z = np.linspace(0.0, 226.0, 36)
    r = 40.0 * np.sqrt(1.0 - (z / 230.0) ** 2) * (0.8 + 0.2 * np.sin(z / 60.0))
    bodies = [_revolve_profile([(0.0, 0.0), *zip(r.tolist(), z.tolist(), strict=True), (0.0, 230.0)])]
    fin = [(15.0, 20.0), (85.0, -40.0), (85.0, -10.0), (15.0, 95.0)]
    bodies += [_make_prism(fin, -4.0, 4.0, 1), _make_prism([(-x, z) for x, z in fin], -4.5, 4.5, 1)]
    bodies += [_make_prism(fin, -5.0, 5.0, 0), _make_prism([(-y, z) for y, z in fin], -5.5, 5.5, 0)]
    return Solid.union(bodies)


def make_boat() -> Solid:
    """Make an open hull that narrows at both ends, with benches."""

    def make_hull(beam_mm: float, length_mm: float, low_mm: float, high_mm: float) -> Solid:
        t = np.linspace(-1.0, 1.0, 31)[:-1]
        rings = []
        for z in np.linspace(low_mm, high_mm, 12):
            scale = 0.55 + 0.45 * math.sqrt(z / 80.0)
            x = length_mm * scale * np.concatenate([t, -t])
            y = beam_mm * scale * np.concatenate([1.0 - t**2, t**2 - 1.0]) + np.repeat([0.2, -0.2], 30)
            rings.append(np.stack([x, y, np.full(60, z)], axis=1))
        return make_loft(rings)

    shell = make_hull(48.0, 135.0, 0.0, 80.0).subtract(make_hull(40.0, 124.0, 7.0, 81.0))
    seats = [Solid.box((x, -38.0, 50.0), (x + 22.0, 38.0, 57.0)) for x in (-60.0, 30.0)]
    return Solid.union([shell, *seats])


def make_elbow() -> Solid:
    """Make a bent pipe with flanges."""

    def make_bend(radius_mm: float) -> Solid:
        rings = []
        angle_rad = np.linspace(0.0, 2.0 * math.pi, 40, endpoint=False)
        for turn_rad in np.linspace(0.0, math.pi / 2.0, 25):
            r = 95.0 + radius_mm * np.cos(angle_rad)
            rings.append(
                np.stack(
                    [r * math.cos(turn_rad), radius_mm * np.sin(angle_rad), r * math.sin(turn_rad)], axis=1
                )
            )
        return make_loft(rings)

    flanges = [
        make_rod((95.0, 0.0, -10.0), (95.0, 0.0, 3.0), 55.0),
        make_rod((-10.0, 0.0, 95.0), (3.0, 0.0, 95.0), 55.0),
    ]
    bores = [
        make_rod((95.0, 0.0, -11.0), (95.0, 0.0, 4.0), 28.0),
        make_rod((-11.0, 0.0, 95.0), (4.0, 0.0, 95.0), 28.0),
    ]
    return Solid.union([make_bend(38.0), *flanges]).subtract(Solid.union([make_bend(28.0), *bores]))


def make_bust() -> Solid:
    """Make a head on shoulders, with a flat base."""
    parts = [
        make_ellipsoid((0.0, 0.0, 150.0), (40.0, 48.0, 55.0)),
        make_rod((0.0, 0.0, 60.0), (0.0, 0.0, 120.0), 24.0),
        make_ellipsoid((0.0, 0.0, 20.0), (50.0, 95.0, 58.0)),
        make_ellipsoid((42.0, 0.0, 148.0), (14.0, 9.0, 16.0)),
    ]
    parts += [make_ellipsoid((0.0, y, 150.0), (12.0, 7.0, 17.0)) for y in (-48.0, 48.0)]
    return Solid.union(parts).subtract(Solid.box((-200.0, -200.0, -100.0), (200.0, 200.0, 0.0)))


def make_pyramid() -> Solid:
    """Make a hollow pyramid with steps on the outside."""
    steps = [
        Solid.box(
            (-90.0 + 13.0 * i, -90.0 + 13.0 * i, 18.0 * i),
            (90.0 - 13.0 * i, 90.0 - 13.0 * i, 18.0 * i + 18.0),
        )
        for i in range(6)
    ]
    hollow = [
        np.array([(-s, -s, z), (s, -s, z), (s, s, z), (-s, s, z)]) for s, z in ((70.0, -1.0), (4.0, 85.0))
    ]
    return Solid.union(steps).subtract(make_loft(hollow))


def make_lattice() -> Solid:
    """Make a tower of struts."""
    nodes = [(x, y) for x, y in ((-40.0, -40.0), (40.0, -40.0), (40.0, 40.0), (-40.0, 40.0))]
    struts = [Solid.box((-50.0, -50.0, -8.0), (50.0, 50.0, 2.0))]
    for i, (x, y) in enumerate(nodes):
        u, v = nodes[(i + 1) % 4]
        struts.append(make_rod((x, y, 0.0), (0.6 * x, 0.6 * y, 200.0), 8.0))
        for z in (0.0, 65.0, 130.0):
            a, b = 1.0 - 0.4 * z / 200.0, 1.0 - 0.4 * (z + 65.0) / 200.0
            struts.append(make_rod((a * x, a * y, z), (b * u, b * v, z + 65.0), 6.0))
    return Solid.union(struts)


def make_propeller() -> Solid:
    """Make three twisted blades around a hub."""
    blades = []
    for i in range(3):
        rotation = rotation_matrix(i * 2.0 * math.pi / 3.0, [0.0, 0.0, 1.0])[:3, :3]
        rings = []
        for r in np.linspace(10.0, 120.0, 20):
            width_mm, thickness_mm, twist_rad = (
                22.0 + 8.0 * math.sin(r / 40.0),
                6.0 - r / 40.0,
                1.1 - 0.006 * r,
            )
            angle_rad = np.linspace(0.0, 2.0 * math.pi, 32, endpoint=False)
            y, z = width_mm * np.cos(angle_rad), thickness_mm * np.sin(angle_rad)
            ring = [
                0.0 * y + r,
                y * math.cos(twist_rad) - z * math.sin(twist_rad),
                y * math.sin(twist_rad) + z * math.cos(twist_rad),
            ]
            rings.append(np.stack(ring, axis=1) @ rotation.T)
        blades.append(make_loft(rings))
    hub = make_rod((0.0, 0.0, -24.0), (0.0, 0.0, 24.0), 22.0)
    return Solid.union([hub, *blades]).subtract(make_rod((0.0, 0.0, -30.0), (0.0, 0.0, 30.0), 7.0))


def make_bridge() -> Solid:
    """Make a deck on two arches, between towers with cones."""
    angles_rad = np.linspace(0.0, math.pi, 30)
    arches = [
        _make_prism([(x + 40.0 * math.cos(a), 45.0 * math.sin(a) - 1.0) for a in angles_rad], -31.0, 31.0, 1)
        for x in (-60.0, 60.0)
    ]
    body = Solid.box((-130.0, -30.0, 0.0), (130.0, 30.0, 62.0)).subtract(Solid.union(arches))
    towers = [make_rod((x, 0.0, 0.0), (x, 0.0, 120.0), 20.0) for x in (-125.0, 125.0)]
    for x in (-125.0, 125.0):
        tip = creation.cone(26.0, 45.0, sections=40)
        tip.apply_translation((x, 0.0, 118.0))
        towers.append(make_solid(tip))
    return Solid.union([body, *towers])


def make_coat_hook() -> Solid:
    """Make a slanting plate with hooks."""
    plate = _make_prism([(0.0, 0.0), (14.0, 0.0), (44.0, 160.0), (30.0, 160.0)], -80.0, 80.0, 1)
    hooks = []
    for y in (-50.0, 0.0, 50.0):
        hooks += [
            make_rod((15.0, y, 50.0), (75.0, y, 40.0), 9.0),
            make_rod((72.0, y, 40.0), (95.0, y, 85.0), 8.0),
        ]
        hooks.append(make_ellipsoid((96.0, y, 87.0), (13.0, 13.0, 13.0)))
    return Solid.union([plate, *hooks])


def make_shell() -> Solid:
    """Make half of a hollow ellipsoid with a thick wall, tilted."""
    outer, inner = (
        make_ellipsoid((0.0, 0.0, 0.0), (110.0, 85.0, 70.0)),
        make_ellipsoid((0.0, 0.0, 0.0), (98.0, 73.0, 58.0)),
    )
    half = outer.subtract(Solid.union([inner, Solid.box((-200.0, -200.0, -100.0), (200.0, 200.0, 0.0))]))
    return half.rotate(rotation_matrix(0.35, [0.3, 1.0, 0.0])[:3, :3])


OTHER_SHAPES: Mapping[str, Callable[[], Solid]] = {
    make.__name__.removeprefix("make_"): make
    for make in (
        make_mug,
        make_chair,
        make_rocket,
        make_boat,
        make_elbow,
        make_bust,
        make_pyramid,
        make_lattice,
        make_propeller,
        make_bridge,
        make_coat_hook,
        make_shell,
    )
}
