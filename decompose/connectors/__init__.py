"""Connectors on faces that are glued: pins in holes, keys in grooves, marks with part numbers, gutters."""

from __future__ import annotations

from decompose.connectors.coupon import Coupon, make_coupon
from decompose.connectors.faces import LEVEL_SIN, Blank, build_polygons, list_rings
from decompose.connectors.pair_shapes import measure_pair
from decompose.connectors.plan import drill_parts, plan_connectors
from decompose.connectors.records import (
    Connector,
    Connectors,
    Mark,
    Pin,
    Tool,
    find_pairs,
)
from decompose.connectors.report import describe_connectors, list_pin_sizes, read_pair_shapes

__all__ = [
    "LEVEL_SIN",
    "Blank",
    "Connector",
    "Connectors",
    "Coupon",
    "Mark",
    "Pin",
    "Tool",
    "build_polygons",
    "describe_connectors",
    "drill_parts",
    "find_pairs",
    "list_pin_sizes",
    "list_rings",
    "make_coupon",
    "measure_pair",
    "plan_connectors",
    "read_pair_shapes",
]
