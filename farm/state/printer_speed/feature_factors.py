"""Time factors by feature, fitted to finished prints: a ridge regression, robust and bounded.

Five linear equations are solved without NumPy, which the daemon does not import.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import mul
from statistics import median

from farm.model import Shares

MIN_PRINTS = 30
"""Minimum number of finished prints from which factors by feature are learned."""
MAX_PRINTS = 60
"""Number of latest finished prints that are used; they are few, so a change of the printer soon shows."""
MIN_FACTOR, MAX_FACTOR = 0.7, 1.5
"""Limits of the factor of a feature."""
_FACTOR_SPREAD = 0.2
"""[assumed] Usual difference between the factors of two features of one printer."""
_MIN_NOISE = 1e-4
"""Lower limit of the estimated noise: the deviation of ratios from the fit."""
_INITIAL_NOISE = 0.01
_MAD_TO_SIGMA = 1.4826
_HALF_WEIGHT_SIGMAS = 2.0
"""Deviation, in standard deviations, that halves the weight of a print."""
_ITERATION_COUNT = 20


@dataclass(frozen=True, slots=True, order=True)
class Timing:
    """Timing of a finished print: shares of its features, and actual time of its layers over the estimate."""

    shares: Shares
    ratio: float


def fit_feature_factors(timings: Iterable[Timing]) -> tuple[float, ...] | None:
    """Fit the factor of each feature to finished prints, in any order.

    The model of a ratio is the mean of the factors, weighted by the shares. Only prints with different shares
    make factors differ: features with constant shares, or absent ones, get the mean ratio. An outlier, such
    as a print that was paused without a record, has hardly any weight.

    Parameters
    ----------
    timings
        The prints.

    Returns
    -------
    tuple of float or None
        Factors in the order of `Shares`, between MIN_FACTOR and MAX_FACTOR; None for fewer than MIN_PRINTS.
    """
    prints = sorted(timings)
    if len(prints) < MIN_PRINTS:
        return None
    noise, weights = _INITIAL_NOISE, [1.0] * len(prints)
    factors: tuple[float, ...] = ()
    for _ in range(_ITERATION_COUNT):
        factors = _fit_factors(prints, weights, (noise / _FACTOR_SPREAD) ** 2)
        deviations = [timing.ratio - sum(map(mul, timing.shares, factors)) for timing in prints]
        noise = _estimate_noise(deviations)
        weights = [_compute_weight(deviation, noise) for deviation in deviations]
    return factors


def _estimate_noise(deviations: Sequence[float]) -> float:
    """Estimate the standard deviation from the median, which is robust against outliers."""
    return max(_MIN_NOISE, _MAD_TO_SIGMA * median(map(abs, deviations)))


def _compute_weight(deviation: float, noise: float) -> float:
    return 1.0 / (1.0 + (deviation / (_HALF_WEIGHT_SIGMAS * noise)) ** 2)


def _fit_factors(prints: Sequence[Timing], weights: Sequence[float], ridge: float) -> tuple[float, ...]:
    """Fit the mean ratio, and the differences of the factors from it, with `ridge` as the penalty factor."""
    count = len(prints[0].shares)
    total = sum(weights)
    mean_ratio = sum(map(mul, weights, (timing.ratio for timing in prints))) / total
    mean_shares = [
        sum(map(mul, weights, (timing.shares[i] for timing in prints))) / total for i in range(count)
    ]
    rows = [[share - mean for share, mean in zip(t.shares, mean_shares, strict=True)] for t in prints]
    ratios = [timing.ratio - mean_ratio for timing in prints]
    columns = list(zip(*rows, strict=True))
    weighted_columns = [list(map(mul, weights, column)) for column in columns]
    matrix = [
        [sum(map(mul, weighted_columns[i], columns[j])) + (ridge if i == j else 0.0) for j in range(count)]
        for i in range(count)
    ]
    differences = _solve_system(matrix, [sum(map(mul, column, ratios)) for column in weighted_columns])
    base = mean_ratio - sum(map(mul, mean_shares, differences))
    return tuple([min(MAX_FACTOR, max(MIN_FACTOR, base + difference)) for difference in differences])


def _solve_system(matrix: list[list[float]], vector: Sequence[float]) -> list[float]:
    """Solve a system with a positive definite matrix (n, n) by elimination, which needs no pivoting."""
    rows = [[*row, value] for row, value in zip(matrix, vector, strict=True)]
    for i, pivot in enumerate(rows):
        for row in rows[i + 1 :]:
            ratio = row[i] / pivot[i]
            row[:] = [value - ratio * above for value, above in zip(row, pivot, strict=True)]
    solution = [0.0] * len(rows)
    for i in reversed(range(len(rows))):
        known_sum = sum(map(mul, rows[i][i + 1 : -1], solution[i + 1 :]))
        solution[i] = (rows[i][-1] - known_sum) / rows[i][i]
    return solution
