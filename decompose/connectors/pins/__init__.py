"""Pins and keys of each assembly step: their places and sizes, and those that can be left out."""

from __future__ import annotations

from decompose.connectors.pins.sizes import END_GAP_MM, choose_depths_mm
from decompose.connectors.pins.steps import place_pins

__all__ = ["END_GAP_MM", "choose_depths_mm", "place_pins"]
