"""Codes and pin holes of a part, read only from the shape in its STL file.

A hole is a ring in a flat face into which a pin fits. Its depth is the distance to the first wall below the
rim of the pin. A code is read as a person reads it: strokes at the bottom of grooves are compared with the
digits of all codes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import shapely
import trimesh

from decompose.arrays import Floats, Ints
from decompose.connectors.marks import LETTER_DEPTH_MM, LETTER_HEIGHT_MM
from decompose.connectors.strokes import GRID_HEIGHT, draw_strokes, measure_text_width
from decompose.geometry import choose_plane_axes

MIN_SEED_MM2, MIN_FACE_MM2 = 4.0, 25.0  # minimum area of the first triangle of a face, and of a face
PLANE_TOLERANCE_MM = 0.01  # maximum distance of the corners of a face from its plane
SLIT_MM = 0.005  # half the width of a slit between triangles of one face
PLAY_RANGE_MM = (0.1, 1.5)  # least and greatest clearance of a hole around its pin
BOTTOM_RISE_MM = 0.03  # half of the difference in height along the bottom of a groove
STROKE_TOLERANCE_MM = 0.12  # maximum distance from a stroke to points at the bottom of its groove
CLEARANCE_SHARE = 0.3  # free margin around a code, as a share of the height of letters
RIM_RAYS = 8  # number of points on the rim of a pin at which the depth is measured
# Minimum width of the groove of a key, and maximum error of its depth.
GROOVE_WIDTH_MM, GROOVE_TOLERANCE_MM = 2.0, 0.1
MIN_HOLE_DEPTH_MM = 1.0  # grooves of codes are shallower


@dataclass(frozen=True, slots=True, eq=False)
class Hole:
    """Hole for a pin, or groove for a key.

    Attributes
    ----------
    position_mm
        (3,) middle of its mouth.
    reach_mm
        Depth at which a pin stops, or half the length of the longest key that fits a groove.
    """

    position_mm: Floats
    reach_mm: float
    is_groove: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class CodedFace:
    """Flat face of a part with holes or codes.

    Attributes
    ----------
    normal
        (3,) unit vector out of the part.
    codes
        Text of each code, and the direction (3,) of its arrow; None if it has no arrow.
    """

    normal: Floats
    offset_mm: float
    holes: list[Hole]
    codes: dict[str, Floats | None] = field(default_factory=dict)


def read_part(path: Path, own_number: str, other_numbers: Iterable[str], pin_mm: float) -> list[CodedFace]:
    """Read the faces of a part that have holes for a pin, or codes.

    Parameters
    ----------
    path
        STL file.
    own_number, other_numbers
        Number of the part, as in the name of its file, and numbers of the other parts.
    pin_mm
        Diameter of the pins.
    """
    mesh = trimesh.load_mesh(path)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    texts = [
        code
        for other_number in other_numbers
        for code in (f"{own_number}-{other_number}", f"-{other_number}")
    ]
    coded_faces = []
    for normal, offset_mm, triangles in find_flat_faces(vertices, faces):
        axes = choose_plane_axes(normal)  # text reads from outside
        outline = _unite_triangles(vertices[triangles] @ axes.T)
        rings = [ring for polygon in shapely.get_parts(outline) for ring in polygon.interiors]
        if not rings:
            continue
        holes = list(_read_holes(rings, vertices[faces], axes, normal, offset_mm, pin_mm))
        holes += _read_grooves(rings, vertices[faces], axes, normal, offset_mm)
        codes = _read_codes(vertices, faces, outline, axes, normal, offset_mm, texts)
        if holes or codes:
            coded_faces.append(CodedFace(normal, offset_mm, holes, codes))
    return coded_faces


def find_flat_faces(vertices: Floats, faces: Ints) -> Iterator[tuple[Floats, float, Ints]]:
    """Yield the flat faces: unit normal (3,) outwards, offset along it, and triangles (m, 3)."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas_mm2 = np.linalg.norm(normals, axis=1) / 2.0
    is_free = np.ones(len(faces), dtype=np.bool_)
    for seed in np.argsort(-areas_mm2):
        if areas_mm2[seed] < MIN_SEED_MM2:
            return
        if not is_free[seed]:
            continue
        normal = normals[seed] / np.linalg.norm(normals[seed])
        offset_mm = float(corners[seed].mean(axis=0) @ normal)
        in_face = (
            is_free
            & (np.abs(corners @ normal - offset_mm) < PLANE_TOLERANCE_MM).all(axis=1)
            & (normals @ normal > 0.0)
        )
        is_free &= ~in_face
        if areas_mm2[in_face].sum() >= MIN_FACE_MM2:
            yield normal, offset_mm, faces[in_face]


