"""Assembly of the parts: the order in which they are glued, and the direction in which each joint closes."""

from __future__ import annotations

from decompose.assembly.order import Assembly, AssemblyStep, plan_assembly
from decompose.assembly.replay import find_order_faults

__all__ = ["Assembly", "AssemblyStep", "find_order_faults", "plan_assembly"]
