"""Change of a part's print time for each mm by which one of its cut faces moves.

The surfaces at the outline of the cut face become longer or shorter, and the area of the cut face itself
changes where they are oblique. So the slope follows from the part as it is, without cutting it again.

Only the terms of `compute_price_s` without supports are counted, with the brim of the print settings. Those
that are measured on a part in a pose, such as thin walls, contours and islands, are not, and neither are
connectors.
"""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.print_time.cost import CostModel
from decompose.print_time.hidden_faces import LEVEL_COS, MAX_UPRIGHT_COS, find_hidden_faces
from decompose.print_time.part_mesh import PartMesh
from decompose.print_time.pose_prices import sum_pose_features

MIN_SINE = (
    0.05  # a surface that meets the cut face at a smaller angle (3 degrees) counts as one at this angle
)
STEP_MM = 1.0  # move over which the slope is computed


def measure_face_slopes(
    mesh: PartMesh, rotation: Floats, face_planes: Ints, normals: Floats, cost: CostModel
) -> Floats:
    """Measure by how much the print time of a part grows for each mm by which a cut face moves outward.

    Parameters
    ----------
    mesh
        Closed mesh of the part, facing outward.
    rotation
        (3, 3) rotation of its pose, whose rows are the bed's x, y and z in the model's frame.
    face_planes
        (m,) number of the cut plane on which each face lies; negative for faces on none.
    normals
        (k, 3) outward unit normal of each cut plane.
    cost
        Cost model of the print time.

    Returns
    -------
    ndarray
        (k,) s per mm; 0 for a plane on which no face lies.
    """
    (features,), (extents_mm,) = sum_pose_features(
        mesh.vertices, mesh.faces, rotation[None], cost, is_cut=mesh.is_cut
    )
    cost = cost.fit_layers(float(extents_mm[2]))
    up = np.ascontiguousarray(rotation[2])
    weights = _weigh_faces(mesh, up, cost)
    areas_mm2, growth = _sum_growth(mesh, face_planes, normals, weights)
    corners_mm = mesh.vertices @ rotation.T
    low_mm, high_mm = corners_mm.min(axis=0), corners_mm.max(axis=0)
    features[-1] = 0.0  # without supports
    old_s = cost.price_part_s(features, extents_mm)
    slopes_s_per_mm = np.zeros(len(normals))
    for plane in np.flatnonzero(areas_mm2):
        new_features = features.copy()
        new_features[0] += STEP_MM * areas_mm2[plane]
        new_features[1:-1] = np.maximum(0.0, new_features[1:-1] + STEP_MM * growth[plane])
        moved_mm = corners_mm[mesh.faces[face_planes == plane]] + STEP_MM * rotation @ normals[plane]
        new_extents_mm = np.maximum(high_mm, moved_mm.max(axis=(0, 1))) - np.minimum(
            low_mm, moved_mm.min(axis=(0, 1))
        )
        slopes_s_per_mm[plane] = (cost.price_part_s(new_features, new_extents_mm) - old_s) / STEP_MM
    return slopes_s_per_mm


def _weigh_faces(mesh: PartMesh, up: Floats, cost: CostModel) -> Floats:
    """Compute the features (m, 3) of each mm2 of a face: `lateral_mm2`, `skin_mm2` and `slope_mm2`.

    As in `sum_pose_features`, which sums them over whole faces, hidden faces count less.
    """
    surfaces, is_cut = mesh.surfaces, mesh.is_cut
    rises = surfaces.normals @ up
    hidden_faces = find_hidden_faces(surfaces, is_cut, up, float((mesh.vertices @ up).min()), cost.skin_cos)
    lateral = np.sqrt(np.maximum(0.0, 1.0 - rises * rises))
    has_skin = np.abs(rises) > cost.skin_cos
    is_side = is_cut & (np.abs(rises) < MAX_UPRIGHT_COS)
    saved_share = np.where(
        is_cut & (rises < -LEVEL_COS) & hidden_faces.is_bed_hidden, cost.hidden_bed_share, 0.0
    ) + np.where(is_cut & (rises > cost.skin_cos) & hidden_faces.are_tops_hidden, cost.hidden_top_share, 0.0)
    return np.column_stack(
        [
            lateral - cost.hidden_side_share * is_side,
            has_skin * np.abs(rises) * (1.0 - saved_share),
            has_skin * lateral,
        ]
    )


def _sum_growth(mesh: PartMesh, face_planes: Ints, normals: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Sum the area (k,) of each cut face, and the growth (k, 3) of weighted areas for each mm outward.

    Parameters
    ----------
    mesh, face_planes, normals
        As in `measure_face_slopes`.
    weights
        (m, 3) features for each mm2 of a face.
    """
    surfaces, count = mesh.surfaces, len(normals)
    is_on_plane = face_planes >= 0
    areas_mm2 = np.bincount(face_planes[is_on_plane], surfaces.areas_mm2[is_on_plane], count)
    half_edges = np.concatenate([mesh.edges, mesh.edges[:, ::-1]])
    face_pairs = half_edges // 3
    is_outline = is_on_plane[face_pairs[:, 0]] & (np.diff(face_planes[face_pairs], axis=1)[:, 0] != 0)
    half_edges, (cut_faces, other_faces) = half_edges[is_outline, 0], face_pairs[is_outline].T
    begins = mesh.vertices[mesh.faces[cut_faces, half_edges % 3]]
    ends = mesh.vertices[mesh.faces[cut_faces, (half_edges % 3 + 1) % 3]]
    lengths_mm = np.linalg.norm(ends - begins, axis=1)
    planes = face_planes[cut_faces]
    cosines = (surfaces.normals[other_faces] * normals[planes]).sum(axis=1)
    sines = np.maximum(MIN_SINE, np.sqrt(np.maximum(0.0, 1.0 - cosines * cosines)))
    # Each mm uncovers a strip of the other face, and moves the outline within the plane.
    strips_mm = (lengths_mm / sines)[:, None] * weights[other_faces]
    strips_mm -= (lengths_mm * cosines / sines)[:, None] * weights[cut_faces]
    growth = np.column_stack([np.bincount(planes, column, count) for column in strips_mm.T])
    return areas_mm2.astype(np.float64), growth.astype(np.float64)
