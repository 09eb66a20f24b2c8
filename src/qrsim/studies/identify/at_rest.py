"""Noise of an inertial sensor from a log at rest: Allan variances, and the noise terms whose sum they are.

The overlapping Allan variance of each axis (IEEE Std 952-1997, C.1) is fitted by what the sensor ``imu`` computes:
white noise N^2/t, flicker noise as three Gauss-Markov processes of 5, 50 and 500 s (equation C.15 each), and the random
walk K^2 t/3. No term is negative. Weights are those of the number of independent windows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from qrsim.core.arrays import NumpyArray
from qrsim.errors import LogError
from qrsim.studies.flight_logs.inertial import Readings
from qrsim.studies.flight_logs.signals import Floats

TERMS = ("noise", "bias_instability", "random_walk")
UNITS = {"gyroscope": ("rad/s^0.5", "rad/s", "rad/s^1.5"), "accelerometer": ("m/s^1.5", "m/s^2", "m/s^2.5")}
# Correlation times [s] of the processes that make flicker noise, and the variance of each per B^2.
TIMES, SHARE = (5.0, 50.0, 500.0), math.log(10.0) / math.pi
# A log at rest has to be so long [s]; who stands still has in no second more than so many times its usual noise, and
# no axis of the gyroscope turns by more than this on average [rad/s].
SHORTEST_S, RESTLESS, TURNING = 60.0, 3.0, 0.2
# Shortest windows, in readings: below them filters of the chip show. Longest: so many fit into the log.
FIRST, FEWEST = 4, 6
RESAMPLES, SEED = 400, 0


@dataclass(frozen=True)
class Term:
    """A noise term: its value, its interval of 95 %, and whether the log shows it."""

    value: float
    low: float
    high: float

    @property
    def seen(self) -> bool:
        """Whether the 95 % interval of the noise term excludes zero."""
        return self.low > 0.0


@dataclass(frozen=True)
class Noise:
    """Noise of one kind of an inertial sensor.

    Attributes:
        windows: (K,) [s].
        variance: (K, 3) Allan variance of each axis.
        fitted: (K,) that of the terms.
        terms: by name.
        mean: (3,) of the readings.
    """

    windows: Floats
    variance: Floats
    fitted: Floats
    terms: Mapping[str, Term]
    mean: Floats


def allan_variance(values: Floats, lengths: NumpyArray) -> Floats:
    """Return the overlapping Allan variance (K, C) of readings (T, C) for windows of ``lengths`` readings (K,)."""
    summed = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - values.mean(axis=0), axis=0)])
    found = []
    for m in lengths:
        second = summed[2 * m :] - 2.0 * summed[m:-m] + summed[: -2 * m]
        found.append(0.5 * np.mean(np.square(second / m), axis=0))
    return np.array(found)


def shapes(windows: Floats) -> Floats:
    """Return the Allan variances (K, 3) that each of 3 noise terms of size 1 has over windows (K,) [s]."""
    flicker = np.zeros_like(windows)
    for time in TIMES:
        part = time / windows
        rest = 3.0 - 4.0 * np.exp(-1.0 / part) + np.exp(-2.0 / part)
        flicker += SHARE * 2.0 * part * (1.0 - 0.5 * part * rest)
    return np.stack([1.0 / windows, flicker, windows / 3.0], axis=1)


def noise_of(values: Floats, period: float) -> Noise:
    """Fit the noise terms of a sensor's readings (T, 3) at rest, one every ``period`` [s], to its Allan variance."""
    longest = len(values) // FEWEST
    lengths = np.unique(np.round(np.geomspace(FIRST, longest, 40)).astype(int))
    windows, variance = lengths * period, allan_variance(values, lengths)
    mean = variance.mean(axis=1)
    freedom = 3.0 * _freedom(len(values), lengths)
    basis, weight = shapes(windows), np.sqrt(freedom / 2.0)

    def fit(measured: Floats) -> Floats:
        """Return the squared noise terms that fit measured Allan variances, by non-negative least squares."""
        scale = weight / measured
        found, _ = scipy.optimize.nnls(basis * scale[:, None], measured * scale)
        return np.asarray(found)

    squares = fit(mean)
    # Windows of nearly one length see the same readings: they err together, by octaves.
    rng, octave = np.random.default_rng(SEED), np.floor(np.log2(lengths / lengths[0])).astype(int)
    drawn = []
    for _ in range(RESAMPLES):
        normal = rng.standard_normal(octave[-1] + 1)[octave]
        drawn.append(fit(basis @ squares * np.maximum(1.0 + normal * np.sqrt(2.0 / freedom), 0.05)))
    low, high = np.quantile(np.sqrt(drawn), [0.025, 0.975], axis=0)
    found = {name: _noise_term(*row) for name, *row in zip(TERMS, np.sqrt(squares), low, high, strict=True)}
    return Noise(windows, variance, basis @ squares, found, values.mean(axis=0))


