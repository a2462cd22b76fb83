"""Time marks at the start of each feature of a layer, because CuraEngine marks only the end of a layer."""

from __future__ import annotations

import numpy as np

from slicing.checks.section import Floats
from slicing.checks.toolpath import Toolpath


def add_times(gcode: bytes, path: Toolpath) -> bytes:
    """Add a ``;TIME_ELAPSED:`` before each ``;TYPE:`` of a layer.

    The time between the ends of two layers is divided in proportion to the moves' times at their feedrates.

    Parameters
    ----------
    gcode
        CuraEngine's output.
    path
        Moves and comments of the same file.
    """
    layer_ends, first_move = path.list_layer_ends(), path.first_layer_move
    if first_move is None or not layer_ends:
        return gcode
    moves = np.array([first_move, *(move for move, _ in layer_ends)])
    move_times_s = np.concatenate(([0.0], np.cumsum(_compute_seconds(path))))
    elapsed_s = np.array([0.0, *(seconds for _, seconds in layer_ends)])
    type_comments = [
        comment
        for comment in path.comments
        if comment.text.startswith("TYPE:") and moves[0] < comment.next_move < moves[-1]
    ]
    mark_times_s = np.interp(
        move_times_s[[comment.next_move for comment in type_comments]], move_times_s[moves], elapsed_s
    )
    pieces, offset = [], 0
    for comment, seconds in zip(type_comments, mark_times_s, strict=True):
        pieces += [gcode[offset : comment.offset], b";TIME_ELAPSED:%.6f\n" % seconds]
        offset = comment.offset
    return b"".join((*pieces, gcode[offset:]))


def _compute_seconds(path: Toolpath) -> Floats:
    """Compute the seconds (n,) of each move at its feedrate, without acceleration."""
    distance_mm = np.linalg.norm(path.end[:, :3] - path.start[:, :3], axis=1)
    distance_mm = np.where(distance_mm > 0, distance_mm, np.abs(path.extruded_mm))
    return distance_mm * 60.0 / np.maximum(path.feed_mm_min, 1.0)
