"""Pictures of an assembly step: both bodies with the joint upwards, and the moved body turned over."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np

from decompose.arrays import Floats
from decompose.assembly import AssemblyStep
from decompose.connectors import Pin
from decompose.export.canvas import Canvas
from decompose.export.glb import find_movements_mm
from decompose.export.picture import AZIMUTH_DEG
from decompose.export.pin_sheet import format_pin_size
from decompose.export.raster import draw_shapes, make_camera
from decompose.export.step_scene import Scene, build_both_bodies, build_moved_body
from decompose.files.names import find_part_number
from decompose.geometry import find_smallest_rotation
from decompose.results import Decomposition

AZIMUTHS_DEG = [AZIMUTH_DEG + turn for turn in (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)]
ELEVATIONS_DEG = (22.0, 38.0)
TURNED_OVER_ELEVATIONS_DEG = (35.0, 60.0)  # elevations of the views of the moved body alone
# Best cosine between a face's normal and the direction to the eye; at this tilt the gap is visible too.
BEST_TILT_COS = 0.5
TURN_COST = 0.1  # cost of each 45 degrees between the azimuth of the eye and that in the previous step
PIN_GAIN = 0.5  # gain if all pins are visible
# Maximum number of views that are drawn in a small size to find hidden faces and pins, and this size.
MAX_DRAWN_VIEWS, DRAWN_VIEW_PX = 5, 160
# Gap below the moved body, as a share of the glued faces' extent perpendicular to the step's direction.
GAP_SHARE = 0.7
BOTH_BODIES_PX, MOVED_BODY_PX = 860, 520  # longer sides of the pictures
DRAWING_THREADS = 2
SCALE_LENGTHS_MM = (10.0, 20.0, 50.0, 100.0)  # lengths of the scale bar
PIN_PT, SCALE_PT = 12.0, 11.0  # text sizes at pins and at the scale bar
ROD_PT, BAR_PT = 1.6, 3.0  # widths of the line from a pin to its hole, and of the scale bar
PIN_INK, ARROW_INK = "#0b2f8a", "#303030"


@dataclass(frozen=True, slots=True, eq=False)
class StepPictures:
    """Pictures of one step, as PNG.

    Attributes
    ----------
    both_bodies
        Picture of both bodies apart, the fixed one below.
    moved_body
        Picture of the moved body, turned over so that its glued faces are visible.
    top_direction
        Direction of the model's top in `both_bodies`, such as "upwards" or "to the left".
    """

    both_bodies: bytes
    moved_body: bytes
    top_direction: str


def draw_steps(
    decomposition: Decomposition, first_step: int = 0, end_step: int | None = None
) -> list[StepPictures]:
    """Draw steps of the assembly, each from a view close to that of the previous step.

    Parameters
    ----------
    decomposition
        Decomposition with the parts and the steps.
    first_step, end_step
        Half-open range of the steps that are drawn; all by default. The views of earlier steps are computed
        too.
    """
    drawings: list[Future[StepPictures]] = []
    azimuth_deg: float | None = None
    # This thread chooses the views, while others draw the pictures.
    with ThreadPoolExecutor(DRAWING_THREADS) as executor:
        for number, step in enumerate(decomposition.assembly.steps[:end_step]):
            offset_mm = find_gap_mm(step, decomposition) * step.direction
            scene = build_both_bodies(number, decomposition, offset_mm)
            pose = find_pose(step.direction)
            azimuth_deg, elevation_deg = choose_view(scene, pose, ELEVATIONS_DEG, azimuth_deg)
            if number >= first_step:
                camera = make_camera(azimuth_deg, elevation_deg) @ pose
                turned_pose = turn_pose_over(pose, azimuth_deg)
                cameras = StepCameras(camera, turned_pose, azimuth_deg)
                drawings.append(executor.submit(_draw_step, number, decomposition, offset_mm, cameras))
    return [drawing.result() for drawing in drawings]


def find_pose(direction: Floats) -> Floats:
    """Find the pose in which a direction of the model points upwards.

    The model is rotated as little as possible; if it is turned upside down, its right side stays on the
    right.

    Parameters
    ----------
    direction
        (3,) unit vector in the model's frame.

    Returns
    -------
    ndarray
        (3, 3) directions to the right, back and up in the model's frame, as rows.
    """
    if direction[2] < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    return find_smallest_rotation(direction, np.array([0.0, 0.0, 1.0]))


def turn_pose_over(pose: Floats, azimuth_deg: float) -> Floats:
    """Rotate a pose by 180 degrees about the axis to the viewer's right, to show a body from below.

    Parameters
    ----------
    pose
        (3, 3) directions to the right, back and up, as rows.
    azimuth_deg
        Azimuth of the eye.
    """
    right = make_camera(azimuth_deg, 0.0)[0]
    half_turn: Floats = 2.0 * np.outer(right, right) - np.eye(3)
    return half_turn @ pose


def find_gap_mm(step: AssemblyStep, decomposition: Decomposition) -> float:
    """Compute a gap between the drawn bodies that is large enough to show their glued faces.

    Parameters
    ----------
    step
        Step of the assembly.
    decomposition
        Decomposition with the parts and their joints.
    """
    [move_mm] = find_movements_mm(decomposition.parts, [step])
    corners = [
        np.array(face.outline.envelope.exterior.coords) @ face.axes
        for joint in step.joints
        for face in decomposition.joints[joint].faces
    ]
    if not corners:
        return float(np.linalg.norm(move_mm))
    across = np.concatenate(corners) @ (np.eye(3) - np.outer(step.direction, step.direction))
    return max(float(np.linalg.norm(move_mm)), GAP_SHARE * float(np.ptp(across, axis=0).max()))


def choose_view(
    scene: Scene, pose: Floats, elevations_deg: Sequence[float], previous_azimuth_deg: float | None
) -> tuple[float, float]:
    """Choose the view that shows most of the glued faces and pins, close to that of the previous step.

    Parameters
    ----------
    scene
        Shapes in the model's frame.
    pose
        (3, 3) directions to the right, back and up in that frame, as rows.
    elevations_deg
        Elevations of the eye that are tried.
    previous_azimuth_deg
        Azimuth of the previous step; None for the first one.

    Returns
    -------
    (float, float)
        Azimuth and elevation, for `raster.make_camera`.
    """
    areas_mm2 = np.array([entry.face.area_mm2 for entry in scene.glued_faces])
    outwards = np.array([entry.outward_normal for entry in scene.glued_faces]).reshape(-1, 3)

    def score_view(view: tuple[float, float]) -> float:
        tilts = outwards @ (make_camera(*view) @ pose)[2]
        visible_mm2 = areas_mm2 @ np.where(tilts > 0.0, 1.0 - np.abs(tilts - BEST_TILT_COS), 0.0)
        turn_deg = (
            0.0
            if previous_azimuth_deg is None
            else abs((view[0] - previous_azimuth_deg + 180.0) % 360.0 - 180.0)
        )
        return float(visible_mm2 / (areas_mm2.sum() or 1.0) - TURN_COST * turn_deg / 45.0)

    def score_drawing(view: tuple[float, float]) -> float:
        drawing = draw_shapes(scene.shapes, make_camera(*view) @ pose, DRAWN_VIEW_PX, oversampling=1)
        visible_pixels = np.bincount(drawing.front_shapes.ravel(), minlength=1 + len(scene.shapes))[1:]
        glued_mm2 = visible_pixels[len(scene.parts) : scene.first_pin_shape].sum() / drawing.pixels_per_mm**2
        is_pin_visible = visible_pixels[scene.first_pin_shape : scene.first_pin_shape + len(scene.pins)] > 0
        return float(glued_mm2 / (areas_mm2.sum() or 1.0)) + PIN_GAIN * float(
            is_pin_visible.mean() if len(is_pin_visible) else 0.0
        )

    views = [
        (azimuth_deg, elevation_deg) for elevation_deg, azimuth_deg in product(elevations_deg, AZIMUTHS_DEG)
    ]
    best_views = sorted(views, key=score_view, reverse=True)[:MAX_DRAWN_VIEWS]
    return max(best_views, key=lambda view: score_drawing(view) + score_view(view))


def name_top_direction(camera: Floats) -> str:
    """Name the direction of the model's top in the picture of a camera (3, 3)."""
    right, up, towards_eye = camera[:, 2]
    names = [
        (up, "upwards"), (-up, "downwards"), (right, "to the right"), (-right, "to the left"),
        (towards_eye, "towards you"), (-towards_eye, "away from you"),
    ]  # fmt: skip
    return max(names)[1]


