"""Search for missing lines in files with absolute E: a move extrudes more filament than its line takes.

The move after missing lines extrudes their filament as well as its own. A gap in the layer numbers alone
proves nothing: a slicer skips empty layers, and E continues as if they had never existed.
"""

from __future__ import annotations

from dataclasses import dataclass

from slicing.own_gcode.completeness.figures import E_UNIT_MM

_MIN_EXCESS_MM = 3e-4
"""Minimum excess filament that shows a loss, in the first line after a gap. Measured at 18,500 layer
changes of CuraEngine 4.13: at most 1e-5 mm where nothing is missing. The smallest layer, a spire's tip, has
4e-4."""
_MIN_EXCESS_BEFORE_GAP_MM = 0.01
"""The same for a layer before a gap, which may lack a part. Measured in 1.4 million lines: at most 2e-4."""
_MIN_EXCESS_ELSEWHERE_MM = 0.2
"""The same if no layer number is missing. [assumed] No line of Cura 5, whose widths vary, takes so much
more than all other lines in its layer and in the two adjacent layers."""
_LINE_SHARE = 0.01
"""Share of a line's own filament that is ignored: its length and its E are rounded."""
_MIN_LINE_MM = 0.03
"""Length below which the flow of a line is too inaccurate for a comparison."""


@dataclass(frozen=True, slots=True)
class _Extrusion:
    """Move that extrudes: its line, length and filament."""

    line: int
    length_mm: float
    fed_mm: float

    def compute_excess_mm(self, flow: float) -> float:
        """Compute the filament beyond what a line of this flow takes."""
        return self.fed_mm - (1 + _LINE_SHARE) * flow * self.length_mm


@dataclass(slots=True)
class _Layer:
    """Greatest flow of a layer with its line, second greatest flow, and first line after a gap."""

    number: int
    greatest_flow: float = 0.0
    thickest_line: _Extrusion | None = None
    second_flow: float = 0.0
    extrusion_after_gap: tuple[_Extrusion, str] | None = None

    def add_line(self, length_mm: float, fed_mm: float, line: int) -> None:
        """Record a line that is long enough for a comparison."""
        flow = (fed_mm + E_UNIT_MM) / length_mm
        if flow > self.greatest_flow:
            self.second_flow, self.greatest_flow = self.greatest_flow, flow
            self.thickest_line = _Extrusion(line, length_mm, fed_mm)
        elif flow > self.second_flow:
            self.second_flow = flow


class LayerGaps:
    """Comparison of the filament of each move with the flow of nearby layers, in files with numbered layers.

    Parameters
    ----------
    max_flow
        Filament in mm for each mm of the thickest line allowed, for layers without a line for comparison.
    """

    def __init__(self, max_flow: float) -> None:
        self.max_flow = max_flow
        self._earlier_flow = 0.0  # greatest flow of the layer before the previous one
        self._previous_layer: _Layer | None = None
        self._layer: _Layer | None = None  # None before the first number: 0, or less in a raft
        self._gap_text = ""  # place of the last gap, until a line is printed after it
        self._primed_mm = 0.0  # most filament extruded at standstill, except at gaps
        # Extrusions at standstill after a gap, each with the text of the gap.
        self._gap_primes: list[tuple[_Extrusion, str]] = []
        self._loss: str | None = None

    def begin_layer(self, number: int) -> None:
        """Begin the layer of this number."""
        previous_number = -1 if self._layer is None else self._layer.number
        self._close_layer()
        if number > previous_number + 1:
            self._gap_text = f" after ;LAYER:{previous_number}, in ;LAYER:{number},"
        self._layer = _Layer(number)

    def record_extrusion(self, length_mm: float, fed_mm: float, line: int) -> None:
        """Record a move that extrudes filament.

        Parameters
        ----------
        length_mm
            Length of the move.
        fed_mm
            Filament, excluding the return of retracted filament; negative while a retraction is only partly
            undone.
        line
            Number of its line.
        """
        if self._layer is None:
            return
        if self._gap_text:
            extrusion = _Extrusion(line, length_mm, fed_mm)
            if length_mm:
                self._layer.extrusion_after_gap, self._gap_text = (extrusion, self._gap_text), ""
            else:  # G11 feeds before the line, and does not move E
                self._gap_primes.append((extrusion, self._gap_text))
        elif length_mm > _MIN_LINE_MM:
            self._layer.add_line(length_mm, fed_mm, line)
        elif not length_mm:
            self._primed_mm = max(self._primed_mm, fed_mm)

    def describe_loss(self) -> str | None:
        """Describe the move that shows that lines are missing; None if there is none."""
        if self._layer is not None:
            self._close_layer()
            self._layer = _Layer(self._layer.number + 1)
            self._close_layer()
            self._layer = None
        for extrusion, gap_text in self._gap_primes:
            self._check_extrusion(extrusion, extrusion.fed_mm - self._primed_mm, _MIN_EXCESS_MM, gap_text)
        return self._loss

    def _close_layer(self) -> None:
        """Compare the first line after a gap, and the previous layer's thickest line, with nearby flows."""
        layer, previous = self._layer, self._previous_layer
        if layer is None:
            return
        previous_flow = 0.0 if previous is None else previous.greatest_flow
        if layer.extrusion_after_gap is not None:
            extrusion, gap_text = layer.extrusion_after_gap
            flow = max(layer.greatest_flow, previous_flow) or self.max_flow
            self._check_extrusion(extrusion, extrusion.compute_excess_mm(flow), _MIN_EXCESS_MM, gap_text)
        if previous is not None and previous.thickest_line is not None:
            flow = max(previous.second_flow, self._earlier_flow, layer.greatest_flow) or self.max_flow
            min_excess_mm = (
                _MIN_EXCESS_BEFORE_GAP_MM if layer.number > previous.number + 1 else _MIN_EXCESS_ELSEWHERE_MM
            )
            self._check_extrusion(
                previous.thickest_line, previous.thickest_line.compute_excess_mm(flow), min_excess_mm, ""
            )
        self._earlier_flow, self._previous_layer = previous_flow, layer

    def _check_extrusion(
        self, extrusion: _Extrusion, excess_mm: float, min_excess_mm: float, gap_text: str
    ) -> None:
        if excess_mm > min_excess_mm and self._loss is None:
            move = f"the first move that feeds{gap_text}" if gap_text else "the move"
            self._loss = (
                f"line {extrusion.line}: {move} feeds {excess_mm:.4f} mm of filament more than its line takes"
            )