def _read_holes(
    rings: Iterable[shapely.LinearRing],
    corners: Floats,
    axes: Floats,
    normal: Floats,
    offset_mm: float,
    pin_mm: float,
) -> Iterator[Hole]:
    for ring in rings:
        circle = shapely.maximum_inscribed_circle(shapely.Polygon(ring), tolerance=0.01)
        if PLAY_RANGE_MM[0] < 2.0 * circle.length - pin_mm < PLAY_RANGE_MM[1]:
            centre = np.array(circle.coords[0])
            angles_rad = 2.0 * np.pi * np.arange(RIM_RAYS) / RIM_RAYS
            rim = centre + 0.49 * pin_mm * np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
            reach_mm = min(
                _measure_distance_to_wall_mm(corners, point @ axes + offset_mm * normal, -normal)
                for point in rim
            )
            if reach_mm > MIN_HOLE_DEPTH_MM:  # not the inside of a digit
                yield Hole(centre @ axes + offset_mm * normal, reach_mm)


def _read_grooves(
    rings: Iterable[shapely.LinearRing], corners: Floats, axes: Floats, normal: Floats, offset_mm: float
) -> Iterator[Hole]:
    """Yield the grooves of keys, which are half as deep as they are wide."""
    for ring in rings:
        box = np.array(shapely.minimum_rotated_rectangle(shapely.Polygon(ring)).exterior.coords)
        width_mm, length_mm = np.sort(np.linalg.norm(np.diff(box[:3], axis=0), axis=1)).tolist()
        if width_mm < GROOVE_WIDTH_MM:
            continue
        position_mm = box[:4].mean(axis=0) @ axes + offset_mm * normal
        if (
            abs(_measure_distance_to_wall_mm(corners, position_mm, -normal) - width_mm / 2.0)
            < GROOVE_TOLERANCE_MM
        ):
            yield Hole(position_mm, (length_mm - width_mm / np.sqrt(2.0)) / 2.0, is_groove=True)


def _measure_distance_to_wall_mm(corners: Floats, start: Floats, direction: Floats) -> float:
    """Measure the distance from a point to the first triangle (m, 3, 3) in a direction (Moeller-Trumbore)."""
    first_edge, second_edge = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, second_edge)
    determinant = np.einsum("ij,ij->i", first_edge, p)
    safe_determinant = np.where(np.abs(determinant) > 1e-12, determinant, np.inf)
    to_start = start - corners[:, 0]
    u = np.einsum("ij,ij->i", to_start, p) / safe_determinant
    q = np.cross(to_start, first_edge)
    v = q @ direction / safe_determinant
    distance_mm = np.einsum("ij,ij->i", second_edge, q) / safe_determinant
    is_hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance_mm > 0.1) & np.isfinite(safe_determinant)
    return float(distance_mm[is_hit].min()) if is_hit.any() else np.inf


def _read_codes(
    vertices: Floats,
    faces: Ints,
    outline: shapely.Geometry,
    axes: Floats,
    normal: Floats,
    offset_mm: float,
    texts: Iterable[str],
) -> dict[str, Floats | None]:
    """Read the codes of a face, each with the direction of its arrow.

    Different digits can have strokes with the same ends. So each stroke must be a line at the bottom of a
    groove, and each such line near the text must be a stroke.
    """
    codes: dict[str, Floats | None] = {}
    depths_mm = offset_mm - vertices @ normal
    is_inside = shapely.contains_xy(shapely.convex_hull(outline), vertices @ axes.T)
    is_bottom = is_inside & (np.abs(depths_mm - LETTER_DEPTH_MM + BOTTOM_RISE_MM) < BOTTOM_RISE_MM + 0.02)
    bottom_points = np.unique((vertices @ axes.T)[is_bottom], axis=0)
    edges = np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    bottom_lines = (vertices @ axes.T)[edges[is_bottom[edges].all(axis=1)]]
    arrows = [(frame, middle) for frame, middle in _find_text("^", LETTER_HEIGHT_MM, bottom_points)]
    on_arrow = np.zeros(len(bottom_points), dtype=np.bool_)
    for frame, middle in arrows:
        on_arrow |= (
            _measure_distances_mm(bottom_points, _draw_text("^", LETTER_HEIGHT_MM) @ frame + middle)
            < STROKE_TOLERANCE_MM
        )
    letter_points = bottom_points[~on_arrow]
    for text in texts:
        for frame, middle in _find_text(text, LETTER_HEIGHT_MM, letter_points):
            strokes = _draw_text(text, LETTER_HEIGHT_MM)
            local_mm = (letter_points - middle) @ frame.T
            half_size_mm = (
                np.array([measure_text_width(text), GRID_HEIGHT]) * LETTER_HEIGHT_MM / GRID_HEIGHT / 2.0
                + CLEARANCE_SHARE * LETTER_HEIGHT_MM
            )
            is_near = (np.abs(local_mm) < half_size_mm).all(axis=1)
            if (_measure_distances_mm(local_mm[is_near], strokes) > STROKE_TOLERANCE_MM).any():
                continue  # part of a longer code
            local_lines_mm = (bottom_lines - middle) @ frame.T
            is_near = (np.abs(local_lines_mm) < half_size_mm).all(axis=(1, 2))
            if not _are_same_lines(strokes, local_lines_mm[is_near]):
                continue  # other digits with the same corners
            arrow_pose = _find_nearest(arrows, middle)
            is_own_arrow = (
                arrow_pose is not None
                and np.linalg.norm(arrow_pose[1] - middle) < half_size_mm[0] + LETTER_HEIGHT_MM
            )
            codes[text] = arrow_pose[0][1] @ axes if arrow_pose is not None and is_own_arrow else None
    return codes


