"""Time factors by feature, fitted to finished prints by a robust ridge regression with bounded results.

The five linear equations are solved without NumPy, because the daemon does not import it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import mul
from statistics import median

from farm.model import Shares

MIN_PRINTS = 30
"""Minimum number of finished prints for learning factors by feature."""
MAX_PRINTS = 60
"""Maximum number of latest prints used: low, so that a change of the printer soon has an effect."""
MIN_FACTOR, MAX_FACTOR = 0.7, 1.5
"""Limits of the factor of a feature."""
_FACTOR_SPREAD = 0.2
"""[assumed] Standard deviation of the factors of one printer's features."""
_MIN_NOISE = 1e-4
"""Lower limit of the noise: the estimated standard deviation of the ratios from the fit."""
_INITIAL_NOISE = 0.01
_MAD_TO_SIGMA = 1.4826
_HALF_WEIGHT_SIGMAS = 2.0
"""Deviation at which the weight of a print is one half, in standard deviations."""
_ITERATION_COUNT = 20


@dataclass(frozen=True, slots=True, order=True)
class Timing:
    """Timing of a finished print.

    Attributes
    ----------
    shares
        Share of each feature in the sliced time of the print's layers.
    ratio
        Actual time of the layers, divided by their sliced time.
    """

    shares: Shares
    ratio: float


def fit_feature_factors(timings: Iterable[Timing]) -> tuple[float, ...] | None:
    """Fit the factor of each feature to finished prints, in any order.

    The model of a ratio is the mean of the factors, weighted by the shares. Factors differ only if the shares
    of the prints differ: a feature whose share is constant or zero gets the mean ratio. An outlier, such as a
    print with a pause that was not recorded, has hardly any weight.

    Parameters
    ----------
    timings
        Timings of the prints.

    Returns
    -------
    tuple of float or None
        Factors in the order of `Shares`, from MIN_FACTOR to MAX_FACTOR; None below MIN_PRINTS prints.
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
    """Estimate the standard deviation from the median deviation, which is robust against outliers."""
    return max(_MIN_NOISE, _MAD_TO_SIGMA * median(map(abs, deviations)))


def _compute_weight(deviation: float, noise: float) -> float:
    return 1.0 / (1.0 + (deviation / (_HALF_WEIGHT_SIGMAS * noise)) ** 2)


def _fit_factors(prints: Sequence[Timing], weights: Sequence[float], ridge: float) -> tuple[float, ...]:
    """Fit the factors by weighted least squares; `ridge` penalises their differences from the mean."""
    feature_count = len(prints[0].shares)
    total = sum(weights)
    mean_ratio = sum(map(mul, weights, (timing.ratio for timing in prints))) / total
    mean_shares = [
        sum(map(mul, weights, (timing.shares[i] for timing in prints))) / total for i in range(feature_count)
    ]
    rows = [[share - mean for share, mean in zip(t.shares, mean_shares, strict=True)] for t in prints]
    ratios = [timing.ratio - mean_ratio for timing in prints]
    columns = list(zip(*rows, strict=True))
    weighted_columns = [list(map(mul, weights, column)) for column in columns]
    matrix = [
        [sum(map(mul, weighted, column)) + (ridge if i == j else 0.0) for j, column in enumerate(columns)]
        for i, weighted in enumerate(weighted_columns)
    ]
    differences = _solve_system(matrix, [sum(map(mul, column, ratios)) for column in weighted_columns])
    base = mean_ratio - sum(map(mul, mean_shares, differences))
    return tuple([min(MAX_FACTOR, max(MIN_FACTOR, base + difference)) for difference in differences])


def _solve_system(matrix: list[list[float]], vector: Sequence[float]) -> list[float]:
    """Solve a linear system with a positive definite matrix (n, n) by elimination, without pivoting."""
    rows = [[*row, value] for row, value in zip(matrix, vector, strict=True)]
    for i, pivot in enumerate(rows):
        for row in rows[i + 1 :]:
            ratio = row[i] / pivot[i]
            row[:] = [value - ratio * pivot_value for value, pivot_value in zip(row, pivot, strict=True)]
    solution = [0.0] * len(rows)
    for i in reversed(range(len(rows))):
        known_sum = sum(map(mul, rows[i][i + 1 : -1], solution[i + 1 :]))
        solution[i] = (rows[i][-1] - known_sum) / rows[i][i]
    return solution