@dataclass(frozen=True, slots=True, eq=False)
class StepCameras:
    """Cameras of a step.

    Attributes
    ----------
    both_bodies
        (3, 3) camera of the picture of both bodies.
    turned_pose
        (3, 3) pose of the moved body, turned over.
    azimuth_deg
        Azimuth of the picture of both bodies; the picture of the moved body has a similar azimuth.
    """

    both_bodies: Floats
    turned_pose: Floats
    azimuth_deg: float


def _draw_step(
    step_index: int, decomposition: Decomposition, offset_mm: Floats, cameras: StepCameras
) -> StepPictures:
    """Draw a step: both bodies, and the moved body from its best view."""
    step = decomposition.assembly.steps[step_index]
    # The scene is built again, because stored scenes would fill the memory.
    scene = build_both_bodies(step_index, decomposition, offset_mm)
    both_picture = _draw_both_bodies(scene, step, decomposition, cameras.both_bodies, offset_mm)
    moved_scene = build_moved_body(step_index, decomposition)
    view = choose_view(moved_scene, cameras.turned_pose, TURNED_OVER_ELEVATIONS_DEG, cameras.azimuth_deg)
    moved_picture = _draw_moved_body(moved_scene, decomposition, make_camera(*view) @ cameras.turned_pose)
    return StepPictures(both_picture, moved_picture, name_top_direction(cameras.both_bodies))


