"""Classes of printers: the printers of a class have about the same build volume and about the same speed.

Printers that differ only slightly form one class, with the build volume that all of them have and the speed
of the slowest one, so a part that finishes in time on the class finishes in time on each of its printers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import prod

from decompose.printers import TargetPrinter

BuildVolume = tuple[tuple[float, float, float], ...]  # sizes of boxes in mm, as in `TargetPrinter`

# Two classes become one if at most this share of the throughput of all printers is lost, or if there would be
# too many ways to divide the printers otherwise.
MAX_LOSS_SHARE = 0.003
# Loss that counts for a printer whose build volume shrinks when classes merge, as a share of its throughput.
VOLUME_VALUE = 0.05


@dataclass(frozen=True, slots=True)
class PrinterClass:
    """Printers that are treated as equal.

    Attributes
    ----------
    box_sizes_mm, time_factor
        Boxes of the build volume that all of them have, and time factor of the slowest; see `TargetPrinter`.
    printers
        Printers of the class.
    """

    box_sizes_mm: BuildVolume
    time_factor: float
    printers: tuple[TargetPrinter, ...]

    @property
    def smallest_printer(self) -> TargetPrinter:
        """Printer whose build volume and speed all printers of the class have or exceed."""
        return TargetPrinter("", self.box_sizes_mm, self.time_factor)

    @property
    def count(self) -> int:
        """Number of printers."""
        return len(self.printers)

    @property
    def throughput(self) -> float:
        """Work that all printers do per second, in seconds of work of a printer with time factor 1."""
        return self.count / self.time_factor


def classify_printers(printers: Sequence[TargetPrinter], max_divisions: float) -> list[PrinterClass]:
    """Divide printers into classes, the one with the most printers first; one class if all are about equal.

    Parameters
    ----------
    printers
        Printers, at least one.
    max_divisions
        Maximum number of ways to divide the printers (`count_divisions`) that the search may try for each
        cut; at least 1.
    """
    printers_by_key: dict[tuple[BuildVolume, float], list[TargetPrinter]] = {}
    for printer in printers:
        printers_by_key.setdefault((printer.box_sizes_mm, printer.time_factor), []).append(printer)
    classes = [PrinterClass(*key, tuple(printers_by_key[key])) for key in sorted(printers_by_key)]
    max_loss = MAX_LOSS_SHARE * sum(member.throughput for member in classes)
    while len(classes) > 1:
        loss, a, b = min(
            (_compute_lost_throughput(a, b), i, k) for (i, a), (k, b) in combinations(enumerate(classes), 2)
        )
        if loss > max_loss and count_divisions([member.count for member in classes]) <= max_divisions:
            break
        merged_class = _merge_classes(classes[a], classes[b])
        classes = [*(member for i, member in enumerate(classes) if i not in (a, b)), merged_class]
    return sorted(classes, key=lambda member: (-member.count, member.box_sizes_mm, member.time_factor))


def count_divisions(counts: Sequence[int]) -> int:
    """Count the ways to divide the printers between the sides of a cut.

    The class with the most printers is left out.
    """
    return prod((count + 1) * (count + 2) // 2 for count in sorted(counts)[:-1])


def _compute_lost_throughput(a: PrinterClass, b: PrinterClass) -> float:
    """Compute the throughput that two classes lose when they become one."""
    merged_class = _merge_classes(a, b)
    shrunk_throughput = sum(
        printer_class.throughput
        for printer_class in (a, b)
        if printer_class.box_sizes_mm != merged_class.box_sizes_mm
    )
    return a.throughput + b.throughput - merged_class.throughput + VOLUME_VALUE * shrunk_throughput


def _merge_classes(a: PrinterClass, b: PrinterClass) -> PrinterClass:
    """Merge two classes into one with the build volume that both have and the lower speed."""
    time_factor = max(a.time_factor, b.time_factor)
    return PrinterClass(
        _find_shared_volume(a.box_sizes_mm, b.box_sizes_mm), time_factor, (*a.printers, *b.printers)
    )


def _find_shared_volume(a: BuildVolume, b: BuildVolume) -> BuildVolume:
    """Find the largest boxes that fit in both build volumes."""
    if a == b:
        return a
    shared_boxes = {(min(p[0], q[0]), min(p[1], q[1]), min(p[2], q[2])) for p, q in product(a, b)}
    contained_boxes = {
        box
        for box in shared_boxes
        for larger_box in shared_boxes
        if box != larger_box and all(map(float.__le__, box, larger_box))
    }
    return tuple(
        box for box in dict.fromkeys((*a, *b, *sorted(shared_boxes))) if box in shared_boxes - contained_boxes
    )
