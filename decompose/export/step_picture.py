"""Picture of a step of the assembly: two bodies apart, the faces to glue tinted, an arrow, parts' numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.assembly import AssemblyStep
from decompose.export.glb import find_moves
from decompose.export.picture import (
    AZIMUTH_DEG,
    encode_png,
    make_figure,
    part_colours,
    write_labels,
)
from decompose.export.raster import Drawing, Shape, draw, make_camera
from decompose.files.names import short_label
from decompose.geometry import triangulate
from decompose.pieces import JointFace, find_cut_faces
from decompose.results import Decomposition

GLUE_COLOUR = np.array([1.0, 0.35, 0.0])
LIFT_MM = 0.05  # of the tint off its face
AZIMUTHS_DEG = [AZIMUTH_DEG + turn for turn in (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)]
ELEVATIONS_DEG = (22.0, 45.0, -22.0, -45.0)
BEST_TILT = 0.5  # cosine between a face and the eye at which the face and the gap beside it are both seen
TURN_COST = 0.2  # for each 45 degrees that the eye turns from the step before
LONGEST_PX = 620


@dataclass(frozen=True, slots=True, eq=False)
class GluedFace:
    """Face of a step's joint, and its unit normal (3,) away from the fixed body."""

    face: JointFace
    outward: Floats


def find_glued_faces(step: AssemblyStep, decomposition: Decomposition) -> list[GluedFace]:
    """Find the faces that a step glues; the fixed part's own triangles on the plane tell its outside."""
    found = []
    for joint in (decomposition.joints[number] for number in step.joints):
        fixed = decomposition.parts[joint.a if joint.a in step.fixed else joint.b]
        vertices, faces = fixed.solid.arrays()
        for face in joint.faces:
            plane = np.append(face.normal, face.offset_mm)[None]
            a, b, c = np.moveaxis(vertices[faces[find_cut_faces(vertices, faces, plane)]], 1, 0)
            outside = float((np.cross(b - a, c - a) @ face.normal).sum())
            found.append(GluedFace(face, face.normal if outside >= 0.0 else -face.normal))
    return found


def choose_camera(glued: Sequence[GluedFace], before: Floats | None) -> Floats:
    """Choose the view that shows the glued faces of the fixed body best; rather that of the step before.

    Parameters
    ----------
    glued
        Faces of the step.
    before
        Camera of the step before, (3, 3) as of `raster.make_camera`.

    Returns
    -------
    ndarray
        (3, 3).
    """
    whole_mm2 = sum(entry.face.area_mm2 for entry in glued) or 1.0

    def merit(camera: Floats) -> float:
        eye = camera[2]
        tilts = ((entry.face.area_mm2, float(entry.outward @ eye)) for entry in glued)
        shown = sum(area_mm2 * (1.0 - abs(tilt - BEST_TILT)) for area_mm2, tilt in tilts if tilt > 0.0)
        turn = 0.0 if before is None else np.arccos(np.clip(eye @ before[2], -1.0, 1.0)) / (np.pi / 4.0)
        return float(shown / whole_mm2 - TURN_COST * turn)

    cameras = [make_camera(a, e) for e, a in product(ELEVATIONS_DEG, AZIMUTHS_DEG)]
    return max(cameras, key=merit)


def draw_step(
    step: AssemblyStep, glued: Sequence[GluedFace], decomposition: Decomposition, camera: Floats
) -> bytes:
    """Draw a step.

    Parameters
    ----------
    step, glued
        The step, and its faces.
    decomposition
        Has the parts, in mm.
    camera
        (3, 3) as of `raster.make_camera`.

    Returns
    -------
    bytes
        PNG.
    """
    parts, colours = decomposition.parts, part_colours(len(decomposition.parts))
    [apart_mm] = find_moves(parts, [step])
    shapes, labels = [], []
    for number in (*step.fixed, *step.moved):
        vertices, faces = parts[number].solid.arrays()
        offset_mm = apart_mm if number in step.moved else np.zeros(3)
        shapes.append(Shape((vertices + offset_mm)[faces], colours[number]))
        labels.append(short_label(parts[number].id))
    for entry in glued:
        shapes.append(Shape(_fill(entry.face, entry.outward), GLUE_COLOUR))
        shapes.append(Shape(_fill(entry.face, -entry.outward) + apart_mm, GLUE_COLOUR))
    drawing = draw(shapes, camera, LONGEST_PX, oversample=2)
    figure, axes = make_figure(drawing)
    write_labels(axes, drawing, labels)
    _draw_arrow(axes, drawing, step, decomposition, apart_mm)
    return encode_png(figure)


def _fill(face: JointFace, outward: Floats) -> Floats:
    """Build triangles (m, 3, 3) of a face, a little before it."""
    offset_mm = face.offset_mm * face.normal + LIFT_MM * outward
    found = []
    for polygon in shapely.get_parts(face.outline):
        if polygon.geom_type != "Polygon":
            continue
        ordered = shapely.geometry.polygon.orient(polygon)
        rings = [np.array(ring.coords)[:-1] for ring in (ordered.exterior, *ordered.interiors)]
        corners = np.concatenate(rings) @ face.axes + offset_mm
        triangles = corners[triangulate(rings)]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        back = normal @ outward < 0.0
        triangles[back] = triangles[back][:, ::-1]
        found.append(triangles)
    return np.concatenate(found) if found else np.zeros((0, 3, 3))


def _draw_arrow(
    axes: Any, drawing: Drawing, step: AssemblyStep, decomposition: Decomposition, apart_mm: Floats
) -> None:
    """Draw the way of the moved body as an arrow from its middle."""
    bounds = [decomposition.parts[number].solid.bounds_mm for number in step.moved]
    middle = np.mean([bound.mean(axis=0) for bound in bounds], axis=0)
    start, end = drawing.place(np.array([middle + apart_mm, middle]))
    axes.annotate(
        "",
        xy=end,
        xytext=start,
        arrowprops={"arrowstyle": "-|>", "lw": 4, "mutation_scale": 25, "color": "black"},
    )


def draw_steps(decomposition: Decomposition) -> list[bytes]:
    """Draw all steps of the assembly as PNG, each from a view near to that of the step before."""
    pictures: list[bytes] = []
    camera: Floats | None = None
    for step in decomposition.assembly.steps:
        glued = find_glued_faces(step, decomposition)
        camera = choose_camera(glued, camera)
        pictures.append(draw_step(step, glued, decomposition, camera))
    return pictures
