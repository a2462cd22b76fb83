"""Shapes of an assembly step: its two bodies drawn apart, the faces to glue, marks, pins and holes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.assembly import AssemblyStep
from decompose.connectors import Mark, Pin, Tool
from decompose.export.picture import make_part_colours
from decompose.export.raster import Shape
from decompose.geometry import choose_plane_axes, triangulate
from decompose.pieces import JointFace, find_cut_faces, list_polygons
from decompose.results import Decomposition

GLUE_COLOUR = np.array([1.0, 0.35, 0.0])
MARK_COLOUR = np.array([0.08, 0.08, 0.08])
PIN_COLOUR = np.array([0.1, 0.35, 0.9])
TABLE_COLOUR = np.array([0.9, 0.9, 0.92])
# Distance of a drawn face in front of the part's own face; that of marks and holes is three times as large.
LIFT_HEIGHT_MM = 0.05
MIN_STROKE_MM, MIN_STROKE_SHARE = 1.2, 0.005  # minimum width of a stroke; share: of the body's extent
TABLE_MARGIN_SHARE = 0.1  # margin of the table around the body, as a share of its size
ROD_SIDES = 12  # number of a pin's side faces


@dataclass(frozen=True, slots=True, eq=False)
class GluedFace:
    """A face of a joint, and its unit normal (3,) out of the body on which it is drawn."""

    face: JointFace
    outward_normal: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Shapes of one or both bodies of a step, in the model's frame.

    Attributes
    ----------
    parts
        Numbers of the parts.
    glued_faces
        Faces to glue.
    pins
        Pins of the step, each drawn as one shape: a rod, or the mouth of its hole.
    shapes
        Shapes of the parts, of the glued faces and of the pins, in the order of these attributes; then other
        shapes.
    """

    parts: tuple[int, ...]
    glued_faces: Sequence[GluedFace]
    pins: Sequence[Pin]
    shapes: list[Shape]

    @property
    def first_pin_shape(self) -> int:
        """Number of the first pin's shape."""
        return len(self.parts) + len(self.glued_faces)


def find_glued_faces(step: AssemblyStep, decomposition: Decomposition) -> list[GluedFace]:
    """Find the faces that a step glues, with normals away from the fixed body.

    The triangles of the fixed part in the plane of a face show on which side the part is.

    Parameters
    ----------
    step
        Step of the assembly.
    decomposition
        Decomposition with the parts and their joints.
    """
    glued_faces = []
    for joint in (decomposition.joints[number] for number in step.joints):
        fixed_part = decomposition.parts[joint.a if joint.a in step.fixed_parts else joint.b]
        vertices, faces = fixed_part.solid.arrays()
        for face in joint.faces:
            plane = np.append(face.normal, face.offset_mm)[None]
            a, b, c = np.moveaxis(vertices[faces[find_cut_faces(vertices, faces, plane)]], 1, 0)
            signed_area = float((np.cross(b - a, c - a) @ face.normal).sum())
            glued_faces.append(GluedFace(face, face.normal if signed_area >= 0.0 else -face.normal))
    return glued_faces


def build_both_bodies(step_index: int, decomposition: Decomposition, moved_offset_mm: Floats) -> Scene:
    """Build the scene of both bodies of a step: the fixed one with the pins, on a table if it can stand.

    Parameters
    ----------
    step_index
        Index of the step.
    decomposition
        Decomposition with the parts, in mm.
    moved_offset_mm
        (3,) offset of the moved body from its final position.

    Returns
    -------
    Scene
        Shapes in the model's frame.
    """
    step = decomposition.assembly.steps[step_index]
    glued_faces = find_glued_faces(step, decomposition)
    pins = [pin for pin in decomposition.connectors.pins if pin.step == step_index]
    shapes = [
        *_build_part_shapes(step.fixed_parts, decomposition, np.zeros(3)),
        *_build_part_shapes(step.moved_parts, decomposition, moved_offset_mm),
        *(Shape(fill_face(entry.face, entry.outward_normal), GLUE_COLOUR) for entry in glued_faces),
        *(Shape(_make_rod(pin), PIN_COLOUR) for pin in pins),
        *(
            Shape(fill_face(entry.face, -entry.outward_normal) + moved_offset_mm, GLUE_COLOUR)
            for entry in glued_faces
        ),
        *_build_mark_shapes(step, step.fixed_parts, decomposition),
    ]
    if step.rests_on:
        shapes.append(Shape(_make_table(step, decomposition), TABLE_COLOUR))
    return Scene((*step.fixed_parts, *step.moved_parts), glued_faces, pins, shapes)


def build_moved_body(step_index: int, decomposition: Decomposition) -> Scene:
    """Build the scene of only the moved body of a step, with the mouths of its holes.

    Parameters
    ----------
    step_index, decomposition
        As in `build_both_bodies`.
    """
    step = decomposition.assembly.steps[step_index]
    glued_faces = [
        GluedFace(entry.face, -entry.outward_normal) for entry in find_glued_faces(step, decomposition)
    ]
    pins = [pin for pin in decomposition.connectors.pins if pin.step == step_index]
    shapes = [
        *_build_part_shapes(step.moved_parts, decomposition, np.zeros(3)),
        *(Shape(fill_face(entry.face, entry.outward_normal), GLUE_COLOUR) for entry in glued_faces),
        *(Shape(_fill_mouth(pin.holes[0]), MARK_COLOUR) for pin in pins),
        *_build_mark_shapes(step, step.moved_parts, decomposition),
    ]
    return Scene(step.moved_parts, glued_faces, pins, shapes)


