"""Slicing of one part: placement on the bed, slicing and checks. Runs in a worker."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import trimesh

from drivers.printers import Placement, place_part
from farm.errors import ErrorCode, FarmError
from farm.model import PartPrintOptions
from farm.planning.error_translation import translate_errors
from farm.planning.part_records import SliceTask
from slicing.errors import OutsideBed
from slicing.glued_parts import HiddenRecess, HiddenSide, SideGroove
from slicing.plate import PlateRequest, PlateResult, slice_plate
from slicing.settings import SMALL_OVERHANG_MM2, EngineSettings, PartSettings, resolve_settings

BED_TOLERANCE_MM = 0.1  # maximum height of faces and edges that lie on the bed
SUPPORT_TOLERANCE_DEG = 0.5
"""Angle below the support angle within which CuraEngine may still support a face, because it rounds."""
# Fins with steep faces print without support if their sharp edges lean by up to this angle, and if their tips
# lie over air by up to this length [assumed]. This is the support angle for all of them, because CuraEngine's
# rounding moves tips by tenths of a millimetre.
MAX_FIN_EDGE_DEG, MAX_FIN_TIP_MM = 82.0, 1.5
MIN_FIN_NORMALS_DEG = 120.0  # minimum angle between the normals of a fin's two faces
MIN_FIN_EDGE_MM, MIN_FIN_FACE_MM2 = 1.0, 0.01  # shorter edges and smaller faces are not taken for fins
MAX_FIN_OVERHANG_MM2 = 1.0  # maximum area of all faces beyond the support angle in a part with fins


def slice_part(task: SliceTask, progress: Callable[[float], None] | None = None) -> PlateResult:
    """Place a part on the bed and slice it; if its print extends past an edge, shift it and slice again.

    Parameters
    ----------
    progress
        Called with the completed share of the engine's work, 0 to 1.

    Raises
    ------
    FarmError
        With code `no_fit` if the part does not fit on the bed, `engine` if CuraEngine fails, `slice`
        if a check rejects the slice.
    """
    mesh = trimesh.load_mesh(task.stl)
    scale = np.array((task.settings.scale_xy, task.settings.scale_xy, task.settings.scale_z))
    x_mm, y_mm, z_mm = map(float, mesh.extents * scale)  # as printed, with shrinkage compensated
    to_bed = _build_transform(mesh, _find_placement(task, (x_mm, y_mm, z_mm)), scale)
    mesh.apply_transform(to_bed)
    bed = tuple(
        (r.min_x_mm, r.min_y_mm, r.max_x_mm, r.max_y_mm, box.height_mm)
        for box in task.usable_volumes
        for r in (box.rect.expand(task.settings.brim_width_mm),)
    )
    with translate_errors():
        settings = resolve_slice_settings(task, mesh)
        request = PlateRequest(
            stl=task.out.with_suffix(".placed.stl"),
            settings=settings,
            output_path=task.out,
            engine=task.engine,
            bed=bed,
            cache=task.cache,
            hidden_sides=place_hidden_sides(task.print_options, to_bed),
            hidden_recesses=place_hidden_recesses(task.print_options, to_bed),
        )
        mesh.export(request.stl)
        try:
            return slice_plate(request, progress)
        except OutsideBed as error:
            # Support under an overhang, and the brim around it, may extend beyond the part's box and its
            # brim. The printed bounds are known only after slicing.
            shift_mm = error.find_shift(bed)
            if shift_mm is None:
                raise
        mesh.apply_translation((*shift_mm, 0.0))
        mesh.export(request.stl)
        sides = tuple(side.move(shift_mm) for side in request.hidden_sides)
        recesses = tuple(recess.move(shift_mm) for recess in request.hidden_recesses)
        return slice_plate(replace(request, hidden_sides=sides, hidden_recesses=recesses), progress)


def resolve_slice_settings(task: SliceTask, mesh: trimesh.Trimesh) -> EngineSettings:
    """Resolve the settings of a part from its mesh in printed size. Raises as `resolve_settings` does."""
    part_settings = PartSettings(
        height_mm=float(mesh.extents[2]),
        brim_width_mm=task.print_options.brim_width_mm,
        layer_0_expansion_mm=task.print_options.layer_0_expansion_mm,
        bed_face_hidden=task.print_options.bed_face_hidden,
        tops_hidden=task.print_options.tops_hidden,
        flat_tops_visible=task.print_options.flat_tops_visible,
        support_angle_deg=find_support_angle_deg(mesh, task.settings),
    )
    return resolve_settings(task.request, task.resources, part_settings)


def find_support_angle_deg(mesh: trimesh.Trimesh, settings: EngineSettings) -> float | None:
    """Find a larger support angle, if the overhangs from the usual angle up to it are small; else None.

    With the usual angle, CuraEngine would build supports from the bed even below an overhang of a few layers,
    and below the tip of a fin that grows sideways along a leaning edge, although its faces are steep. The
    larger angle is that of the whole part, so fins count only if no face of the part overhangs.

    Parameters
    ----------
    mesh
        Part in its printing pose.
    settings
        Settings of the job.
    """
    min_deg, max_deg = settings.support_angle_deg - SUPPORT_TOLERANCE_DEG, settings.small_overhang_deg
    if max_deg == 0.0:
        return None
    overhangs_deg = np.degrees(np.arcsin(np.clip(-mesh.face_normals[:, 2], -1.0, 1.0)))
    is_on_bed = mesh.triangles[:, :, 2].max(axis=1) < mesh.bounds[0, 2] + BED_TOLERANCE_MM
    is_overhang = (overhangs_deg > min_deg) & ~is_on_bed
    if mesh.area_faces[is_overhang].sum() < MAX_FIN_OVERHANG_MM2:
        tip_deg = math.degrees(math.atan2(MAX_FIN_TIP_MM, settings.layer_height_mm))
        fin_deg = min(MAX_FIN_EDGE_DEG, tip_deg)
        edges_deg = _measure_fin_edges_deg(mesh, np.abs(overhangs_deg) <= min_deg)
        if ((edges_deg > min_deg) & (edges_deg <= fin_deg)).any():
            return fin_deg + SUPPORT_TOLERANCE_DEG
    is_between = is_overhang & (overhangs_deg <= max_deg)
    is_small = 0.0 < mesh.area_faces[is_between].sum() < SMALL_OVERHANG_MM2
    return max_deg + SUPPORT_TOLERANCE_DEG if is_small else None


def _measure_fin_edges_deg(mesh: trimesh.Trimesh, is_steep: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Measure the angles from the vertical of the sharp lower edges (n,) between two steep faces."""
    is_sharp = mesh.face_adjacency_convex & (mesh.face_adjacency_angles > math.radians(MIN_FIN_NORMALS_DEG))
    is_large = mesh.area_faces > MIN_FIN_FACE_MM2
    is_sharp &= (is_steep & is_large)[mesh.face_adjacency].all(axis=1)
    is_lower = mesh.face_normals[mesh.face_adjacency].sum(axis=1)[:, 2] < 0.0
    ends_mm = mesh.vertices[mesh.face_adjacency_edges[is_sharp & is_lower]]
    edges_mm = ends_mm[:, 1] - ends_mm[:, 0]
    lengths_mm = np.linalg.norm(edges_mm, axis=1)
    is_fin = (lengths_mm > MIN_FIN_EDGE_MM) & (
        ends_mm[:, :, 2].max(axis=1) > mesh.bounds[0, 2] + BED_TOLERANCE_MM
    )
    cosines = np.abs(edges_mm[is_fin, 2]) / lengths_mm[is_fin]
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, 0.0, 1.0))))