def _freedom(count: int, lengths: NumpyArray) -> Floats:
    """Return the degrees of freedom (K,) of overlapping Allan variances of a random walk, which has the fewest.

    D. A. Howe, D. W. Allan and J. A. Barnes, Properties of signal sources and measurement methods (1981), table 4.
    """
    n, m = float(count), lengths.astype(float)
    squares = np.square(n - 1.0) - 3.0 * m * (n - 1.0) + 4.0 * np.square(m)
    return np.asarray((n - 2.0) / m * squares / np.square(n - 3.0))


def _noise_term(value: float, low: float, high: float) -> Term:
    """Return a noise term whose 95 % interval mirrors, by ratio, the range ``low`` to ``high`` of its estimates."""
    if low <= 0.0:
        return Term(float(value), 0.0, float(high))
    # What is as far from the truth by a factor as estimates are from it.
    return Term(float(value), float(value**2 / high), float(value**2 / low))


def at_rest(readings: Readings, source: str) -> tuple[Readings, tuple[float, float]]:
    """Return the longest part of a log in which the sensor rests, and its (begin, end) [s]; ``source`` is for messages.

    Raises:
        LogError: it does so for no minute, or a channel never changes.
    """
    for kind, values in readings.values.items():
        for axis, spread in zip("xyz", np.ptp(values, axis=0), strict=True):
            if spread == 0.0:
                raise LogError(f"{source}: {kind}_{axis} is constant: no noise can be seen in it")
    second = max(round(1.0 / readings.period), 2)
    count = min(len(values) for values in readings.values.values()) // second
    still = np.ones(count, bool)
    for kind, values in readings.values.items():
        parts = values[: count * second].reshape(count, second, 3)
        spread = parts.std(axis=1)
        means = parts.mean(axis=1)
        usual = np.quantile(spread, 0.1, axis=0) if count else np.zeros(3)
        still &= np.all(spread <= RESTLESS * usual, axis=1)
        if kind == "gyroscope":
            still &= np.all(np.abs(means) < TURNING, axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    parts_of_it = list(zip(edges[::2], edges[1::2], strict=True))
    first, last = max(parts_of_it, key=lambda part: part[1] - part[0], default=(0, 0))
    seconds = (last - first) * second * readings.period
    if seconds < SHORTEST_S:
        raise LogError(
            f"{source}: at rest for {seconds:.0f} s at most, of {count * second * readings.period:.0f} s; "
            f"its noise needs {SHORTEST_S:.0f} s, and its slow parts an hour and more"
        )
    kept = {kind: values[first * second : last * second] for kind, values in readings.values.items()}
    return Readings(readings.period, kept), (first * second * readings.period, last * second * readings.period)


def sensor_of(found: Mapping[str, Noise], preset: str) -> dict[str, object]:
    """Return scenario content of an imu with the fitted noise; terms that were not seen keep the preset's value."""
    numbers = {
        f"{kind}_{name}": float(f"{term.value:.4g}")
        for kind, noise in found.items()
        for name, term in noise.terms.items()
        if term.seen
    }
    return {"type": "imu", "preset": preset, **numbers}
