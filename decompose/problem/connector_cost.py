"""Prices of pins and marks by the area of the cut faces, while their places are not known.

They are fitted to sliced parts (`bench.prices.joint_costs`), so that the prints of parts with pins and marks
finish at the same time.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from decompose.options import ConnectorOptions
from decompose.print_time import CostModel


class AreaPrices(NamedTuple):
    """Seconds for each mm2 of upright cut faces, and of the other cut faces."""

    side_s_per_mm2: float
    level_s_per_mm2: float


PIN_AREA_PRICES = AreaPrices(0.0011, 0.0062)
MARK_AREA_PRICES = AreaPrices(0.0028, 0.0028)  # with gutters


def set_connector_prices(cost: CostModel, options: ConnectorOptions) -> CostModel:
    """Set a cost model's prices per area of cut face to those of the requested pins and marks."""
    prices = [PIN_AREA_PRICES] if options.pin_mm is not None else []
    prices += [MARK_AREA_PRICES] if options.marks else []
    side_s_per_mm2 = sum(price.side_s_per_mm2 for price in prices)
    level_s_per_mm2 = sum(price.level_s_per_mm2 for price in prices)
    return replace(cost, connector_side_s_per_mm2=side_s_per_mm2, connector_level_s_per_mm2=level_s_per_mm2)