def _find_placement(task: SliceTask, extents_mm: tuple[float, float, float]) -> Placement:
    """Find a place on the bed for a part of a printed size. Raises FarmError (`no_fit`)."""
    placement = place_part(extents_mm, task.usable_volumes)
    if placement is None:
        size = " x ".join(f"{side:.1f}" for side in extents_mm)
        raise FarmError(
            f"part {task.part_name} ({size} mm) does not fit on the bed of its printer", ErrorCode.NO_FIT
        )
    return placement


def place_hidden_sides(options: PartPrintOptions, to_bed: npt.NDArray[np.float64]) -> tuple[HiddenSide, ...]:
    """Transform the hidden sides of a part, and the grooves in them, by the (4, 4) matrix of its mesh.

    The matrix may rotate the part about Z, scale X and Y equally, and move the part.
    """
    turn_and_scale, shift_mm = to_bed[:2, :2], to_bed[:2, 3]
    sides = []
    for number, (x, y, offset_mm) in enumerate(options.hidden_sides):
        normal = turn_and_scale @ (x, y)
        scale = float(np.hypot(*normal))
        unit_x, unit_y = (normal / scale).tolist()
        grooves = tuple(
            SideGroove(scale * low_mm, scale * high_mm, scale * depth_mm)
            for side, low_mm, high_mm, depth_mm in options.hidden_grooves
            if side == number
        )
        side = HiddenSide((unit_x, unit_y), scale * offset_mm, grooves)
        sides.append(side.move((float(shift_mm[0]), float(shift_mm[1]))))
    return tuple(sides)


def place_hidden_recesses(
    options: PartPrintOptions, to_bed: npt.NDArray[np.float64]
) -> tuple[HiddenRecess, ...]:
    """Transform the hidden recesses of a part by the (4, 4) matrix of its mesh; see `place_hidden_sides`."""
    recesses = []
    for low_x, low_y, high_x, high_y, face_z, bottom_z in options.hidden_recesses:
        corners = trimesh.transform_points([(low_x, low_y, face_z), (high_x, high_y, bottom_z)], to_bed)
        (min_x, min_y), (max_x, max_y) = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
        recesses.append(HiddenRecess(*map(float, (min_x, min_y, max_x, max_y, *corners[:, 2]))))
    return tuple(recesses)


def _build_transform(
    mesh: trimesh.Trimesh, placement: Placement, scale: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the (4, 4) matrix that transforms a mesh to its placement.

    It scales by `scale` (3,), moves the centre of the bounding box to the placement, and the underside to
    Z 0.
    """
    centre = mesh.bounds.mean(axis=0)
    transform = np.eye(4)
    if placement.is_rotated:
        transform[:2, :2] = ((0.0, -1.0), (1.0, 0.0))
    transform[:3, :3] *= scale
    transform[:3, 3] = -transform[:3, :3] @ (centre[0], centre[1], mesh.bounds[0][2])
    transform[:2, 3] += (placement.x_mm, placement.y_mm)
    return transform
