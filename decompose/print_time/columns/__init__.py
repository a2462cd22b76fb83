"""Upright columns of a part in a pose: its supports, its mass and islands by height, and its brim."""

from __future__ import annotations

from decompose.print_time.columns.columns import Columns, estimate_supports, measure_columns

__all__ = ["Columns", "estimate_supports", "measure_columns"]
