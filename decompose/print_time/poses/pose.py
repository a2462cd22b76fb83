"""A part in one pose: its price with its supports, and whether it stays upright."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from decompose.arrays import Bools, Floats, Ints
from decompose.geometry.rays import find_bounds
from decompose.print_time.columns import Columns, measure_columns
from decompose.print_time.contours import measure_contours
from decompose.print_time.cost import CostModel
from decompose.print_time.hidden_faces import HiddenFaces, find_hidden_faces, sum_side_ends_mm
from decompose.print_time.part_mesh import PartMesh
from decompose.print_time.pose_prices import (
    LATERAL_INDEX,
    SKIN_INDEX,
    price_short_layers_s,
    sum_pose_features,
)
from decompose.print_time.poses.footing import FIRST_LAYER_MIDDLE_MM, Footing
from decompose.print_time.thin_walls import SheetLimits, ThinWalls, WallWidths, measure_thin_walls
from decompose.print_time.time_settings import ADDITIVE_FEATURES

COLUMN_INDEX = ADDITIVE_FEATURES.index("column_mm3")
# Difference in length between neighbouring walls around a round hole, as a share of that around a square
# hole.
HOLE_INSET_SHARE = math.pi / 4.0
MIN_TOUCHED_MM2 = 1.0  # minimum area of a cut face that support touches; a smaller area is a rounding error

# [assumed] A part stays upright as long as the moment of its adhesion to the bed exceeds the sum of two other
# moments: that of the nozzle's pull at the top of the part, and that of its weight if the centre of mass is
# not above the footing. Support is made to be peeled off, so it holds less. The outer half of a brim is too
# thin to hold.
MIN_CONTACT_MM2 = 4.0  # minimum area of the first layer
MIN_FOOT_MM = 0.8  # minimum `Footing.hydraulic_diameter_mm`: an edge narrower than a line is not printed
ADHESION_N_PER_MM2 = 0.05  # adhesion of the first layer to the bed
SUPPORTED_CONTACT_SHARE = 0.1  # adhesion of the area of supports, as a share of that of the first layer
BRIM_FOOTING_SHARE = 0.5  # share of a brim's width that counts as footing
PULL_N = 0.5  # horizontal pull of the nozzle
WEIGHT_N_PER_MM3 = 1.25e-5  # weight of the filament

# [assumed] A slender part on a small foot gets a warning, even if its brim holds it.
SMALL_FOOT_MM2 = 300.0  # first layers with a smaller area count as small
MIN_SLENDERNESS = 6.0  # slenderness above which a part gets the warning: 104 mm of height on 300 mm2


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of a part on the bed, with its price and its stability.

    Attributes
    ----------
    to_model
        (4, 4) rigid transform in mm from the bed, on which the part is centred and stands on z = 0, to the
        model's frame.
    size_mm
        Width, depth and height.
    price_s
        Estimated print time with its supports and its brim.
    footing
        Contact of the part with the bed.
    tilt_ratio
        Moment that tilts the part while it is printed, divided by the moment that holds it; up to 1, the part
        stays upright.
    margin_mm
        Distance of the part's centre of mass from the edge of its footing; negative outside.
    support_mm3
        Volume of the supports.
    touched_mm2
        Area of cut faces to which support sticks.
    footing_extension_mm
        Width by which the brim widens the footing on each side.
    brim_width_mm, layer_0_expansion_mm
        Values chosen for the part; None to use those of the print settings.
    bed_face_hidden, tops_hidden
        Whether all faces on the bed (or all tops with skin) are cut faces, and the cost model gives them less
        skin.
    flat_tops_visible
        Whether flat tops remain visible once the parts are glued.
    connectors_s
        Seconds that the price includes for marks and pins in the cut faces.
    """

    to_model: Floats
    size_mm: tuple[float, float, float]
    price_s: float
    footing: Footing
    tilt_ratio: float
    margin_mm: float
    support_mm3: float
    touched_mm2: float
    footing_extension_mm: float
    brim_width_mm: float | None
    layer_0_expansion_mm: float | None
    bed_face_hidden: bool = False
    tops_hidden: bool = False
    flat_tops_visible: bool = True
    connectors_s: float = 0.0

    @property
    def stands(self) -> bool:
        """True if the part stays in place while it is printed, given its footing and its brim."""
        footing = self.footing
        has_contact = footing.contact_mm2 >= MIN_CONTACT_MM2 and footing.hydraulic_diameter_mm >= MIN_FOOT_MM
        return has_contact and self.tilt_ratio <= 1.0 and self.margin_mm >= -self.footing_extension_mm

    @property
    def slenderness(self) -> float:
        """Height divided by the side of a square with the first layer's area; inf without a first layer."""
        contact_mm2 = self.footing.contact_mm2
        return self.size_mm[2] / math.sqrt(contact_mm2) if contact_mm2 > 0.0 else math.inf

    @property
    def has_small_foot(self) -> bool:
        """True if the first layer is small for the height of the part."""
        return self.footing.contact_mm2 < SMALL_FOOT_MM2 and self.slenderness > MIN_SLENDERNESS

    @property
    def rank(self) -> tuple[int, float, float, float]:
        """Sort key, lower is better: stability, area of cut faces that support touches, price.

        For a part that does not stay upright, the tilt ratio takes precedence over the last two.
        """
        touched_mm2 = self.touched_mm2 if self.touched_mm2 > MIN_TOUCHED_MM2 else 0.0
        if self.stands:
            return (0, 0.0, touched_mm2, self.price_s)
        return (
            1 if self.margin_mm >= -self.footing_extension_mm else 2,
            self.tilt_ratio,
            touched_mm2,
            self.price_s,
        )


