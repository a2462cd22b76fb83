"""Layers of any height with an engine that keeps heights in whole micrometres.

CuraEngine rounds layer heights to whole micrometres. A part of 400 layers could only have heights 0.4 mm
apart, or layers far below the largest. So the model is sliced a little higher or lower, by the ratio of the
rounded height to the exact one, and the heights in the G-code are divided by it. The filament is that of the
rounded layers: 0.25 % too much or too little at most with layers of 0.2 mm, 0.5 % with layers of 0.1 mm.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from slicing.errors import Rule, SliceRejected
from slicing.mesh import Floats
from slicing.settings import EngineSettings

_Z_WORD = re.compile(rb"(?m)^(G[01] [^\n;]*\bZ)([.\d]+)")
_FIRST_LAYER, _LAYER_END = b"\n;LAYER:0\n", b"\n;TIME_ELAPSED:"


@dataclass(frozen=True, slots=True)
class LayerScale:
    """Scale of the engine's heights above the top of the first layer."""

    first_layer_mm: float
    ratio: float  # of the engine's layer height to the exact one

    @classmethod
    def from_settings(cls, settings: EngineSettings) -> LayerScale | None:
        """Find the scale; None if the engine's heights are exact, or if it does not use one layer height."""
        if settings.global_["adaptive_layer_height_enabled"] == "True":
            return None
        first_layer_mm, engine_mm = (
            int(1000.0 * height_mm + 0.5) / 1000.0
            for height_mm in (settings.layer_height_0_mm, settings.layer_height_mm)
        )
        ratio = engine_mm / settings.layer_height_mm
        return None if abs(ratio - 1.0) < 1e-9 else cls(first_layer_mm, ratio)

    def scale_model(self, corners: Floats) -> Floats:
        """Scale the heights of triangles (n, 3 corners, xyz) in mm to those of the engine."""
        scaled = corners.copy()
        above = corners[..., 2] > 0.0
        scaled[above, 2] = self.first_layer_mm + self.ratio * (corners[above, 2] - self.first_layer_mm)
        return scaled

    def restore_heights(self, gcode: bytes) -> bytes:
        """Restore the heights in the engine's layers; its start and end code stay as they are.

        Raises
        ------
        SliceRejected
            `LAYERS` if the engine's comments do not show where its layers begin and end.
        """
        start, end = gcode.find(_FIRST_LAYER), gcode.rfind(_LAYER_END)
        if not 0 <= start < end:
            raise SliceRejected(
                Rule.LAYERS, "the file lacks CuraEngine's comments on layers; use a supported version"
            )
        layers = _Z_WORD.sub(self._restore_word, gcode[start:end])
        return gcode[:start] + layers + gcode[end:]

    def _restore_word(self, match: re.Match[bytes]) -> bytes:
        """Restore the height in a move."""
        z_mm = float(match[2])
        if z_mm > self.first_layer_mm:
            z_mm = self.first_layer_mm + (z_mm - self.first_layer_mm) / self.ratio
        return b"%b%.3f" % (match[1], z_mm)
