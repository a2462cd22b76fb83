"""Proven lower bounds on the makespan."""

from __future__ import annotations

from decompose.bound.any_boxes import bound_shared_work_s, sum_least_work_s
from decompose.bound.makespan import bound_makespan, compute_surface_bound_s

__all__ = [
    "bound_makespan",
    "bound_shared_work_s",
    "compute_surface_bound_s",
    "sum_least_work_s",
]