def measure_pose(
    vertices: Floats,
    faces: Ints,
    is_cut: Bools,
    rotation: Floats,
    cost: CostModel,
    fit_first_layer: bool = True,
) -> Pose:
    """Price a pose with supports that end on the bed or on the part, and measure the part's stability.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh that faces outward.
    is_cut
        (m,) bool, true for cut faces, which no support should touch.
    rotation
        (3, 3) rotation, whose rows are the bed's x, y and z in the model's frame.
    cost
        Cost model of the print time.
    fit_first_layer
        Whether the brim and the first layer's expansion are chosen for the part; if not, those of the print
        quality apply.
    """
    (features,), _ = sum_pose_features(vertices, faces, rotation[None], cost, is_cut=is_cut)
    return measure_pose_from_features(
        PartMesh(vertices, faces, is_cut), rotation, features, cost, fit_first_layer
    )


def measure_pose_from_features(
    mesh: PartMesh, rotation: Floats, features: Floats, cost: CostModel, fit_first_layer: bool
) -> Pose:
    """Measure a pose as `measure_pose` does, from known features.

    Parameters
    ----------
    mesh
        Closed mesh of the part, facing outward.
    rotation, cost, fit_first_layer
        As in `measure_pose`.
    features
        (5,) `ADDITIVE_FEATURES` in this pose.
    """
    vertices_mm, extents_mm, origin_mm = _place_on_bed(mesh.vertices, rotation)
    triangles = vertices_mm[mesh.faces]
    width_mm, depth_mm, height_mm = extents_mm.tolist()
    cost = cost.fit_layers(height_mm)
    up = np.ascontiguousarray(rotation[2])
    hidden_faces = find_hidden_faces(mesh.surfaces, mesh.is_cut, up, float(origin_mm[2]), cost.skin_cos)
    columns = measure_columns(triangles, mesh.is_cut, cost.find_overhang_cos(mesh.surfaces, up))
    thin_walls = _measure_thin_walls(triangles, hidden_faces, cost)
    footing = Footing.from_mesh(triangles, columns.bed_support_border_mm)
    margins_mm = footing.measure_margins_mm(columns.centres_mm[:, :2])
    brim_width_mm: float | None = None
    expansion_mm: float | None = None
    if fit_first_layer:
        brim_width_mm = footing.choose_brim_width_mm(height_mm, margins_mm[-1], cost.brim_mm, cost.shrinkage)
        expansion_mm = footing.choose_expansion_mm(_touches_first_layer(triangles[mesh.is_cut]))
    contours = measure_contours(mesh, up, cost.skin_cos, cost.ring_cos)
    pose_cost = cost if brim_width_mm is None else replace(cost, brim_mm=brim_width_mm)
    cut_mm2 = float(mesh.surfaces.areas_mm2[mesh.is_cut].sum())
    connectors_s = cost.price_connectors_s(hidden_faces.cut_side_mm2, cut_mm2)
    return Pose(
        to_model=_build_transform(rotation, origin_mm),
        size_mm=(width_mm, depth_mm, height_mm),
        price_s=_price_pose_s(features, extents_mm, columns, pose_cost)
        + cost.price_thin_walls_s(thin_walls)
        + cost.price_contours_s(contours, float(features[SKIN_INDEX]))
        + _price_side_ends_s(mesh, up, hidden_faces.cut_side_mm2, cost)
        + connectors_s
        + price_short_layers_s(triangles, cost),
        footing=footing,
        tilt_ratio=_compute_tilt_ratio(footing, columns, height_mm, margins_mm),
        margin_mm=margins_mm[-1],
        support_mm3=columns.support_mm3,
        touched_mm2=columns.touched_mm2,
        footing_extension_mm=BRIM_FOOTING_SHARE * pose_cost.brim_mm,
        brim_width_mm=brim_width_mm,
        layer_0_expansion_mm=expansion_mm,
        bed_face_hidden=hidden_faces.is_bed_hidden and cost.hidden_bed_share > 0.0,
        tops_hidden=hidden_faces.are_tops_hidden and cost.hidden_top_share > 0.0,
        flat_tops_visible=hidden_faces.has_visible_flat_tops,
        connectors_s=connectors_s,
    )


