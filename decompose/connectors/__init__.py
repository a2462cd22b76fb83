"""Connectors of the parts: pins in holes, and marks that name the parts, on the faces that are glued."""

from __future__ import annotations

from decompose.connectors.coupon import Coupon, make_coupon
from decompose.connectors.faces import LEVEL_SIN, Blank, polygons_of, rings_of
from decompose.connectors.pins import pairs_of
from decompose.connectors.plan import drill, plan_connectors
from decompose.connectors.records import Connectors, Mark, Pin, Tool, distance_mm
from decompose.connectors.report import describe_connectors, list_cuts, read_pair_distances_mm

__all__ = [
    "LEVEL_SIN",
    "Blank",
    "Connectors",
    "Coupon",
    "Mark",
    "Pin",
    "Tool",
    "describe_connectors",
    "distance_mm",
    "drill",
    "list_cuts",
    "make_coupon",
    "pairs_of",
    "plan_connectors",
    "polygons_of",
    "read_pair_distances_mm",
    "rings_of",
]
