"""Upright columns of a part in a pose: its supports, its mass and islands by height, and its brim."""

from __future__ import annotations

from decompose.print_time.columns.columns import Columns, measure_columns

__all__ = ["Columns", "measure_columns"]
