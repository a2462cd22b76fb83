"""How a part lies on the bed: soonest printed among the poses in which it stands safely.

Candidates are the six axis poses and those that lie on a facet of the convex hull or on a large flat face.
Each is priced with its supports, and looked at for what a price cannot say: whether it stands while it grows,
and whether support would stick to a cut face, which is to be glued.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from decompose.columns import Columns, measure_columns
from decompose.convex import convex_outline, rectangles, smallest_rectangle
from decompose.cost import ADDITIVE, POSE_ROTATIONS, CostModel, PrinterRoom, pose_features
from decompose.footing import FIRST_LAYER_MM, Footing
from decompose.jit import jit
from decompose.layers import short_layers_s

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

HULL_FACETS, FLAT_FACES = 24, 12  # candidates of each kind, the largest first
APART_DEG = 2.0  # directions closer than this are one candidate
MAX_MEASURED = 24  # of all candidates, in the order of their prices
FEW = 1_500  # columns of a glance
SURELY = 0.8  # of a support seen at a glance is there
DEGREES: Floats = np.radians(np.arange(90.0))
COLUMN = ADDITIVE.index("column_mm3")  # the last: the support's volume, were it to reach the bed
TOUCHED_MM2 = 1.0  # less than this of a cut face under support is rounding

# [assumed] A part stands while it sticks to the bed better than the nozzle pulls at its top and its weight at
# its side. What a support carries is made to be peeled off; the outer half of a brim is too thin to hold.
MIN_CONTACT_MM2 = 4.0
MIN_FOOT_MM = 0.8  # of `Footing.wall_mm`: an edge is narrower than a line, so that its layer is not printed
STICKS_N_MM2 = 0.05
PROPPED = 0.1  # share of that for the area that supports carry
BRIM_HOLDS = 0.5  # share of a brim's width that counts as footing
PULL_N = 0.5
WEIGHT_N_MM3 = 1.25e-5


@dataclass(frozen=True, slots=True)
class Pose:
    """A part on the bed.

    Attributes
    ----------
    to_model
        (4, 4) the rigid motion from the bed (centred, on z = 0) to the model's frame, in mm.
    size_mm
        Width, depth and height.
    price_s
        Estimated print time with the supports and the brim that it has.
    strain
        What pulls it over while it is printed, as a share of what holds it; up to 1 it holds.
    lean_mm
        How far inside its footing the centre of mass of the whole is; negative outside.
    touched_mm2
        Area of cut faces that support sticks to.
    brim_share_mm
        How far the brim widens the footing.
    brim_width_mm, layer_0_expansion_mm
        Chosen for it; None: as the quality has them.
    """

    to_model: Floats
    size_mm: tuple[float, float, float]
    price_s: float
    footing: Footing
    strain: float
    lean_mm: float
    support_mm3: float
    touched_mm2: float
    brim_share_mm: float
    brim_width_mm: float | None
    layer_0_expansion_mm: float | None

    @property
    def stands(self) -> bool:
        """Whether it stays where it is while it is printed, and its weight is on its footing or its brim."""
        footing = self.footing
        touches = footing.contact_mm2 >= MIN_CONTACT_MM2 and footing.wall_mm >= MIN_FOOT_MM
        return touches and self.strain <= 1.0 and self.lean_mm >= -self.brim_share_mm

    @property
    def rank(self) -> tuple[int, float, float, float]:
        """Less is better: standing, then clean cut faces, then time. Where none stands, the least strain."""
        touched = self.touched_mm2 if self.touched_mm2 > TOUCHED_MM2 else 0.0
        if self.stands:
            return (0, 0.0, touched, self.price_s)
        return (1 if self.lean_mm >= -self.brim_share_mm else 2, self.strain, touched, self.price_s)


def find_best_pose(
    vertices: Floats,
    faces: Ints,
    cut: Bools,
    printers: Sequence[PrinterRoom],
    cost: CostModel,
    fit_first_layer: bool = True,
) -> Pose | None:
    """The pose that a part is printed in.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh, outward.
    cut
        (m,) whether a face is a cut, which no support shall touch.
    printers
        All of them have to have room for the part; none for a printer without limits.
    fit_first_layer
        Choose the brim and the first layer's expansion too.

    Returns
    -------
    Pose or None
        None where no pose fits.
    """
    hull = _hull_points(vertices)
    ups = candidate_directions(vertices, faces)
    turned = [_turned(up, hull, printers) for up in ups]
    rotations = np.array([r for r in turned if r is not None]).reshape(-1, 3, 3)
    if not len(rotations):
        return None
    features, extents = pose_features(vertices, faces, rotations, cost, hull)
    thinnest = replace(cost, brim_mm=0.0) if fit_first_layer else cost
    least_s = [thinnest.price_s([*f[:COLUMN], 0.0], e) for f, e in zip(features, extents, strict=True)]
    most_s = [cost.price_s(f, e) for f, e in zip(features, extents, strict=True)]
    best: Pose | None = None
    measured = 0
    for i in np.argsort(most_s, kind="stable"):
        clean = best is not None and best.rank[:3] == (0, 0.0, 0.0)
        if best is not None and clean:
            if least_s[i] >= best.price_s or measured >= MAX_MEASURED:
                continue
            if least_s[i] + SURELY * _support_s(vertices, faces, hull, rotations[i], cost) >= best.price_s:
                continue
        pose = _measured(vertices, faces, cut, rotations[i], features[i], cost, fit_first_layer)
        measured += 1
        if best is None or pose.rank < best.rank:
            best = pose
    return best


def _support_s(vertices: Floats, faces: Ints, hull: Floats, rotation: Floats, cost: CostModel) -> float:
    """The time of the support in a pose, at a glance: too few columns to tell islands apart."""
    triangles = (vertices @ rotation.T - (hull @ rotation.T).min(axis=0))[faces]
    seen = measure_columns(triangles, np.zeros(len(faces), np.bool_), cost.overhang_cos, FEW)
    return cost.support_price_s(seen.support_mm3, seen.support_side_mm2, seen.towers_mm)


def measure_pose(
    vertices: Floats,
    faces: Ints,
    cut: Bools,
    rotation: Floats,
    cost: CostModel,
    fit_first_layer: bool = True,
) -> Pose:
    """Price a pose, a rotation in rows, with the supports that it really has, and see how the part stands."""
    (features,), _ = pose_features(vertices, faces, rotation[None], cost)
    return _measured(vertices, faces, cut, rotation, features, cost, fit_first_layer)


def _measured(
    vertices: Floats,
    faces: Ints,
    cut: Bools,
    rotation: Floats,
    features: Floats,
    cost: CostModel,
    fit_first_layer: bool,
) -> Pose:
    placed = vertices @ rotation.T
    lo, hi = placed.min(axis=0), placed.max(axis=0)
    origin = np.array([(lo[0] + hi[0]) / 2.0, (lo[1] + hi[1]) / 2.0, lo[2]])
    triangles = (placed - origin)[faces]
    width, depth, height = (hi - lo).tolist()
    to_model = np.eye(4)
    to_model[:3, :3], to_model[:3, 3] = rotation.T, rotation.T @ origin
    inside = measure_columns(triangles, cut, cost.overhang_cos)
    footing = Footing.from_mesh(triangles, inside.props_mm)
    leans = [footing.inside_mm(centre[None, :2]) for centre in inside.centres_mm]
    brim: float | None = None
    expansion: float | None = None
    if fit_first_layer:
        brim = footing.brim_width_mm(height, leans[-1], cost.brim_mm, cost.shrinkage)
        joined = bool((triangles[cut][:, :, 2].min(axis=1, initial=math.inf) < FIRST_LAYER_MM).any())
        expansion = footing.expansion_mm(joined)
    priced = cost if brim is None else replace(cost, brim_mm=brim)
    return Pose(
        to_model=to_model,
        size_mm=(width, depth, height),
        price_s=priced.price_s([*features[:COLUMN], 0.0], hi - lo)
        + cost.support_price_s(
            inside.support_mm3, inside.support_side_mm2, inside.towers_mm, inside.islands_mm
        )
        + short_layers_s(triangles, cost),
        footing=footing,
        strain=_strain(footing, inside, height, leans),
        lean_mm=leans[-1],
        support_mm3=inside.support_mm3,
        touched_mm2=inside.touched_mm2,
        brim_share_mm=BRIM_HOLDS * priced.brim_mm,
        brim_width_mm=brim,
        layer_0_expansion_mm=expansion,
    )


def _strain(footing: Footing, inside: Columns, height_mm: float, leans_mm: Sequence[float]) -> float:
    """The moments that pull a growing part over, at their worst, over that of what holds it."""
    area_mm2 = footing.contact_mm2 + PROPPED * inside.propped_mm2
    holds = STICKS_N_MM2 * area_mm2 * footing.width_mm / 2.0
    outside = max(w * max(0.0, -lean) for w, lean in zip(inside.volumes_mm3, leans_mm, strict=True))
    pulls = PULL_N * height_mm + WEIGHT_N_MM3 * outside
    return float(pulls / holds) if holds > 0.0 else math.inf


def candidate_directions(vertices: Floats, faces: Ints) -> Floats:
    """Directions (k, 3) that may point up: the axes, then away from hull facets and from large flat faces."""
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
    found = POSE_ROTATIONS[[4, 5, 0, 1, 2, 3], 2]
    try:
        hull = ConvexHull(vertices)
        a, b, c = (vertices[hull.simplices[:, i]] for i in range(3))
        facets = np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None] / 2.0 * hull.equations[:, :3]
    except QhullError:
        facets = np.zeros((0, 3))
    for normals, most in ((facets, HULL_FACETS), (areas, FLAT_FACES)):
        found = _apart(found, -_flats(normals), most, math.cos(math.radians(APART_DEG)))
    return found


@jit
def _apart(found: Floats, more: Floats, most: int, near_cos: float) -> Floats:
    """Directions (k, 3), and as many `more` of them that are near to none so far."""
    all_of_them = np.zeros((len(found) + most, 3))
    count = len(found)
    all_of_them[:count] = found
    for i in range(len(more)):
        if count == len(all_of_them):
            break
        apart = True
        for k in range(count):
            cos = 0.0
            for axis in range(3):
                cos += all_of_them[k, axis] * more[i, axis]
            if cos >= near_cos:
                apart = False
        if apart:
            all_of_them[count] = more[i]
            count += 1
    return all_of_them[:count].copy()


def _flats(areas: Floats) -> Floats:
    """Directions (k, 3) of area vectors (m, 3), each with all that point its way; the largest first."""
    size = np.linalg.norm(areas, axis=1)
    areas = areas[size > 0.0]
    if not len(areas):
        return areas
    _, group = np.unique(np.round(areas / size[size > 0.0, None], 3), axis=0, return_inverse=True)
    sums = np.zeros((group.max() + 1, 3))
    np.add.at(sums, group.reshape(-1), areas)
    size = np.linalg.norm(sums, axis=1)
    sums = sums[np.argsort(-np.round(size, 6), kind="stable")]
    directions: Floats = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    return directions


def _hull_points(points: Floats) -> Floats:
    """Those of points (n, d) that span their convex hull; all where they span no volume."""
    with suppress(QhullError):
        points = points[ConvexHull(points).vertices]
    return points


def _turned(up: Floats, hull: Floats, printers: Sequence[PrinterRoom]) -> Floats | None:
    """The rotation (rows) with this direction up and a yaw that fits every printer; None where none does.

    What stands along the axes stays so. Anything else is turned into its smallest rectangle, and further only
    where that has no room.
    """
    axis = np.flatnonzero((POSE_ROTATIONS[:, 2] == up).all(axis=1))
    if len(axis):
        x, y = POSE_ROTATIONS[axis[0], :2]
    else:
        x = np.cross(up, np.eye(3)[np.abs(up).argmin()])
        x /= np.linalg.norm(x)
        y = np.cross(up, x)
    flat = hull @ np.array([x, y]).T
    height = float(np.ptp(hull @ up))
    rim = convex_outline(flat)
    angles = smallest_rectangle(rim) + DEGREES
    if len(axis):
        angles = np.insert(angles, 0, 0.0)
    for angle, (width, depth) in zip(angles, rectangles(rim, angles).tolist(), strict=True):
        if all(printer.fits(width, depth, height) for printer in printers):
            return np.vstack([_plane(angle) @ np.array([x, y]), up])
    return None


def _plane(angle: float) -> Floats:
    """(2, 2) Rows: x and y turned by an angle in radians."""
    return np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