def _place_on_bed(vertices: Floats, rotation: Floats) -> tuple[Floats, Floats, Floats]:
    """Rotate vertices (n, 3), and move them to the middle of the bed.

    Returns
    -------
    tuple
        (n, 3) vertices on the bed, their (3,) extents, and the (3,) point of the rotated part that is moved
        to the middle of the bed.
    """
    rotated_vertices = vertices @ rotation.T
    lo_mm, hi_mm = find_bounds(rotated_vertices[:, None])
    origin_mm = np.array([(lo_mm[0] + hi_mm[0]) / 2.0, (lo_mm[1] + hi_mm[1]) / 2.0, lo_mm[2]])
    return rotated_vertices - origin_mm, hi_mm - lo_mm, origin_mm


def _build_transform(rotation: Floats, origin_mm: Floats) -> Floats:
    """Build the transform (4, 4) from the bed to the model's frame, the inverse of `_place_on_bed`."""
    to_model = np.eye(4)
    to_model[:3, :3], to_model[:3, 3] = rotation.T, rotation.T @ origin_mm
    return to_model


def _measure_thin_walls(triangles: Floats, hidden_faces: HiddenFaces, cost: CostModel) -> ThinWalls:
    """Measure the thin walls and sheets of a part on the bed; hidden skins of sheets are thinner."""
    saved_mm = hidden_faces.compute_saved_height_mm(cost.hidden_bed_mm, cost.hidden_top_mm)
    sheets = SheetLimits(cost.skins_mm - saved_mm, cost.layer_height_mm, cost.skin_cos)
    widths = WallWidths(cost.line_width_mm, cost.outer_walls_mm, cost.walls_mm)
    return measure_thin_walls(triangles, widths, sheets)


def _touches_first_layer(cut_triangles: Floats) -> bool:
    """Check whether a cut face, given as triangles (k, 3, 3), reaches into the first layer."""
    return bool((cut_triangles[:, :, 2].min(axis=1, initial=math.inf) < FIRST_LAYER_MIDDLE_MM).any())


def _price_pose_s(features: Floats, extents_mm: Floats, columns: Columns, cost: CostModel) -> float:
    """Price a pose by its `ADDITIVE_FEATURES` (5,) and extents (3,), corrected by the part's columns."""
    bodies_mm = columns.bodies_mm - HOLE_INSET_SHARE * columns.holes_mm
    return (
        cost.price_part_s([*features[:COLUMN_INDEX], 0.0], extents_mm)
        - cost.price_insets_s(float(features[LATERAL_INDEX]), float(extents_mm[2]), bodies_mm)
        + cost.price_paths_s(columns.island_paths_mm2, columns.holes_mm)
        + cost.price_brim_s(columns.measure_brim_mm2(cost.brim_mm), extents_mm)
        + cost.price_support_s(
            columns.support_mm3, columns.fine_support_side_mm2, columns.towers_mm, columns.islands_mm
        )
    )


def _price_side_ends_s(mesh: PartMesh, up: Floats, cut_side_mm2: float, cost: CostModel) -> float:
    """Price the ends of the hidden sides; measure these ends only if there are hidden sides."""
    return cost.price_side_ends_s(cut_side_mm2, sum_side_ends_mm(mesh, up) if cut_side_mm2 else 0.0)


def _compute_tilt_ratio(
    footing: Footing, columns: Columns, height_mm: float, margins_mm: Sequence[float]
) -> float:
    """Compute the worst ratio of the moments that tilt a growing part to the moment that holds it."""
    area_mm2 = footing.contact_mm2 + SUPPORTED_CONTACT_SHARE * columns.bed_support_mm2
    holding_n_mm = ADHESION_N_PER_MM2 * area_mm2 * footing.width_mm / 2.0
    overhang_mm4 = max(
        volume_mm3 * max(0.0, -margin_mm)
        for volume_mm3, margin_mm in zip(columns.volumes_mm3, margins_mm, strict=True)
    )
    tilting_n_mm = PULL_N * height_mm + WEIGHT_N_PER_MM3 * overhang_mm4
    return float(tilting_n_mm / holding_n_mm) if holding_n_mm > 0.0 else math.inf
