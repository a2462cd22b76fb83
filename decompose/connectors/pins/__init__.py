"""Pins and keys of each assembly step: their places and sizes, and those that can be left out."""

from __future__ import annotations

from decompose.connectors.pins.placer import place_pins
from decompose.connectors.pins.sizes import END_GAP_MM, choose_depths_mm

__all__ = ["END_GAP_MM", "choose_depths_mm", "place_pins"]
