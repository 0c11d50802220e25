"""Statistics of columns of numbers: quantiles, correlations, and Sobol indices. Rows without a number do not count."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..text.arrays import Array

RESAMPLES = 200


class SobolIndex(NamedTuple):
    """Which share of the variance of a measure comes from a parameter.

    first: from it alone. total: from it and all that it interacts with. Each with its standard error.
    """

    first: float
    first_error: float
    total: float
    total_error: float


def quantiles(values: Array, q: Array) -> Array:
    """Quantiles over the rows of values (n, ...): (len(q), ...); nan where no row has a number. inf is one."""
    some = ~np.isnan(values).all(axis=0)
    made = np.full((len(q), *values.shape[1:]), np.nan)
    if some.ndim == 0:
        return _quantiles(values, q) if some else made
    made[:, some] = _quantiles(values[:, some], q)
    return made


def _quantiles(values: Array, q: Array) -> Array:
    if not np.isinf(values).any():
        return np.asarray(np.nanquantile(values, q, axis=0))
    # NumPy gives nan beside an infinite value, also at a number.
    return np.asarray(np.apply_along_axis(_beside_infinite, 0, values, q))


def _beside_infinite(values: Array, q: Array) -> Array:
    known = np.sort(values[~np.isnan(values)])
    place = (len(known) - 1) * q
    low, high = known[np.floor(place).astype(int)], known[np.ceil(place).astype(int)]
    with np.errstate(invalid="ignore"):  # between -inf and inf there is no value
        between = np.where(np.isfinite(low), low + (high - low) * (place % 1.0), low + high)
        made: Array = np.where(low == high, low, between)
    return made


def correlation(x: Array, y: Array, *, by_rank: bool = False) -> float:
    """The coefficient of Pearson of two columns (n,), or of Spearman (by_rank); nan where one of them is constant."""
    kept = np.isfinite(x) & np.isfinite(y)
    x, y = x[kept], y[kept]
    if len(x) < 2 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return float("nan")
    if by_rank:
        from scipy.stats import rankdata

        x, y = rankdata(x), rankdata(y)  # equal values share their mean rank
    x, y = x - x.mean(), y - y.mean()
    x, y = x / np.abs(x).max(), y / np.abs(y).max()  # squares of what is tiny or huge stay numbers
    return float(np.clip(x @ y / np.sqrt((x @ x) * (y @ y)), -1.0, 1.0))


def sobol_indices(values: Array, base: int, columns: int) -> list[SobolIndex]:
    """The indices of a measure (base * (columns + 2),) of rows that the sampler "saltelli" has drawn.

    A row that has no number is left out in all samples. The errors are those of a bootstrap over the base rows.

    References: Saltelli et al., Computer Physics Communications 181 (2010), 259-270: table 2, (b) and (f).
    """
    a, b, *mixed = samples = values.reshape(columns + 2, base)
    kept = np.isfinite(samples).all(axis=0)
    a, b, ab = a[kept], b[kept], np.array(mixed)[:, kept]
    if len(a) < 2:
        return [SobolIndex(*[float("nan")] * 4)] * columns
    middle = np.mean([a, b])
    a, b, ab = a - middle, b - middle, ab - middle
    generator = np.random.default_rng(0)
    drawn = [np.arange(len(a)), *(generator.integers(len(a), size=len(a)) for _ in range(RESAMPLES))]
    first, total = (np.empty((len(drawn), columns)) for _ in range(2))
    for k, rows in enumerate(drawn):
        A, B, AB = a[rows], b[rows], ab[:, rows]
        variance = np.var([A, B])
        with np.errstate(divide="ignore", invalid="ignore"):  # a measure that does not vary has no indices
            first[k] = np.mean(B * (AB - A), axis=1) / variance
            total[k] = 0.5 * np.mean((A - AB) ** 2, axis=1) / variance
    errors = first[1:].std(axis=0), total[1:].std(axis=0)
    return [SobolIndex(*map(float, each)) for each in zip(first[0], errors[0], total[0], errors[1], strict=True)]