def _draw_both_bodies(
    scene: Scene, step: AssemblyStep, decomposition: Decomposition, camera: Floats, offset_mm: Floats
) -> bytes:
    """Draw both bodies of a step, with the numbers of parts, sizes of pins, movement and scale, as PNG."""
    canvas = Canvas(draw_shapes(scene.shapes, camera, BOTH_BODIES_PX))
    canvas.write_labels([find_part_number(decomposition.parts[number].id) for number in scene.parts])
    for pin in scene.pins:
        rod_mm = np.array([_find_tip(pin), pin.position_mm + offset_mm])
        canvas.draw_dots(canvas.drawing.find_pixels(rod_mm), ROD_PT, PIN_INK)
    _write_pin_sizes(canvas, scene, [_find_tip(pin) for pin in scene.pins])
    _draw_arrow(canvas, step, decomposition, offset_mm)
    _draw_scale(canvas)
    return canvas.encode_png()


def _draw_moved_body(scene: Scene, decomposition: Decomposition, camera: Floats) -> bytes:
    """Draw the moved body of a step, with the numbers of parts and the sizes of pins, as PNG."""
    canvas = Canvas(draw_shapes(scene.shapes, camera, MOVED_BODY_PX))
    canvas.write_labels([find_part_number(decomposition.parts[number].id) for number in scene.parts])
    _write_pin_sizes(canvas, scene, [pin.position_mm for pin in scene.pins])
    return canvas.encode_png()


def _find_tip(pin: Pin) -> Floats:
    """Find the highest point (3,) of a pin or key above the lower body."""
    height_mm = pin.length_mm if pin.key_direction is None else pin.diameter_mm
    return np.asarray(pin.position_mm + height_mm / 2.0 * pin.axis)


def _write_pin_sizes(canvas: Canvas, scene: Scene, points_mm: Sequence[Floats]) -> None:
    """Write the size of each visible pin next to it."""
    drawing = canvas.drawing
    for number, (pin, point_mm) in enumerate(
        zip(scene.pins, points_mm, strict=True), scene.first_pin_shape + 1
    ):
        if not (drawing.front_shapes == number).any():
            continue
        x, y = drawing.find_pixels(point_mm[None])[0]
        size = format_pin_size(pin).replace("×", "x")  # the font has no multiplication sign
        canvas.write_text(x + PIN_PT, y + PIN_PT / 2.0, size, PIN_PT, "ls", PIN_INK)


def _draw_arrow(canvas: Canvas, step: AssemblyStep, decomposition: Decomposition, offset_mm: Floats) -> None:
    """Draw the movement of the moved body as an arrow from its middle."""
    bounds = [decomposition.parts[number].solid.bounds_mm for number in step.moved_parts]
    middle = np.mean([bound.mean(axis=0) for bound in bounds], axis=0)
    start, end = canvas.drawing.find_pixels(np.array([middle + offset_mm, middle]))
    canvas.draw_arrow(start, end, ARROW_INK)


def _draw_scale(canvas: Canvas) -> None:
    """Draw a scale bar of a round length in the corner."""
    drawing = canvas.drawing
    width_mm = drawing.front_shapes.shape[1] / drawing.pixels_per_mm
    length_mm = max((mm for mm in SCALE_LENGTHS_MM if mm < width_mm / 4.0), default=SCALE_LENGTHS_MM[0])
    x, y = SCALE_PT, SCALE_PT
    canvas.draw_line(np.array([[x, y], [x + length_mm * drawing.pixels_per_mm, y]]), BAR_PT, "black")
    canvas.write_text(x, y + SCALE_PT / 2.0, f"{length_mm:g} mm", SCALE_PT, "ls")
