"""Comments with times in CuraEngine's G-code: corrected by the moves, and added at each feature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slicing.checks.feature_times import MotionLimits, estimate_move_seconds
from slicing.checks.section import Floats
from slicing.checks.toolpath import TIME_PREFIX, Toolpath, read_toolpath


def remove_reset_times(gcode: bytes, toolpath: Toolpath, limits: MotionLimits) -> bytes:
    """Remove the time that CuraEngine adds to a layer in which the position of the extruder is reset.

    CuraEngine writes ``G92 E0`` after every 10 cm3 of filament, but its estimate of the time continues with
    the old position. So it assumes that the next move pulls all of this filament back: 35 s on the
    Ultimaker 2+ (CuraEngine issue 1164; measured with 4.13.0).

    Parameters
    ----------
    gcode
        CuraEngine's output.
    toolpath
        Moves and comments of the same file.
    limits
        Limits with which it was sliced.

    Returns
    -------
    bytes
        The file with corrected times in its comments, in s; the same object if there is no reset.
    """
    if toolpath.first_layer_move is None:
        return gcode
    resets = [
        command.next_move
        for command in toolpath.commands
        if command.code == "G92"
        and "E" in command.words
        and toolpath.first_layer_move < command.next_move < len(toolpath.start)
    ]
    if not resets:
        return gcode
    assumed_start = toolpath.start.copy()
    assumed_start[resets, 3] = toolpath.end[np.array(resets) - 1, 3]
    estimated_s = _estimate_layer_times_s(toolpath, limits)
    added_s = _estimate_layer_times_s(replace(toolpath, start=assumed_start), limits) - estimated_s
    layer_times_s = _read_layer_times_s(toolpath)
    # An engine without this error does not add the time.
    is_added = layer_times_s - estimated_s > added_s / 2.0
    return _replace_times(gcode, toolpath, layer_times_s - np.where(is_added, added_s, 0.0))


def change_times(gcode: bytes, toolpath: Toolpath, limits: MotionLimits) -> bytes:
    """Correct the times in the comments of changed G-code by the time that each layer saves.

    Cura's time of a layer changes in proportion to the estimated times of its moves.

    Parameters
    ----------
    gcode
        Changed G-code.
    toolpath
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
    new_toolpath = read_toolpath(gcode)
    estimated_s, new_s = (
        _estimate_layer_times_s(toolpath, limits),
        _estimate_layer_times_s(new_toolpath, limits),
    )
    ratios = np.divide(new_s, estimated_s, out=np.ones_like(new_s), where=estimated_s > 0.0)
    return _replace_times(gcode, new_toolpath, _read_layer_times_s(toolpath) * ratios)


def _read_layer_times_s(toolpath: Toolpath) -> Floats:
    """Read the seconds (layers,) of each layer from the comments."""
    return np.diff([0.0, *(end_s for _, end_s in toolpath.list_layer_ends())])


def _estimate_layer_times_s(toolpath: Toolpath, limits: MotionLimits) -> Floats:
    """Estimate the seconds (layers,) of the moves of each layer."""
    sums_s = np.append(0.0, np.cumsum(estimate_move_seconds(toolpath, limits)))
    bounds = [toolpath.first_layer_move or 0, *(move for move, _ in toolpath.list_layer_ends())]
    return np.diff(sums_s[bounds])


def _replace_times(gcode: bytes, toolpath: Toolpath, layer_times_s: Floats) -> bytes:
    """Replace the times in the comments of a file by the sums of the seconds (layers,) of its layers."""
    time_comments = [comment for comment in toolpath.comments if comment.text.startswith(TIME_PREFIX)]
    pieces, offset = [], 0
    for comment, elapsed_s in zip(time_comments, np.cumsum(layer_times_s), strict=True):
        pieces += [gcode[offset : comment.offset], b";%b%.6f" % (TIME_PREFIX.encode(), elapsed_s)]
        offset = gcode.index(b"\n", comment.offset)
    return b"".join((*pieces, gcode[offset:]))


def add_times(gcode: bytes, toolpath: Toolpath) -> bytes:
    """Add a ``;TIME_ELAPSED:`` before each ``;TYPE:`` of a layer.

    The time between the ends of two layers is divided in proportion to the moves' times at their feedrates.

    Parameters
    ----------
    gcode
        CuraEngine's output.
    toolpath
        Moves and comments of the same file.
    """
    layer_ends, first_move = toolpath.list_layer_ends(), toolpath.first_layer_move
    if first_move is None or not layer_ends:
        return gcode
    moves = np.array([first_move, *(move for move, _ in layer_ends)])
    move_times_s = np.concatenate(([0.0], np.cumsum(_compute_seconds(toolpath))))
    elapsed_s = np.array([0.0, *(seconds for _, seconds in layer_ends)])
    type_comments = [
        comment
        for comment in toolpath.comments
        if comment.text.startswith("TYPE:") and moves[0] < comment.next_move < moves[-1]
    ]
    comment_times_s = np.interp(
        move_times_s[[comment.next_move for comment in type_comments]], move_times_s[moves], elapsed_s
    )
    pieces, offset = [], 0
    for comment, seconds in zip(type_comments, comment_times_s, strict=True):
        pieces += [gcode[offset : comment.offset], b";TIME_ELAPSED:%.6f\n" % seconds]
        offset = comment.offset
    return b"".join((*pieces, gcode[offset:]))


def _compute_seconds(toolpath: Toolpath) -> Floats:
    """Compute the seconds (n,) of each move at its feedrate, without acceleration."""
    distance_mm = np.linalg.norm(toolpath.end[:, :3] - toolpath.start[:, :3], axis=1)
    distance_mm = np.where(distance_mm > 0, distance_mm, np.abs(toolpath.extruded_mm))
    return distance_mm * 60.0 / np.maximum(toolpath.feed_mm_min, 1.0)
