"""Cameras of printers: stills for viewers, and stills that are kept with each print."""

from __future__ import annotations

from farm.cameras.cameras import Cameras
from farm.cameras.image import Image

__all__ = ["Cameras", "Image"]
