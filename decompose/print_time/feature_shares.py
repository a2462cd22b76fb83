"""Shares of walls, infill, skins, supports, brim and travel in the price of an uncut model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.print_time.cost import CostModel
from decompose.print_time.pose_prices import sum_pose_features
from decompose.print_time.time_settings import ADDITIVE_FEATURES, FACTORS, PrintTimeSettings

TERM_GROUPS: Mapping[str, tuple[str, ...]] = {
    "walls": ("walls",),
    "infill": ("infill", "connections", "steep tops"),
    "skins": ("skin", "skin rim", "rims", "thin walls", "thin sheets"),
    "supports": ("support", "support sides"),
    "brim": ("brim",),
    "travel": (
        "slope ends",
        "infill ends",
        "travel",
        "islands",
        "island paths",
        "holes",
        "rim ends",
        "rings",
    ),
}
"""Terms of `compute_time_terms`, by the feature of the print to which they belong."""


def estimate_feature_shares(vertices: Floats, faces: Ints, settings: PrintTimeSettings) -> dict[str, float]:
    """Estimate the share of each of `TERM_GROUPS` in the price of a model; the shares sum to 1.

    The share of supports is 0, because cuts are chosen to avoid supports.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh that faces outward.
    settings
        Settings of the slicer.
    """
    settings_without_overhead = replace(settings, overhead_s=0.0, min_layer_s=0.0)
    (features,), _ = sum_pose_features(
        vertices,
        faces,
        np.eye(3)[None],
        CostModel.from_settings(settings_without_overhead),
        is_cut=np.zeros(len(faces), np.bool_),
    )
    features[ADDITIVE_FEATURES.index("column_mm3")] = 0.0
    extents_mm = np.ptp(vertices, axis=0)
    seconds = {
        group: max(0.0, build_group_cost(settings_without_overhead, group).price_part_s(features, extents_mm))
        for group in TERM_GROUPS
    }
    total_s = sum(seconds.values())
    return {group: value_s / total_s for group, value_s in seconds.items()}


def build_group_cost(settings: PrintTimeSettings, group: str) -> CostModel:
    """Build the cost model of the terms of one of `TERM_GROUPS`.

    Parameters
    ----------
    settings
        Settings of the slicer.
    group
        Name of the group.
    """
    factors = {name: factor if name in TERM_GROUPS[group] else 0.0 for name, factor in FACTORS.items()}
    return CostModel.from_settings(settings, factors)
