"""Pieces in a box of a partition, with their poses and their print time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from decompose.arrays import Floats
from decompose.pieces import SLIVER_MM, Piece
from decompose.print_time import Pose
from decompose.printers import TargetPrinter


@dataclass(frozen=True, slots=True, eq=False)
class BoxPart:
    """Pieces in a box, and their poses.

    Attributes
    ----------
    box_mm
        (2, 3) lower and upper corner of the box. The pieces may be cut out of a smaller box in it, with the
        same needed cells.
    pieces, poses
        Connected pieces, and the poses of those pieces that fit their printers.
    seconds
        Time of the slowest piece on its printer; inf if a piece does not fit.
    """

    box_mm: Floats
    pieces: tuple[Piece, ...]
    poses: tuple[Pose, ...]
    seconds: float

    @property
    def cut_box_mm(self) -> Floats:
        """Corners (2, 3) of the box out of which the pieces are cut; the box itself without pieces."""
        return np.asarray(self.pieces[0].boxes_mm[0]) if self.pieces else self.box_mm

    @property
    def size_mm(self) -> Floats:
        """Length (3,) of the longest piece along each axis."""
        return np.asarray(np.max([np.ptp(piece.solid.bounds_mm, axis=0) for piece in self.pieces], axis=0))

    @property
    def shortest_side_mm(self) -> float:
        """Shortest side of any piece."""
        return min(float(np.ptp(piece.solid.bounds_mm, axis=0).min()) for piece in self.pieces)

    def with_poses(self, poses: Sequence[Pose | None]) -> BoxPart:
        """Return the part with its pieces in these poses; its time is inf if a piece has no pose."""
        fitting_poses = tuple(pose for pose in poses if pose is not None)
        return replace(self, poses=fitting_poses, seconds=compute_slowest_piece_s(self.pieces, poses))

    def has_similar_pieces(self, other: BoxPart) -> bool:
        """Check whether this part has as many pieces as the other one, and no new sliver."""
        return len(self.pieces) == len(other.pieces) and self.shortest_side_mm >= min(
            SLIVER_MM, other.shortest_side_mm
        )


def compute_slowest_piece_s(pieces: Sequence[Piece], poses: Sequence[Pose | None]) -> float:
    """Compute the time in seconds of the slowest piece on its printer; inf if a piece has no pose.

    Parameters
    ----------
    pieces, poses
        Pieces, and the pose of each in the same order; None for a piece without a pose.
    """
    pairs = zip(pieces, poses, strict=True)
    times_s = [math.inf if pose is None else pose.price_s * piece.time_factor for piece, pose in pairs]
    return max(times_s, default=math.inf)


def sort_times_s(parts: Sequence[BoxPart]) -> list[float]:
    """Sort the times of parts in descending order; lexicographically lower is better."""
    return sorted((part.seconds for part in parts), reverse=True)


def find_longest_time_s(parts: Sequence[BoxPart]) -> float:
    """Find the time of the slowest part, in seconds."""
    return max(part.seconds for part in parts)


def find_spare_length_mm(size_mm: Floats, printers: Sequence[TargetPrinter]) -> Floats:
    """Compute the length by which a part may grow along each axis, one axis at a time, and still fit.

    Parameters
    ----------
    size_mm
        (3,) size of the part.
    printers
        Printers; the part has to fit each of them.

    Returns
    -------
    ndarray
        (3,) lengths in mm; inf (unknown) if the part fits the build volumes only in a pose that is not
        parallel to the axes.
    """
    spare_mm = np.full(3, math.inf)
    for printer in printers:
        spare_by_box_mm = (
            np.array([sides for box in printer.box_sizes_mm for sides in permutations(box)]) - size_mm
        )
        spare_by_box_mm = spare_by_box_mm[(spare_by_box_mm >= 0.0).all(axis=1)]
        if len(spare_by_box_mm):
            spare_mm = np.minimum(spare_mm, spare_by_box_mm.max(axis=0))
    return spare_mm
