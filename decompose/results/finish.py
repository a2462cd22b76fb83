"""Conversion of an engine's partition to a checked result: pieces get poses, numbers and printers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from decompose.arrays import Floats
from decompose.bound import compute_surface_bound_s
from decompose.errors import NoFit
from decompose.options import Engine
from decompose.pieces import (
    Piece,
    assign_printers,
    find_cut_faces,
    find_faults,
    find_joints,
    rotate_planes,
    sort_pieces,
)
from decompose.print_time import PartMesh, Pose, compute_steady_limit_s, find_steady_pose
from decompose.printers import TargetPrinter
from decompose.problem import GridFigures, Partition, Problem
from decompose.results.check import check_result
from decompose.results.decomposition import Decomposition, Part
from decompose.results.hidden_sides import add_hidden_sides
from decompose.results.records import Coverage, Cutting

# Latest end of a part in a steadier pose, as a share of the makespan; below 1, because prices have errors.
MAX_END_SHARE = 0.97


def finish_result(
    problem: Problem, partition: Partition, serial_times_s: tuple[float, float]
) -> Decomposition:
    """Give an engine's pieces poses, numbers and printers, and check them; the caller adds the stage times.

    Parameters
    ----------
    problem
        Problem that the engine worked on.
    partition
        Result of the engine.
    serial_times_s
        Times of the whole model on one printer, from `decompose.estimate_serial_s`.

    Raises
    ------
    NoFit
        Not all parts can be assigned to printers that they fit, with at most one part on each printer.
    GeometryError
        The result breaks a geometry rule.
    """
    pieces = sort_pieces(partition.pieces)
    parts = _build_parts(pieces, problem)
    problem.on_stage("parts")
    has_boxes = all(len(piece.boxes_mm) for piece in pieces)
    boxes_mm = np.concatenate([p.boxes_mm for p in pieces]) if has_boxes else np.zeros((0, 2, 3))
    coverage = check_result(parts, boxes_mm, partition.model, problem.printers, problem.options.min_wall_mm)
    problem.on_stage("check")
    return _build_decomposition(
        problem, partition, parts, coverage, serial_times_s, _record_cutting(problem, pieces, boxes_mm, parts)
    )


def _record_cutting(
    problem: Problem, pieces: Sequence[Piece], boxes_mm: Floats, parts: Sequence[Part]
) -> Cutting | None:
    """Record the boxes of the engine `guillotine`, to move the planes again; None if a piece has no box."""
    if problem.options.engine is not Engine.GUILLOTINE or len(boxes_mm) != len(pieces):
        return None
    cut_for = tuple(piece.printer for piece in pieces)
    prices_s = tuple(part.price_s for part in parts)
    return Cutting(problem.options.granularity, problem.frame, boxes_mm, cut_for, problem.printers, prices_s)


def _build_decomposition(
    problem: Problem,
    partition: Partition,
    parts: Sequence[Part],
    coverage: Coverage,
    serial_times_s: tuple[float, float],
    cutting: Cutting | None,
) -> Decomposition:
    """Build the result from checked parts, in the frame of the original model."""
    factors = {printer.name: printer.time_factor for printer in problem.printers}
    makespan_s = max(p.price_s * factors[p.printer] for p in parts)
    cut_joints = find_joints(parts)
    rotation = partition.rotation @ problem.frame
    bound_s = compute_surface_bound_s(problem.model.solid.area_mm2, 0.0, len(problem.printers), problem.cost)
    grid = partition.grid_figures or GridFigures(makespan_s, problem.min_time_factor * bound_s, None)
    if problem.cost.hidden_side_share > 0.0:
        parts = add_hidden_sides(parts, partition.model.solid)
    restored_parts = tuple(_restore_frame(part, rotation) for part in parts)
    joints = tuple(joint.move(_invert_rotation(rotation)) for joint in cut_joints)
    return Decomposition(
        engine=problem.options.engine,
        options=problem.options,
        serial_s=serial_times_s[0],
        serial_as_is_s=serial_times_s[1],
        makespan_s=makespan_s,
        sum_s=sum(p.price_s for p in parts),
        grid_makespan_s=grid.makespan_s,
        lower_bound_s=grid.lower_bound_s,
        gap=(grid.makespan_s - grid.lower_bound_s) / grid.lower_bound_s,
        compute_s={},
        parts=restored_parts,
        coverage=coverage,
        cells=grid.cells,
        joints=joints,
        cutting=cutting,
        faults=tuple(find_faults(parts, problem.options.min_glue_mm2, cut_joints)),
    )


def _build_parts(pieces: Sequence[Piece], problem: Problem) -> list[Part]:
    """Build the parts: choose a pose, a number and a printer for each piece."""
    poses = [_require_pose(pose) for pose in problem.find_poses(pieces)]
    assigned_printers = assign_printers(apply_time_ratios(pieces, poses), problem.printers)
    if assigned_printers is None:
        raise NoFit(f"{len(poses)} parts do not fit these printers with one part on each", len(poses))
    poses = _find_steady_poses(problem, pieces, poses, assigned_printers)
    digits = max(2, len(str(len(pieces))))
    return [
        Part(
            id=f"p{i + 1:0{digits}d}",
            solid=piece.solid,
            to_model=pose.to_model,
            price_s=pose.price_s,
            connectors_s=pose.connectors_s,
            printer=assigned_printers[i].name,
            brim_width_mm=pose.brim_width_mm,
            layer_0_expansion_mm=pose.layer_0_expansion_mm,
            bed_face_hidden=pose.bed_face_hidden,
            tops_hidden=pose.tops_hidden,
            flat_tops_visible=pose.flat_tops_visible,
            planes=piece.planes,
            stands=pose.stands,
            small_foot_mm2=pose.footing.contact_mm2 if pose.has_small_foot else None,
        )
        for i, (piece, pose) in enumerate(zip(pieces, poses, strict=True))
    ]


def _find_steady_poses(
    problem: Problem,
    pieces: Sequence[Piece],
    poses: Sequence[Pose],
    assigned_printers: Sequence[TargetPrinter],
) -> list[Pose]:
    """Find steadier poses for the pieces that end before the slowest one.

    A printer that prints several parts one after another has no spare time.
    """
    ratios = [
        piece.time_ratio * printer.time_factor
        for piece, printer in zip(pieces, assigned_printers, strict=True)
    ]
    makespan_s = max(pose.price_s * ratio for pose, ratio in zip(poses, ratios, strict=True))
    round_counts = Counter(printer.name for printer in problem.printers)

    def find_pose(piece: Piece, fastest_pose: Pose, printer: TargetPrinter, ratio: float) -> Pose:
        spare_limit_s = MAX_END_SHARE * makespan_s / ratio if round_counts[printer.name] == 1 else 0.0
        vertices, faces = piece.solid.arrays()
        mesh = PartMesh(vertices, faces, find_cut_faces(vertices, faces, piece.planes))
        printers = (*problem.list_piece_printers(piece), printer)
        return find_steady_pose(
            mesh, printers, problem.cost, fastest_pose, compute_steady_limit_s(fastest_pose, spare_limit_s)
        )

    return list(problem.map(find_pose, pieces, poses, assigned_printers, ratios))


def apply_time_ratios(pieces: Sequence[Piece], poses: Sequence[Pose]) -> list[Pose]:
    """Multiply the price of each pose by its piece's `time_ratio`: the slicer's time divided by the price.

    Parameters
    ----------
    pieces, poses
        Pieces, and their poses in the same order.

    Returns
    -------
    list[Pose]
        Poses with corrected prices, in the same order.
    """
    pairs = zip(pieces, poses, strict=True)
    return [replace(pose, price_s=pose.price_s * piece.time_ratio) for piece, pose in pairs]


def _require_pose(pose: Pose | None) -> Pose:
    """Return a pose; raise `NoFit` if there is none."""
    if pose is None:
        raise NoFit("a part fits no printer in any pose: choose another engine, or a finer --granularity")
    return pose


def _restore_frame(part: Part, rotation: Floats) -> Part:
    """Move a part from the frame of the cut to that of the model, by the inverse of a rotation (3, 3)."""
    if (rotation == np.eye(3)).all():
        return part
    return replace(
        part,
        solid=part.solid.rotate(rotation.T),
        to_model=_invert_rotation(rotation) @ part.to_model,
        planes=rotate_planes(part.planes, rotation.T),
    )


def _invert_rotation(rotation: Floats) -> Floats:
    """Build the transform (4, 4) of the inverse of a rotation (3, 3)."""
    transform = np.eye(4)
    transform[:3, :3] = rotation.T
    return transform
