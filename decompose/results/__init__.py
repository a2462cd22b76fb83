"""Checked results: parts in their poses, and figures."""

from __future__ import annotations

from decompose.results.check import check_result, check_stl
from decompose.results.connect import connect_parts, omit_connectors
from decompose.results.decomposition import Decomposition, Part
from decompose.results.finish import apply_time_ratios, finish_result
from decompose.results.records import Attempt, Coverage, Cutting

__all__ = [
    "Attempt",
    "Coverage",
    "Cutting",
    "Decomposition",
    "Part",
    "apply_time_ratios",
    "check_result",
    "check_stl",
    "connect_parts",
    "finish_result",
    "omit_connectors",
]
