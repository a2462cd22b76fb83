"""Keys: pins that lie along a joint. The places where they fit, and the choice among these places."""

from __future__ import annotations

from decompose.connectors.keys.placer import KeyPlacer
from decompose.connectors.keys.places import (
    KeyMaker,
    choose_key_lengths_mm,
    compute_bottom_length_mm,
    compute_groove_depth_mm,
)

__all__ = [
    "KeyMaker",
    "KeyPlacer",
    "choose_key_lengths_mm",
    "compute_bottom_length_mm",
    "compute_groove_depth_mm",
]
