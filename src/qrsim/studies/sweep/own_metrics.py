"""Metrics of a user's own in a study: what its class says of its numbers, and the class beside the built-in metrics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.scenarios.registry import made
from qrsim.studies.sweep.metrics import METRICS, Found, Metric
from qrsim.world.state import World

OVER: dict[str, Callable[..., NumpyArray]] = {
    "mean": np.nanmean,
    "max": np.nanmax,
    "min": np.nanmin,
    "sum": np.nansum,
    "rms": lambda values, axis: np.sqrt(np.nanmean(values * values, axis=axis)),
}
EXAMPLE = "numbers = {'speed_max_m_s': {'unit': 'm/s', 'doc': 'largest speed', 'over': 'max'}}"


def own_metrics(source: str) -> tuple[Any, dict[str, Metric]]:
    """Load a user's metrics object from FILE.py:CLASS or a registered name; return it, and name -> ``Metric``.

    Args:
        source: FILE.py:NAME, MODULE:NAME, or a registered name of kind ``metric``.

    Raises:
        UsageError: there is none, or its ``numbers`` do not say unit, doc and over of each.
    """
    found = made("metric", source)
    numbers = getattr(found, "numbers", None)
    if not isinstance(numbers, Mapping) or not numbers:
        raise UsageError(f"own_metrics: {source} does not declare its numbers; expected {EXAMPLE}")
    return found, {str(name): _metric(source, str(name), about) for name, about in numbers.items()}


def _metric(source: str, name: str, about: object) -> Metric:
    """Return a ``Metric`` from a user's description; raise UsageError for a wrong name, unit, doc or reduction."""
    where = f"own_metrics: {source}: numbers: {name}"
    if name in METRICS or not name.isidentifier():
        raise UsageError(f"{where}: the name is {'a built-in metric' if name in METRICS else 'no name'}; give another")
    if not isinstance(about, Mapping):
        raise UsageError(f"{where}: found {about!r:.60}; expected {EXAMPLE}")
    for key in about:
        if key not in ("unit", "doc", "over", "low_is_bad"):
            raise UsageError(f"{where}: no part is called '{key}'{did_you_mean(str(key), ['unit', 'doc', 'over'])}")
    for key in ("unit", "doc"):
        if not isinstance(about.get(key), str):
            raise UsageError(f"{where}: {key}: expected a text, as '1' for the unit of a count")
    over = about.get("over", "mean")
    if over not in OVER:
        raise UsageError(f"{where}: over: found {over!r:.40}; allowed: {', '.join(OVER)} over the vehicles")
    return Metric(about["unit"], about["doc"], _episode(source, name, OVER[over]), bool(about.get("low_is_bad", False)))


def _episode(source: str, name: str, reduce: Callable[..., NumpyArray]) -> Callable[[Found], NumpyArray]:
    """Return a function that reduces a user's metric (W, n) to W episodes, and leaves one of shape (W,) as it is."""

    def of(found: Found) -> NumpyArray:
        """Return the user's metric (W,) of W episodes; raises UsageError if it is missing or has another shape."""
        if name not in found:
            raise UsageError(f"own_metrics: {source}: finish does not return '{name}'; it returns {sorted(found)}")
        values = np.asarray(found[name], np.float64)
        if values.ndim not in (1, 2):
            raise UsageError(
                f"own_metrics: {source}: finish: '{name}' has shape {values.shape}; expected (W,) or (W, n)"
            )
        with np.errstate(all="ignore"):
            return values if values.ndim == 1 else reduce(np.where(np.isfinite(values), values, np.nan), axis=1)

    return of


class BothMetrics:
    """Two sets of metrics as one; where both have a name, it is the first one's.

    Args:
        first, second: with ``init``, ``update`` and ``finish``, as ``FlightMetrics``.
    """

    def __init__(self, first: Any, second: Any):
        self.first, self.second = first, second

    def init(self, world: Any, state: Any) -> Any:
        """Return the initial memories of the built-in and the user's metrics."""
        return self.first.init(world, state), self.second.init(world, state)

    def update(self, memory: Any, world: World, state: Any, tick: Any) -> Any:
        """Return the memories of the built-in and the user's metrics after a tick."""
        return self.first.update(memory[0], world, state, tick), self.second.update(memory[1], world, state, tick)

    def finish(self, memory: Any, world: World, state: Any) -> dict[str, Any]:
        """Return the metrics of both objects at the end of a flight, by name."""
        return {**self.second.finish(memory[1], world, state), **self.first.finish(memory[0], world, state)}