def fill_face(face: JointFace, outward_normal: Floats) -> Floats:
    """Fill the outline of a face with triangles, slightly in front of the face.

    Parameters
    ----------
    face
        Face of a joint.
    outward_normal
        (3,) unit normal towards the viewer.

    Returns
    -------
    ndarray
        (m, 3, 3) triangles in mm.
    """
    offset_mm = face.offset_mm * face.normal + LIFT_HEIGHT_MM * outward_normal
    triangles = []
    for polygon in list_polygons(face.outline):
        oriented_polygon = shapely.geometry.polygon.orient(polygon)
        rings = [
            np.array(ring.coords)[:-1] for ring in (oriented_polygon.exterior, *oriented_polygon.interiors)
        ]
        corners = np.concatenate(rings) @ face.axes + offset_mm
        triangles.append(_orient_triangles(corners[triangulate(rings)], outward_normal))
    return np.concatenate(triangles) if triangles else np.zeros((0, 3, 3))


def _build_part_shapes(parts: Sequence[int], decomposition: Decomposition, offset_mm: Floats) -> list[Shape]:
    """Build the shapes of parts, each in its own colour, moved by an offset (3,)."""
    colours = make_part_colours(len(decomposition.parts))
    shapes = []
    for number in parts:
        vertices, faces = decomposition.parts[number].solid.arrays()
        shapes.append(Shape((vertices + offset_mm)[faces], colours[number]))
    return shapes


def _build_mark_shapes(step: AssemblyStep, body: Sequence[int], decomposition: Decomposition) -> list[Shape]:
    """Build the shapes of the marks on the glued faces of one body."""
    bounds = np.array([decomposition.parts[part].solid.bounds_mm for part in body])
    extent_mm = float(np.linalg.norm(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)))
    return [
        Shape(_make_ribbons(mark, max(MIN_STROKE_MM, MIN_STROKE_SHARE * extent_mm)), MARK_COLOUR)
        for mark in decomposition.connectors.marks
        if mark.part in body and mark.joint in step.joints
    ]


def _make_ribbons(mark: Mark, width_mm: float) -> Floats:
    """Make triangles (m, 3, 3) of the strokes of a mark as flat ribbons, in front of its face."""
    outward_normal = -mark.grooves[0].inward_normal
    ends = mark.lines_mm + 3.0 * LIFT_HEIGHT_MM * outward_normal
    strokes = ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(strokes, axis=1, keepdims=True)
    dot_direction = choose_plane_axes(outward_normal)[0]  # a dot has no direction of its own
    directions = np.where(lengths > 0.0, strokes / np.maximum(lengths, 1e-9), dot_direction)
    half_mm = width_mm / 2.0 * np.cross(outward_normal, directions)
    a, b = ends[:, 0] - width_mm / 2.0 * directions, ends[:, 1] + width_mm / 2.0 * directions
    corners = np.stack([a - half_mm, b - half_mm, b + half_mm, a + half_mm], axis=1)
    return _orient_triangles(np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]), outward_normal)


def _make_rod(pin: Pin) -> Floats:
    """Make triangles (m, 3, 3) of a pin in its place."""
    angles_rad = 2.0 * np.pi * np.arange(ROD_SIDES) / ROD_SIDES
    circle = np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
    ring = pin.diameter_mm / 2.0 * circle @ choose_plane_axes(pin.rod_axis)
    ends = [pin.position_mm + sign * pin.length_mm / 2.0 * pin.rod_axis for sign in (-1.0, 1.0)]
    low, high = (ring + end for end in ends)
    after_low, after_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    return np.concatenate(
        [
            np.stack([low, after_low, high], axis=1),
            np.stack([after_low, after_high, high], axis=1),
            np.stack([np.broadcast_to(ends[1], high.shape), high, after_high], axis=1),
            np.stack([np.broadcast_to(ends[0], low.shape), after_low, low], axis=1),
        ]
    )


def _fill_mouth(hole: Tool) -> Floats:
    """Fill the mouth of a hole with triangles (m, 3, 3), in front of its face."""
    depths_mm = hole.points_mm @ hole.inward_normal
    mouth = hole.points_mm[depths_mm < depths_mm.min() + 1e-6]
    axes = choose_plane_axes(hole.inward_normal)
    ring = np.array(shapely.MultiPoint(mouth @ axes.T).convex_hull.exterior.coords)[:-1]
    corners = ring @ axes + (hole.face_offset_mm - 3.0 * LIFT_HEIGHT_MM) * hole.inward_normal
    return _orient_triangles(corners[triangulate([ring])], -hole.inward_normal)


def _make_table(step: AssemblyStep, decomposition: Decomposition) -> Floats:
    """Make two triangles (2, 3, 3) of a table below the fixed body; the step's direction is up."""
    points = np.concatenate([decomposition.parts[part].solid.arrays()[0] for part in step.fixed_parts])
    up = step.direction
    axes = choose_plane_axes(up)
    coordinates_mm = points @ axes.T
    low_mm, high_mm = coordinates_mm.min(axis=0), coordinates_mm.max(axis=0)
    margin_mm = TABLE_MARGIN_SHARE * float((high_mm - low_mm).max())
    (x0, y0), (x1, y1) = low_mm - margin_mm, high_mm + margin_mm
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) @ axes
    corners += (float((points @ up).min()) - LIFT_HEIGHT_MM) * up
    return _orient_triangles(corners[[[0, 1, 2], [0, 2, 3]]], up)


def _orient_triangles(triangles: Floats, outward_normal: Floats) -> Floats:
    """Orient flat triangles (m, 3, 3) so that they face a direction (3,)."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    is_reversed = normal @ outward_normal < 0.0
    oriented_triangles = triangles.copy()
    oriented_triangles[is_reversed] = oriented_triangles[is_reversed][:, ::-1]
    return oriented_triangles
