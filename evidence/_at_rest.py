"""Sensors of vehicles at rest, and the Allan deviation of what they say against a theory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy

from qrsim.core.noise import Draw, Drawn, Key, Stream
from qrsim.engine.settings import quick_jit

Floats = npt.NDArray[np.float64]


def _scanned(
    sensor: Any, inputs: dict[str, Any], begin: Stream, source: Stream, readings: int, fields: tuple[str, ...]
) -> Any:
    like = jnp.zeros((), jnp.float32)

    def drawn(stream: Stream, now: jax.Array, count: int) -> Drawn:
        return Drawn(tuple(Draw(stream, now, like).normal_rows(count)))

    state, _ = sensor.init(drawn(begin, jnp.uint32(0), sensor.first_normals), **inputs)

    def tick(state: Any, now: jax.Array) -> tuple[Any, Any]:
        state, reading = sensor.step(state, drawn(source, now, sensor.normals), **inputs)
        return state, tuple(getattr(reading, field).stack() for field in fields)

    return jax.lax.scan(tick, state, jnp.arange(1, readings + 1, dtype=jnp.uint32))[1]


_compiled = quick_jit(_scanned, static_argnames=("readings", "fields"))


def readings_at_rest(
    sensor: Any, name: str, inputs: dict[str, Any], fields: tuple[str, ...], readings: int, seed: int
) -> list[npt.NDArray[np.float32]]:
    """Return vectors (readings, chips, 3) of a sensor's readings, after the first one.

    Args:
        sensor: with numbers in float32.
        name: of the streams that it draws from.
        inputs: what it reads, arrays (chips,) that stay as they are.
        fields: names of the vectors.
        readings, seed: how many, and of the streams.
    """
    chips = jnp.shape(jax.tree.leaves(inputs)[0])[0]
    key, ids = Key.root(seed), jnp.arange(chips, dtype=jnp.uint32)
    streams = key.stream(f"{name}/start", ids), key.stream(name, ids)
    return [np.asarray(each) for each in _compiled(sensor, inputs, *streams, readings, fields)]


class Compared(NamedTuple):
    """Allan variances over windows (K,) [s], measured and expected.

    ``inside``: share of them in the band of the confidence; ``worst_ratio``: of the deviations, the larger over the
    smaller.
    """

    windows: Floats
    variance: Floats
    expected: Floats
    inside: float
    worst_ratio: float

    def row(self) -> dict[str, Any]:
        """Return it as a study has it."""
        return {
            "windows_s": self.windows.tolist(),
            "deviation": np.sqrt(self.variance).tolist(),
            "expected": np.sqrt(self.expected).tolist(),
            "inside": self.inside,
            "worst_ratio": self.worst_ratio,
        }


def compared(
    taken: npt.NDArray[np.float32],
    period: float,
    windows: int,
    expected_variance: Callable[[npt.NDArray[np.int64]], Floats],
    confidence: float,
) -> Compared:
    """Return the overlapping Allan variance by allantools, the mean over chips and axes, against a theory.

    Args:
        taken: readings (count, chips, 3).
        period: between them [s].
        windows: how many, up to a sixth of the whole.
        expected_variance: of windows of so many readings (K,).
        confidence: of the band about what is expected.
    """
    import allantools

    count = len(taken)
    series = taken.reshape(count, -1).T.astype(np.float64)
    lengths = np.unique(np.round(np.geomspace(1, count // 6, windows)).astype(np.int64))
    oracle = [
        allantools.oadev(one - one.mean(), rate=1.0 / period, data_type="freq", taus=lengths * period) for one in series
    ]
    seconds = oracle[0][0]
    lengths = np.round(seconds / period).astype(np.int64)
    variance = np.mean([deviation**2 for _, deviation, _, _ in oracle], axis=0)
    expected = expected_variance(lengths)
    # Degrees of freedom no larger than those of windows that do not overlap.
    freedom = len(series) * np.maximum(count / lengths - 1.0, 1.0)
    low, high = (scipy.stats.chi2.ppf(0.5 * (1.0 + side * confidence), freedom) / freedom for side in (-1, 1))
    ratio = variance / expected
    inside = float(np.mean((low <= ratio) & (ratio <= high)))
    return Compared(seconds, variance, expected, inside, float(np.exp(np.max(np.abs(np.log(np.sqrt(ratio)))))))
