"""Poses of pieces that hardly differ from other pieces, whose best poses are known."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from decompose.pieces import Piece, find_cut_faces
from decompose.print_time import Pose, measure_pose
from decompose.problem.effort import Work
from decompose.problem.problem import Problem


def measure_similar_pose(problem: Problem, piece: Piece, known_pose: Pose | None) -> Pose | None:
    """Price a piece in the rotation of the best pose of a similar piece, which is faster than to seek a pose.

    Parameters
    ----------
    problem
        Problem with the printers and the cost model.
    piece
        Piece to price.
    known_pose
        Best pose of the similar piece, if it has one.

    Returns
    -------
    Pose or None
        None without a known pose, if the piece does not fit in it, or if it is less stable or gets supports
        that touch a cut face, unlike the similar piece. The caller records the effort.
    """
    if known_pose is None:
        return None
    vertices, faces = piece.solid.arrays()
    is_cut = find_cut_faces(vertices, faces, piece.planes)
    rotation, options = known_pose.to_model[:3, :3].T, problem.options
    pose = measure_pose(vertices, faces, is_cut, rotation, problem.cost, options.fit_first_layer)
    fits = all(printer.fits(*pose.size_mm) for printer in problem.list_piece_printers(piece))
    *stability, touched_mm2, _ = pose.rank
    *known_stability, known_touched_mm2, _ = known_pose.rank
    is_good = stability <= known_stability and (touched_mm2 == 0.0 or known_touched_mm2 > 0.0)
    return pose if fits and is_good else None


def keep_similar_poses(problem: Problem, pieces: Sequence[Piece], known_poses: Sequence[Pose | None]) -> None:
    """Give pieces the poses of similar ones where they are as good; no other pose is sought for these pieces.

    Parameters
    ----------
    problem
        Problem in which the poses are kept.
    pieces, known_poses
        Pieces, and the best poses of similar pieces in the same order.
    """
    problem.effort.record(Work.PIECE_MEASURED, len(pieces))
    problem.effort.record(Work.FACE_MEASURED, sum(piece.solid.face_count for piece in pieces))
    poses = list(problem.map(partial(measure_similar_pose, problem), pieces, known_poses))
    problem.keep_poses(pieces, poses)
