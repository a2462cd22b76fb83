"""Proven lower bounds on the makespan."""

from __future__ import annotations

from decompose.bound.any_boxes import bound_any_boxes_s
from decompose.bound.makespan import bound_by_surface_s, bound_makespan

__all__ = [
    "bound_any_boxes_s",
    "bound_by_surface_s",
    "bound_makespan",
]
