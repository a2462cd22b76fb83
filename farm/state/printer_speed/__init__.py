"""Time factors of a printer, learned from its finished prints: for all layers, and by feature. Pure."""

from farm.state.printer_speed.feature_factors import (
    MAX_FACTOR,
    MAX_PRINTS,
    MIN_FACTOR,
    MIN_PRINTS,
    Timing,
    fit_feature_factors,
)
from farm.state.printer_speed.finished_prints import learn_speed, list_timings
from farm.state.printer_speed.time_factor import (
    MAX_STARVED_SHARE,
    MAX_TIME_FACTOR,
    MIN_LEARNED_S,
    MIN_TIME_FACTOR,
    is_learnable,
    update_time_factor,
)

__all__ = [
    "MAX_FACTOR",
    "MAX_PRINTS",
    "MAX_STARVED_SHARE",
    "MAX_TIME_FACTOR",
    "MIN_FACTOR",
    "MIN_LEARNED_S",
    "MIN_PRINTS",
    "MIN_TIME_FACTOR",
    "Timing",
    "fit_feature_factors",
    "is_learnable",
    "learn_speed",
    "list_timings",
    "update_time_factor",
]
