"""Proven lower bounds on the makespan."""

from __future__ import annotations

from decompose.bound.any_boxes import compute_any_boxes_bound_s
from decompose.bound.makespan import bound_makespan, compute_surface_bound_s

__all__ = [
    "bound_makespan",
    "compute_any_boxes_bound_s",
    "compute_surface_bound_s",
]
