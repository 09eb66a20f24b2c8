"""Allan deviation: the spread of averages over neighbouring windows. For tools and tests, in float64 NumPy."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError

Float64 = npt.NDArray[np.float64]
_SERIES_BELOW = 0.1


def overlapping_allan_deviation(
    values: npt.ArrayLike, sample_period: float, lengths: npt.ArrayLike | None = None
) -> tuple[Float64, Float64]:
    """Return the overlapping Allan deviation (K, ...) of sampled values, in their unit, and the windows (K,) [s].

    The root of half the mean squared difference of the averages over two neighbouring windows, over all pairs of
    windows that fit into the record (IEEE Std 1139-2008, annex B, with the values as frequency).

    Args:
        values: (N, ...) samples of a quantity; axis 0 is time.
        sample_period: [s].
        lengths: (K,) window lengths in samples, each from 1 to N/2; None: the powers of two.

    Raises:
        UsageError: fewer than two samples, a value or period that is not finite, or a length that does not fit.
    """
    data = np.asarray(values, np.float64)
    if data.ndim == 0 or len(data) < 2 or not np.all(np.isfinite(data)):
        raise UsageError(f"values: at least 2 finite samples along axis 0 needed; got shape {data.shape}")
    if not 0.0 < sample_period < math.inf:
        raise UsageError(f"sample_period: {sample_period} s is not positive and finite")
    count = len(data)
    chosen = 2 ** np.arange((count // 2).bit_length()) if lengths is None else np.atleast_1d(np.asarray(lengths))
    if not np.issubdtype(chosen.dtype, np.integer) or np.any(chosen < 1) or np.any(2 * chosen > count):
        raise UsageError(f"lengths: expected whole numbers from 1 to {count // 2}, half the {count} samples")
    # Sums over windows are differences of running sums; without the mean these stay small.
    total = np.concatenate([np.zeros((1, *data.shape[1:])), np.cumsum(data - data.mean(axis=0), axis=0)])
    deviations = []
    for length in chosen:
        change = total[2 * length :] - 2.0 * total[length:-length] + total[: -2 * length]
        deviations.append(np.sqrt(0.5 * np.mean(np.square(change / length), axis=0)))
    return np.asarray(chosen * float(sample_period), np.float64), np.stack(deviations)


def exponential_allan_variance(window: npt.ArrayLike, time_constant: npt.ArrayLike) -> Float64:
    """Return the Allan variance (...) of a unit-variance process with autocovariance exp(-|t| / time_constant).

    With x = window / time_constant it is (2 x - 3 + 4 exp(-x) - exp(-2 x)) / x^2: half the expected square of the
    difference of two neighbouring averages is the variance of one average minus the covariance of both. A process
    whose autocovariance is a weighted sum of such terms has the same weighted sum of their Allan variances.

    Args:
        window: length of a window (...) [s].
        time_constant: (...) [s].
    """
    x = np.asarray(window, np.float64) / np.asarray(time_constant, np.float64)
    # The first terms cancel: the series of what is left, sum of (-1)^n (4 - 2^n) x^(n-2) / n! from n = 3.
    terms = range(3, 14)
    series = sum((-1) ** n * (4.0 - 2.0**n) / math.factorial(n) * x ** (n - 2) for n in terms)
    large = np.maximum(x, _SERIES_BELOW)
    closed = (2.0 * large - 3.0 + 4.0 * np.exp(-large) - np.exp(-2.0 * large)) / large**2
    return np.asarray(np.where(x < _SERIES_BELOW, series, closed))
