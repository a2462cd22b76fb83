"""Comments with times in CuraEngine's G-code: corrected by the moves, and added at each feature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slicing.checks.feature_times import MotionLimits, estimate_move_seconds
from slicing.checks.section import Floats
from slicing.checks.toolpath import TIME_PREFIX, Toolpath, read_toolpath


def remove_reset_times(gcode: bytes, path: Toolpath, limits: MotionLimits) -> bytes:
    """Remove the time that CuraEngine adds to a layer in which the position of the extruder is reset.

    CuraEngine writes ``G92 E0`` after every 10 cm3 of filament, but its estimate of the time continues with
    the old position. So it assumes that the next move pulls all of this filament back: 35 s on the
    Ultimaker 2+ (CuraEngine issue 1164; measured with 4.13.0).

    Parameters
    ----------
    gcode
        CuraEngine's output.
    path
        Moves and comments of the same file.
    limits
        Limits with which it was sliced.

    Returns
    -------
    bytes
        The file with corrected times in its comments, in s; the same object if there is no reset.
    """
    if path.first_layer_move is None:
        return gcode
    resets = [
        command.next_move
        for command in path.commands
        if command.code == "G92"
        and "E" in command.words
        and path.first_layer_move < command.next_move < len(path.start)
    ]
    if not resets:
        return gcode
    assumed_start = path.start.copy()
    assumed_start[resets, 3] = path.end[np.array(resets) - 1, 3]
    planned_s = _estimate_layer_times_s(path, limits)
    added_s = _estimate_layer_times_s(replace(path, start=assumed_start), limits) - planned_s
    layer_times_s = _read_layer_times_s(path)
    # An engine without this error does not add the time.
    is_added = layer_times_s - planned_s > added_s / 2.0
    return _replace_times(gcode, path, layer_times_s - np.where(is_added, added_s, 0.0))


def change_times(gcode: bytes, path: Toolpath, limits: MotionLimits) -> bytes:
    """Correct the times in the comments of changed G-code by the time that each layer saves.

    Cura's time of a layer changes in proportion to the planned times of its moves.

    Parameters
    ----------
    gcode
        Changed G-code.
    path
        Moves and comments before the change.
    limits
        Limits with which it was sliced.

    Returns
    -------
    bytes
        The file with corrected times in its comments, in s.

    Raises
    ------
    SliceRejected
        `FLAVOUR` if the changed file cannot be read; see `read_toolpath`.
    """
    new_path = read_toolpath(gcode)
    planned_s, new_s = _estimate_layer_times_s(path, limits), _estimate_layer_times_s(new_path, limits)
    ratios = np.divide(new_s, planned_s, out=np.ones_like(new_s), where=planned_s > 0.0)
    return _replace_times(gcode, new_path, _read_layer_times_s(path) * ratios)


def _read_layer_times_s(path: Toolpath) -> Floats:
    """Read the seconds (layers,) of each layer from the comments."""
    return np.diff([0.0, *(end_s for _, end_s in path.list_layer_ends())])


def _estimate_layer_times_s(path: Toolpath, limits: MotionLimits) -> Floats:
    """Estimate the seconds (layers,) of the moves of each layer."""
    sums_s = np.append(0.0, np.cumsum(estimate_move_seconds(path, limits)))
    bounds = [path.first_layer_move or 0, *(move for move, _ in path.list_layer_ends())]
    return np.diff(sums_s[bounds])


def _replace_times(gcode: bytes, path: Toolpath, layer_times_s: Floats) -> bytes:
    """Replace the times in the comments of a file by the sums of the seconds (layers,) of its layers."""
    marks = [comment for comment in path.comments if comment.text.startswith(TIME_PREFIX)]
    pieces, offset = [], 0
    for mark, elapsed_s in zip(marks, np.cumsum(layer_times_s), strict=True):
        pieces += [gcode[offset : mark.offset], b";%b%.6f" % (TIME_PREFIX.encode(), elapsed_s)]
        offset = gcode.index(b"\n", mark.offset)
    return b"".join((*pieces, gcode[offset:]))


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
