"""Progress of a print at each line of its file, from the slicer's comments. Pure.

A file of 50 MB has about 200,000 entries: they are stored in columns, 29 bytes per entry.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

_NO_LAYER = -(2**31)


class Feature(StrEnum):
    """Feature that a move prints, named as in Cura's ``;TYPE:`` comments."""

    SKIRT = "SKIRT"  # or a brim
    SUPPORT = "SUPPORT"
    SUPPORT_INTERFACE = "SUPPORT-INTERFACE"
    WALL_OUTER = "WALL-OUTER"
    WALL_INNER = "WALL-INNER"
    SKIN = "SKIN"
    FILL = "FILL"
    PRIME_TOWER = "PRIME-TOWER"


_FEATURES = tuple(Feature)
_FEATURE_NUMBERS = {feature: number for number, feature in enumerate(_FEATURES)}


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a print at one line of its program.

    Attributes
    ----------
    line
        Line of the program, from 0.
    time_s
        Print time as counted by the slicer, which excludes heating, homing, start code and end code.
    layer
        Layer of the file, from 0; None before the first.
    z_mm
        Z of the layer; 0 before the first.
    feature
        Feature being printed; None if the file does not say.
    """

    line: int
    time_s: float
    layer: int | None = None
    z_mm: float = 0.0
    feature: Feature | None = None


class Timeline:
    """Progress at the lines with a comment, in increasing order; in between, time is interpolated by line.

    Call `add_layer`, `add_feature`, `set_layer_height` and `add_time` in the order of the lines; then call
    `close`.

    Attributes
    ----------
    time_s
        Print time of the whole file, in seconds.
    layer_count
        Number of layers.
    """

    def __init__(self) -> None:
        self.time_s = 0.0
        self.layer_count = 0
        self._lines, self._times_s = array("Q"), array("d")  # times are NaN if no comment states them
        self._layers, self._heights_mm, self._features = array("i"), array("d"), array("b")
        self._layer = _NO_LAYER
        self._z_mm = 0.0
        self._feature = -1

    def __len__(self) -> int:
        return len(self._lines)

    def __getitem__(self, index: int) -> Progress:
        layer, feature = self._layers[index], self._features[index]
        return Progress(
            self._lines[index],
            self._times_s[index],
            None if layer == _NO_LAYER else layer,
            self._heights_mm[index],
            None if feature < 0 else _FEATURES[feature],
        )

    def __iter__(self) -> Iterator[Progress]:
        return (self[index] for index in range(len(self)))

    def compute_progress(self, line: int, line_count: int) -> Progress:
        """Compute the progress after `line` of `line_count` lines."""
        index = bisect_right(self._lines, line)
        previous = self[index - 1] if index else Progress(0, 0.0)
        if line >= line_count or index == len(self):
            return replace(previous, line=line, time_s=self.time_s if line >= line_count else previous.time_s)
        fraction = (line - previous.line) / (self._lines[index] - previous.line)
        return replace(
            previous,
            line=line,
            time_s=previous.time_s + fraction * (self._times_s[index] - previous.time_s),
        )

    # --- additions ---

    def add_time(self, line: int, time_s: float) -> None:
        """Add the print time at a line."""
        self.time_s = max(self.time_s, time_s)
        self._add_entry(line, self.time_s)

    def add_layer(self, line: int, layer: int) -> None:
        """Add a layer that begins at a line."""
        self.layer_count = max(self.layer_count, layer + 1)
        self._layer, self._feature = layer, -1
        self._add_entry(line, math.nan if self._lines else 0.0)  # the slicer counts from the first layer

    def add_feature(self, line: int, name: str) -> None:
        """Add a feature that begins at a line."""
        self._feature = _FEATURE_NUMBERS[Feature(name)] if name in _FEATURE_NUMBERS else -1
        self._add_entry(line, math.nan)

    def set_layer_height(self, z_mm: float) -> None:
        """Set the height of the current layer; call this before the first feature of the layer."""
        self._z_mm = z_mm
        if self._lines and self._feature < 0:
            self._layers[-1], self._heights_mm[-1], self._features[-1] = self._layer, z_mm, -1

    def close(self) -> None:
        """Interpolate the times of entries without a time."""
        lines, times_s = self._lines, self._times_s
        last_line, last_s, unknown_start = 0, 0.0, 0
        for index, line in enumerate(lines):
            if math.isnan(times_s[index]):
                continue
            for unknown in range(unknown_start, index):
                fraction = (lines[unknown] - last_line) / (line - last_line)
                times_s[unknown] = last_s + fraction * (times_s[index] - last_s)
            last_line, last_s, unknown_start = line, times_s[index], index + 1
        for unknown in range(unknown_start, len(lines)):
            times_s[unknown] = last_s

    def _add_entry(self, line: int, time_s: float) -> None:
        if not (self._lines and self._lines[-1] == line):
            self._lines.append(line)
            self._times_s.append(time_s)
            self._layers.append(self._layer)
            self._heights_mm.append(self._z_mm)
            self._features.append(self._feature)
            return
        self._layers[-1], self._heights_mm[-1], self._features[-1] = self._layer, self._z_mm, self._feature
        if not math.isnan(time_s):
            self._times_s[-1] = time_s
