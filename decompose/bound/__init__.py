"""Proven lower bounds on the makespan."""

from __future__ import annotations

from decompose.bound.makespan import bound_by_surface_s, bound_makespan

__all__ = [
    "bound_by_surface_s",
    "bound_makespan",
]
