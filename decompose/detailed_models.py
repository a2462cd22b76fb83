"""Very detailed models: a simplified copy is searched, and the parts are cut out of the model itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from decompose.arrays import Floats
from decompose.engines.guillotine import grow_boxes
from decompose.geometry import Model, Solid
from decompose.options import Engine
from decompose.pieces import Piece, copy_printers, cut_box
from decompose.problem import Effort, Partition, Problem, Work, keep_similar_poses

# A model with more faces than this is not searched itself, because the same budget would find less, and take
# more memory. It is simplified until it has at most as many.
MAX_SEARCHED_FACES = 150_000
# Tolerances of the simplification, one after the other until there are few enough faces.
TOLERANCES_MM = (0.02, 0.05, 0.1, 0.2)
# Margin for the distance between the surfaces of a model and of its copy: the tolerances above together, and
# some rounding. Only details thinner than a tolerance, which the copy may lack, can be farther from the copy.
MARGIN_MM = 0.5
# Maximum volume of a crumb: a piece that no printer can print, such as the tip of a bump that reaches through
# a cut plane. The check of the result limits the volume and the surface of all crumbs together.
MAX_CRUMB_MM3 = 0.01
MAX_REGION_BOXES = 2  # maximum number of boxes that are cut out of a region without dividing it again
# Engines whose pieces are each cut out of a single box.
BOX_ENGINES = (Engine.GUILLOTINE, Engine.PARALLELOBOX)


def is_too_detailed(model: Model) -> bool:
    """Check whether a simplified copy of a model is searched instead of the model itself."""
    return model.solid.face_count > MAX_SEARCHED_FACES


def simplify_solid(solid: Solid) -> Solid:
    """Simplify a solid if it has very many faces; this hardly changes its price."""
    return solid.simplify_if_possible(*TOLERANCES_MM, max_faces=MAX_SEARCHED_FACES)


def simplify_model(model: Model) -> Model:
    """Simplify a model if it is too detailed for a search; return the same model if not."""
    return replace(model, solid=simplify_solid(model.solid)) if is_too_detailed(model) else model


def simplify_problem(problem: Problem, simple_solid: Solid) -> Problem:
    """Simplify the model of a problem if it is too detailed for a search; return the same problem if not.

    Hollows keep a greater distance from the surface of the copy, so that they are far enough from the surface
    of the model.

    Parameters
    ----------
    problem
        Problem with the model itself.
    simple_solid
        Simplified solid in the frame of the input (see `Problem.frame`). All attempts of a search use the
        same copy, wherever they run.
    """
    if not is_too_detailed(problem.model):
        return problem
    model = replace(problem.model, solid=simple_solid.rotate(problem.frame))
    options = replace(problem.options, min_wall_mm=problem.options.min_wall_mm + MARGIN_MM)
    return replace(problem, model=model, options=options)


def cut_detailed_pieces(problem: Problem, simple_problem: Problem, partition: Partition) -> Partition | None:
    """Cut the boxes of a partition of the simplified model out of the model itself.

    Faces that touch no other box move outward by `MARGIN_MM`, because the surface of the model may be outside
    that of the copy; but no box extends farther than that beyond the model. The pieces get the poses of those
    of the copy where they are as good.

    Parameters
    ----------
    problem
        Problem with the model itself.
    simple_problem, partition
        Problem that `simplify_problem` returned, and a partition of it.

    Returns
    -------
    Partition or None
        None if a piece was not cut out of a single box, or if the model has other pieces in a box.
    """
    if any(len(piece.boxes_mm) != 1 for piece in partition.pieces):
        return None
    simple_pieces: dict[bytes, list[Piece]] = {}
    for piece in partition.pieces:
        simple_pieces.setdefault(piece.boxes_mm.tobytes(), []).append(piece)
    boxes_mm = np.array([pieces[0].boxes_mm[0] for pieces in simple_pieces.values()])
    model = problem.rotate(partition.rotation).model
    low_mm, high_mm = model.solid.bounds_mm
    grown_mm = np.clip(grow_boxes(boxes_mm, MARGIN_MM), low_mm - MARGIN_MM, high_mm + MARGIN_MM)
    box_pieces: dict[int, list[tuple[Piece, Piece]]] = {}
    for box, region in _clip_around(model.solid, grown_mm, problem.effort):
        box_pieces[box] = _cut_matching_pieces(region, grown_mm[box], list(simple_pieces.values())[box])
        if not box_pieces[box]:
            return None
    pairs = [pair for box in range(len(boxes_mm)) for pair in box_pieces[box]]
    unassigned_pieces, matching_pieces = zip(*pairs, strict=True)
    pieces = copy_printers(unassigned_pieces, matching_pieces)
    keep_similar_poses(problem, pieces, simple_problem.find_poses(matching_pieces))
    return replace(partition, pieces=tuple(pieces), model=model)


def _clip_around(solid: Solid, boxes_mm: Floats, effort: Effort) -> Iterator[tuple[int, Solid]]:
    """Clip a solid to a region around each of its boxes (n, 2, 3) in mm; yield the box's number and region.

    The boxes are divided into two halves again and again. So most cuts are made in a small part of the solid,
    which is faster than to cut each box out of the whole solid. Few regions exist at a time.
    """
    if len(boxes_mm) <= MAX_REGION_BOXES:
        effort.record(Work.FACE_CUT, solid.face_count * len(boxes_mm))
        yield from ((box, solid) for box in range(len(boxes_mm)))
        return
    centres_mm = boxes_mm.mean(axis=1)
    order = np.argsort(centres_mm[:, int(np.ptp(centres_mm, axis=0).argmax())], kind="stable")
    for half in np.array_split(order, 2):
        low_mm, high_mm = boxes_mm[half, 0].min(axis=0), boxes_mm[half, 1].max(axis=0)
        effort.record(Work.FACE_CUT, solid.face_count)
        half_solid = solid.clip(low_mm - MARGIN_MM, high_mm + MARGIN_MM)
        for box, region in _clip_around(half_solid, boxes_mm[half], effort):
            yield int(half[box]), region


def _cut_matching_pieces(
    solid: Solid, box_mm: Floats, simple_pieces: Sequence[Piece]
) -> list[tuple[Piece, Piece]]:
    """Cut the pieces of a solid in a box (2, 3) in mm, and find the nearest piece of the copy for each.

    The list is empty if there are more or fewer of them. Crumbs are left out. Pieces of the copy
    are no crumbs, because a partition has no slivers.
    """
    pieces = [piece for piece in cut_box(solid, *box_mm) if piece.solid.volume_mm3 > MAX_CRUMB_MM3]
    if len(pieces) != len(simple_pieces):
        return []
    centres_mm, simple_centres_mm = (
        np.array([piece.solid.bounds_mm.mean(axis=0) for piece in piece_list])
        for piece_list in (pieces, simple_pieces)
    )
    numbers = linear_sum_assignment(cdist(centres_mm, simple_centres_mm))[1]
    return [(piece, simple_pieces[number]) for piece, number in zip(pieces, numbers, strict=True)]