def _are_same_lines(strokes: Floats, lines_mm: Floats) -> bool:
    """Check that each stroke (k, 2, 2) is on lines (n, 2, 2), and each line on strokes, at three points."""
    shares = np.array([0.25, 0.5, 0.75])[:, None]
    return all(
        (
            _measure_distances_mm(
                (lines[:, None, 0] + shares * (lines[:, 1] - lines[:, 0])[:, None]).reshape(-1, 2), others
            )
            < STROKE_TOLERANCE_MM
        ).all()
        for lines, others in ((strokes, lines_mm), (lines_mm, strokes))
    )


def _find_text(text: str, height_mm: float, points: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Find a text in points (n, 2): its frame, whose rows are right and up, and its middle (2,)."""
    strokes = _draw_text(text, height_mm)
    ends = np.unique(np.round(strokes.reshape(-1, 2), 6), axis=0)
    if len(points) < len(ends):
        return
    end_distances_mm = np.linalg.norm(ends[:, None] - ends[None], axis=2)
    i, j = np.unravel_index(int(end_distances_mm.argmax()), end_distances_mm.shape)
    poses: list[tuple[Floats, Floats]] = []
    point_distances_mm = np.linalg.norm(points[:, None] - points[None], axis=2)
    for a, b in np.argwhere(np.abs(point_distances_mm - end_distances_mm[i, j]) < STROKE_TOLERANCE_MM):
        text_direction, point_direction = ends[j] - ends[i], points[b] - points[a]
        turn_rad = np.arctan2(point_direction[1], point_direction[0]) - np.arctan2(
            text_direction[1], text_direction[0]
        )
        frame = np.array([[np.cos(turn_rad), np.sin(turn_rad)], [-np.sin(turn_rad), np.cos(turn_rad)]])
        middle = points[a] - ends[i] @ frame
        gaps_mm = np.linalg.norm((ends @ frame + middle)[:, None] - points[None], axis=2).min(axis=1)
        # Digits may have the same corners if they are turned by 180 degrees.
        if gaps_mm.max() < STROKE_TOLERANCE_MM and all(
            np.linalg.norm(middle - other_middle) > 1.0 or frame[0] @ other_frame[0] < 0.5
            for other_frame, other_middle in poses
        ):
            poses.append((frame, middle))
            yield frame, middle


def _draw_text(text: str, height_mm: float) -> Floats:
    return draw_strokes(text) * (height_mm / GRID_HEIGHT)


def _find_nearest(arrows: list[tuple[Floats, Floats]], middle: Floats) -> tuple[Floats, Floats] | None:
    """Find the arrow, a frame (2, 2) with its middle (2,), nearest to a middle; None without arrows."""
    distances_mm = [float(np.linalg.norm(arrow_middle - middle)) for _, arrow_middle in arrows]
    return arrows[int(np.argmin(distances_mm))] if arrows else None


def _measure_distances_mm(points: Floats, strokes: Floats) -> Floats:
    """Measure the distances (n,) of points (n, 2) to strokes (k, 2, 2)."""
    directions = strokes[:, 1] - strokes[:, 0]
    length2 = np.maximum((directions**2).sum(axis=1), 1e-12)
    share = np.clip(((points[:, None] - strokes[None, :, 0]) * directions).sum(axis=2) / length2, 0.0, 1.0)
    nearest = strokes[None, :, 0] + share[..., None] * directions
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1, initial=np.inf))


def _unite_triangles(triangles: Floats) -> shapely.Geometry:
    """Unite triangles (n, 3, 2), and close the slits that rounding leaves, which would open rings."""
    rings = np.concatenate([triangles, triangles[:, :1]], axis=1)
    union = shapely.union_all(shapely.polygons(rings), grid_size=1e-3)
    return union.buffer(SLIT_MM, join_style="mitre").buffer(-SLIT_MM, join_style="mitre")
