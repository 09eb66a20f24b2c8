"""Errors of the fleets' estimators compared with their reported covariance, over many runs."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from qrsim.apps.check.outcomes import CONFIDENCE
from qrsim.core.arrays import NumpyArray
from qrsim.simulation.rollout import Rollout

# What is told, by the metric that it is.
ROWS = {
    "all errors": "anees",
    "position": "anees_position",
    "velocity": "anees_velocity",
    "attitude": "anees_attitude",
    "bias": "anees_bias",
}

# From this ratio of squared errors to the stated variance on, an explanation is printed.
MUCH = 2.0
EXPLAINED = """\
  Above 1 the errors exceed the reported ones: GNSS errors last for minutes, and the filter takes them for white
  noise. The flights above had these errors; the reported covariance is too small (docs/explanation/consistency.md)."""


@dataclass(frozen=True)
class Row:
    """Squared errors of an estimate divided by its reported covariance, per error; 1 if it is consistent.

    Errors of a flight last long, and vehicles of a run see the same satellites: so a run counts once, with its mean.

    Attributes:
        name: which errors.
        mean: over all runs.
        low, high: interval of the mean at CONFIDENCE (Student's t over the runs); NaN of a single run.
        runs: how many there are.
    """

    name: str
    mean: float
    low: float
    high: float
    runs: int

    @property
    def verdict(self) -> str:
        """Verdict on the errors against the reported covariance: too large, too small or consistent; "" without an
        interval."""
        if self.low > 1.0:
            return "errors exceed the reported ones"
        if self.high < 1.0:
            return "errors are below the reported ones"
        return "consistent" if self.low <= 1.0 <= self.high else ""

    def to_json(self) -> dict[str, object]:
        """Return the fields by name, for JSON, with None in place of NaN."""
        return {name: None if value != value else value for name, value in asdict(self).items()}


def consistency(flown: Rollout) -> list[Row]:
    """Return consistency statistics, a row for each group of errors with a reported covariance; [] without any."""
    found = []
    for name, metric in ROWS.items():
        values = np.asarray(flown[metric], np.float64)
        known = np.isfinite(values)
        flights = known.sum(axis=1)
        runs = (np.where(known, values, 0.0).sum(axis=1) / np.maximum(flights, 1))[flights > 0]
        if len(runs):
            found.append(_row(name, runs))
    return found


def _row(name: str, runs: NumpyArray) -> Row:
    """Return the mean and confidence interval of a statistic with one value per run; NaN bounds for a single run."""
    from scipy import stats

    mean, count = float(runs.mean()), len(runs)
    if count < 2:
        return Row(name, mean, float("nan"), float("nan"), count)
    half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1) * runs.std(ddof=1) / np.sqrt(count))
    return Row(name, mean, mean - half, mean + half, count)


def print_consistency(rows: list[Row]) -> None:
    """Print the table of consistency; nothing without rows."""
    if not rows:
        return
    print("\nsquared errors of the estimate divided by its reported covariance (ANEES; 1 if consistent)")
    for row in rows:
        interval = (
            "" if row.low != row.low else f"95 % interval {max(row.low, 0.0):.2f} to {row.high:.2f}, {row.verdict}"
        )
        print(f"  {row.name:<32} {row.mean:8.2f}      {interval}".rstrip())
    much = [row.name for row in rows if row.mean > MUCH and not row.low <= 1.0]
    if "position" in much:
        print(EXPLAINED)
    elif much:
        print("  Above 1 the errors are larger than the estimator reports (docs/explanation/consistency.md).")
