"""Models of 160 to 330 mm: flat and curved, thick and thin, upright and sloping."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import trimesh
from trimesh import creation
from trimesh.transformations import rotation_matrix

from decompose.geometry import Solid
from examples.make_aqueduct import make_aqueduct


def make_solid(mesh: trimesh.Trimesh) -> Solid:
    """Make a solid from a mesh."""
    return Solid.from_arrays(mesh.vertices, mesh.faces)


def make_rod(start: tuple[float, ...], end: tuple[float, ...], radius_mm: float) -> Solid:
    """Make a cylinder between two points, in mm."""
    return make_solid(creation.cylinder(radius_mm, segment=[start, end], sections=24))


def make_ellipsoid(centre: tuple[float, ...], radii_mm: tuple[float, ...]) -> Solid:
    """Make an ellipsoid by its centre and its radii, in mm."""
    mesh = creation.icosphere(4, 1.0)
    mesh.apply_scale(radii_mm)
    mesh.apply_translation(centre)
    return make_solid(mesh)


def make_loft(rings: list[np.ndarray]) -> Solid:
    """Make a body through closed rings (k, n, 3) of points, one above another."""
    n, k = len(rings[0]), len(rings)
    vertices = np.concatenate([*rings, [rings[0].mean(axis=0), rings[-1].mean(axis=0)]])
    faces = []
    for i in range(n):
        j = (i + 1) % n
        faces += [(k * n, j, i), (k * n + 1, (k - 1) * n + i, (k - 1) * n + j)]
        for r in range(k - 1):
            a, b = r * n, (r + 1) * n
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
    body = Solid.from_arrays(vertices, np.array(faces))
    return body if body.volume_mm3 > 0.0 else Solid.from_arrays(vertices, np.array(faces)[:, ::-1])


def make_ball() -> Solid:
    """Make a ball that is large enough for a decomposition to leave its inside hollow."""
    return make_ellipsoid((0.0, 0.0, 0.0), (95.0, 95.0, 95.0))


def make_ring() -> Solid:
    """Make a tilted torus with a bar through it."""
    torus = creation.torus(60.0, 25.0, major_sections=64, minor_sections=32)
    torus.apply_transform(rotation_matrix(0.6, [1.0, 0.5, 0.2]))
    return Solid.union([make_solid(torus), Solid.box((-45.0, -8.0, -37.0), (110.0, 15.0, 60.0))])


def make_vase() -> Solid:
    """Make a body of revolution with a curved, thick wall, open at the top."""
    z = np.linspace(0.0, 180.0, 40)
    outer = 45.0 + 22.0 * np.sin(z / 180.0 * 2.2 * math.pi)
    profile = [(0.0, 0.0), *zip(outer, z, strict=True)]
    profile += [*zip(outer[::-1][:-2] - 7.0, z[::-1][:-2], strict=True), (0.0, 9.0)]
    return make_solid(creation.revolve(np.array(profile), sections=64))


def make_house() -> Solid:
    """Make walls of 6 mm with windows, under a pitched roof."""
    roof = [np.array([(x, -60.0, 80.0), (x, 60.0, 80.0), (x, 0.0, 135.0)]) for x in (-90.0, 90.0)]
    body = Solid.union([Solid.box((-80.0, -50.0, 0.0), (80.0, 50.0, 85.0)), make_loft(roof)])
    holes = [Solid.box((-74.0, -44.0, 5.0), (74.0, 44.0, 78.0))]
    holes += [Solid.box((x, -70.0, 30.0), (x + 24.0, 70.0, 60.0)) for x in (-60.0, -12.0, 36.0)]
    return body.subtract(Solid.union(holes))


def make_bracket() -> Solid:
    """Make two plates with ribs and bores."""
    plates = [
        Solid.box((0.0, -50.0, 0.0), (160.0, 50.0, 12.0)),
        Solid.box((0.0, -50.0, 0.0), (12.0, 50.0, 120.0)),
    ]
    for y in (-50.0, -5.0, 40.0):
        rib = [np.array([(10.0, t, 10.0), (130.0, t, 10.0), (10.0, t, 110.0)]) for t in (y + 10.0, y)]
        plates.append(make_loft(rib))
    bores = [make_rod((x, y, -5.0), (x, y, 20.0), 7.0) for x in (60.0, 110.0, 145.0) for y in (-25.0, 22.0)]
    bores += [make_rod((-5.0, y, 85.0), (20.0, y, 85.0), 9.0) for y in (-25.0, 22.0)]
    return Solid.union(plates).subtract(Solid.union(bores))


def make_animal() -> Solid:
    """Make a body and a head of ellipsoids, with leaning legs and a tail."""
    parts = [
        make_ellipsoid((0.0, 0.0, 95.0), (85.0, 42.0, 45.0)),
        make_ellipsoid((95.0, 0.0, 130.0), (36.0, 25.0, 28.0)),
    ]
    parts += [
        make_rod((x, y, 80.0), (x * 1.2, y * 1.3, 0.0), 14.0) for x in (-55.0, 55.0) for y in (-22.0, 22.0)
    ]
    parts += [
        make_rod((-75.0, 0.0, 100.0), (-120.0, 0.0, 60.0), 8.0),
        make_rod((60.0, 0.0, 105.0), (95.0, 0.0, 130.0), 22.0),
    ]
    parts += [make_rod((90.0, y, 145.0), (85.0, 2.2 * y, 180.0), 7.0) for y in (-14.0, 14.0)]
    return Solid.union(parts)


def make_gear() -> Solid:
    """Make a gear of eighteen teeth, with a bore and five holes."""
    angle_rad = np.linspace(0.0, 2.0 * math.pi, 18 * 4, endpoint=False)
    radius = np.tile([78.0, 92.0, 92.0, 78.0], 18)
    outline = [
        np.stack([radius * np.cos(angle_rad), radius * np.sin(angle_rad), 0.0 * angle_rad + z], axis=1)
        for z in (0.0, 32.0)
    ]
    holes = [make_rod((0.0, 0.0, -1.0), (0.0, 0.0, 40.0), 14.0)]
    for i in range(5):
        x, y = 46.0 * math.cos(i * 0.4 * math.pi), 46.0 * math.sin(i * 0.4 * math.pi)
        holes.append(make_rod((x, y, -1.0), (x, y, 40.0), 19.0))
    return make_loft(outline).subtract(Solid.union(holes))


def make_tree() -> Solid:
    """Make a trunk with leaning branches on a base."""
    rods = [
        make_rod((0.0, 0.0, 0.0), (10.0, 5.0, 190.0), 17.0),
        Solid.box((-45.0, -45.0, 0.0), (45.0, 45.0, 10.0)),
    ]
    for i in range(6):
        a, z = i * 1.9, 60.0 + 22.0 * i
        rods.append(make_rod((2.0, 1.0, z), (85.0 * math.cos(a), 85.0 * math.sin(a), z + 40.0), 9.0))
    return Solid.union(rods)


def make_column() -> Solid:
    """Make a column with a star-shaped section that turns and narrows with height."""
    angle_rad = np.linspace(0.0, 2.0 * math.pi, 60, endpoint=False)
    rings = []
    for z in np.linspace(0.0, 220.0, 45):
        r = (48.0 - 0.09 * z) * (1.0 + 0.16 * np.cos(5.0 * angle_rad))
        turned_angle_rad = angle_rad + 0.008 * z
        rings.append(
            np.stack(
                [r * np.cos(turned_angle_rad), r * np.sin(turned_angle_rad), 0.0 * angle_rad + z], axis=1
            )
        )
    return make_loft(rings)


def make_hills() -> Solid:
    """Make a landscape on a flat base."""
    rows = []
    x = np.linspace(0.0, 240.0, 61)
    for y in np.linspace(0.0, 160.0, 41):
        z = 64.0 + 16.0 * np.sin(x / 27.0) * np.cos(y / 21.0) + 12.0 * np.sin((x + 2.0 * y) / 55.0)
        top = np.stack([x, 0.0 * x + y, z], axis=1)
        rows.append(np.concatenate([top * (1.0, 1.0, 0.0), top[::-1]]))
    return make_loft(rows)


def make_stairs() -> Solid:
    """Make steps over an arch."""
    steps = [Solid.box((0.0, 0.0, 0.0), (180.0 - 26.0 * i, 70.0, 20.0 * (i + 1))) for i in range(6)]
    return Solid.union(steps).subtract(make_rod((80.0, -5.0, 0.0), (80.0, 75.0, 0.0), 38.0))


SHAPES: Mapping[str, Callable[[], Solid]] = {
    make.__name__.removeprefix("make_"): make
    for make in (
        make_aqueduct,
        make_ball,
        make_ring,
        make_vase,
        make_house,
        make_bracket,
        make_animal,
        make_gear,
        make_tree,
        make_column,
        make_hills,
        make_stairs,
    )
}
