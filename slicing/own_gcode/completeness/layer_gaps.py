"""Gaps in the numbers of a file's layers: empty layers that were left out, or layers that were lost.

A slicer that leaves out an empty layer counts E on as if it had never been. Where layers were lost from a
file with absolute E, the first move after the gap feeds all of their filament besides its own.
"""

from __future__ import annotations

from dataclasses import dataclass

from slicing.own_gcode.completeness.figures import E_UNIT_MM

_LEAST_MM = 3e-4
"""Least filament that shows a loss. Measured at 18,500 changes of layer of CuraEngine 4.13: at most 1e-5 mm
where no layer is missing, and 0.0004 mm in the smallest layer, the tip of a spire."""
_LINE_SHARE = 0.01
"""Share of a line's own filament that is not looked at: its length and its E are rounded."""
_SHORT_MM = 0.03
"""Length of a line below which its flow is too coarse to compare with."""


@dataclass(frozen=True, slots=True)
class _Feed:
    """Feed after a gap up to its first line: numbers of the layers and of the line, filament and length."""

    before: int
    after: int
    line: int
    fed_mm: float
    length_mm: float


class LayerGaps:
    """Compares the first feed after each gap with the flow of the layers on both sides.

    Parameters
    ----------
    most_flow
        Filament in mm for each mm of the thickest line, for layers that have no line to compare with.
    """

    def __init__(self, most_flow: float) -> None:
        self._most_flow = most_flow
        self._number = -1  # of the layer; the first one is 0, or less in a raft
        self._from: int | None = None  # layer before a gap, until a line is printed after it
        self._after: list[_Feed] = []  # feeds after a gap, in the current layer
        self._flow = self._flow_before = 0.0  # greatest of the current layer, and of the one before
        self._primed_mm = 0.0  # most filament fed at one place, at no gap
        self._feeds: list[tuple[_Feed, float]] = []  # feeds after gaps, and what their lines take in mm

    def begin_layer(self, number: int) -> None:
        """Begin the layer of this number."""
        self._close_layer()
        if number > self._number + 1:
            self._from = self._number
        self._number = number

    def feed(self, length_mm: float, fed_mm: float, line: int) -> None:
        """Take a move that feeds filament.

        Parameters
        ----------
        length_mm
            Length of the move.
        fed_mm
            Filament beyond what was drawn back; negative where less is pushed back.
        line
            Number of its line.
        """
        if self._from is not None:
            self._after.append(_Feed(self._from, self._number, line, fed_mm, length_mm))
            if length_mm:  # G11 feeds before it, and does not move E
                self._from = None
        elif length_mm > _SHORT_MM:
            self._flow = max(self._flow, (fed_mm + E_UNIT_MM) / length_mm)
        elif not length_mm:
            self._primed_mm = max(self._primed_mm, fed_mm)

    def find_lost(self) -> str | None:
        """Give the reason why layers were lost in one of the gaps; None where all were empty."""
        self._close_layer()
        for feed, own_mm in self._feeds:
            lost_mm = feed.fed_mm - (own_mm if feed.length_mm else self._primed_mm)
            if lost_mm > _LEAST_MM:
                return (
                    f"line {feed.line}: the first move that feeds after ;LAYER:{feed.before}, in "
                    f";LAYER:{feed.after}, feeds {lost_mm:.4f} mm of filament more than its line takes"
                )
        return None

    def _close_layer(self) -> None:
        flow = max(self._flow, self._flow_before) or self._most_flow
        self._feeds += ((feed, (1 + _LINE_SHARE) * flow * feed.length_mm) for feed in self._after)
        self._after.clear()
        self._flow_before, self._flow = self._flow, 0.0
