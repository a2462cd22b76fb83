"""Proven lower bounds on the makespan."""

from __future__ import annotations

from decompose.bound.makespan import makespan_bound, surface_bound_s

__all__ = [
    "makespan_bound",
    "surface_bound_s",
]
