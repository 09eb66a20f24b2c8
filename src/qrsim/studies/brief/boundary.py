"""The boundary of the wind: the speed up to which 90 % of the runs succeed, in each direction, by adaptive points.

Success is logistic in the speed, with a steepness that all directions share. The posterior of both is computed on a
grid with flat priors (of the logarithm of the steepness), so that it exists where the runs separate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.files import Content

# Share of the runs that succeed on the boundary, and one-sided confidence of each end of its interval.
SHARE, CONFIDENCE = 0.9, 0.95
# Speeds of the first look, in parts of the speed that the vehicle holds; largest part that is ever flown.
FIRST, BEYOND = (0.25, 0.5, 0.75, 1.0), 1.5
# Seeds of each point, half-width at which a direction is done [m/s], and most rounds.
SEEDS, NARROW_M_S, ROUNDS = 8, 1.0, 12
# Grids: of the boundary, and of the steepness [s/m].
CELLS, STEEPNESS = 300, np.geomspace(0.2, 20.0, 24)
# Quantiles of the boundary at which the next points are.
NEXT = (0.4, 0.75)


class Point(NamedTuple):
    """A wind to fly.

    Attributes:
        direction: number of the direction.
        speed: mean speed [m/s].
    """

    direction: int
    speed: float


class Trial(NamedTuple):
    """Runs at a point, and how many of them succeeded."""

    point: Point
    runs: int
    good: int


@dataclass(frozen=True)
class Boundary:
    """The boundary in each direction.

    Attributes:
        bearings: (D,) that the wind comes from [deg].
        speed: (D,) mean speed up to which SHARE of the runs succeed [m/s].
        low, high: (D,) one-sided bounds of it at CONFIDENCE each.
        top: largest speed of the grid [m/s]; an upper bound there is none.
        trials: what it was computed from.
    """

    bearings: tuple[float, ...]
    speed: NumpyArray
    low: NumpyArray
    high: NumpyArray
    top: float
    trials: tuple[Trial, ...]

    @property
    def runs(self) -> int:
        """Number of runs flown for the boundary."""
        return sum(trial.runs for trial in self.trials)

    @property
    def flown(self) -> list[int]:
        """Indices of the wind directions that have runs."""
        return sorted({trial.point.direction for trial in self.trials})

    @property
    def wide(self) -> list[int]:
        """Indices of the wind directions with runs for which the speed's interval is still too wide."""
        return [i for i in self.flown if self.high[i] - self.low[i] > 2.0 * NARROW_M_S]

    def to_json(self) -> Content:
        """Return the boundary's speeds by direction as a dict for JSON; an upper bound at the grid's end is None."""
        # With a flat posterior, 95 % are below 0.95 of the grid.
        ends = [None if high > 0.9 * self.top else float(high) for high in self.high]
        return {
            "share": SHARE,
            "runs": self.runs,
            "directions": [
                {
                    "from_deg": self.bearings[i],
                    "speed": float(self.speed[i]),
                    "low": float(self.low[i]),
                    "high": ends[i],
                }
                for i in self.flown
            ],
        }

    def next_points(self) -> list[Point]:
        """Return the winds to fly next: two speeds in each direction that still has a too wide interval."""
        weights, speeds = _posterior(self.trials, len(self.bearings), self.top)
        return [
            Point(i, round(speed, 2))
            for i in self.wide
            for speed in _quantiles(weights[i], speeds, NEXT)
            if speed > 0.0
        ]


def first_points(directions: Sequence[int], held: float) -> list[Point]:
    """Return the first winds to fly in each direction: FIRST fractions of ``held`` [m/s], which vehicles can hold."""
    return [Point(i, round(part * held, 2)) for i in directions for part in FIRST]


def fit(bearings: Sequence[float], trials: Sequence[Trial], held: float) -> Boundary:
    """Fit the boundary, the wind speed up to which enough runs succeed; no trials in a direction: the whole grid.

    Args:
        bearings: (D,) of the directions [deg].
        trials: runs so far.
        held: speed that the vehicle holds [m/s].
    """
    top = BEYOND * held
    weights, speeds = _posterior(trials, len(bearings), top)
    shares = (1.0 - CONFIDENCE, 0.5, CONFIDENCE)
    low, middle, high = np.array([_quantiles(each, speeds, shares) for each in weights]).T
    return Boundary(tuple(bearings), middle, low, high, top, tuple(trials))


def explore(
    bearings: Sequence[float],
    directions: Sequence[int],
    held: float,
    fly: Callable[[int, list[Point]], tuple[list[Trial], bool]],
    known: Sequence[Trial] = (),
) -> tuple[Boundary, bool]:
    """Call ``fly`` with rounds of winds until all intervals are narrow or ROUNDS are over; return (boundary, complete).

    Args:
        bearings: (D,) of all directions [deg].
        directions: numbers of those to fly.
        held: speed that the vehicle holds [m/s].
        fly: takes the number of a round and its points, returns the trials, and whether all of them were flown.
        known: trials of before.
    """
    trials = list(known)
    points = first_points(directions, held)
    for number in range(ROUNDS):
        found, complete = fly(number, points)
        trials += found
        if not complete:
            return fit(bearings, trials, held), False
        points = fit(bearings, trials, held).next_points()
        if not points:
            break
    return fit(bearings, trials, held), True


def _posterior(trials: Sequence[Trial], directions: int, top: float) -> tuple[NumpyArray, NumpyArray]:
    """Return the posterior (D, C) of the boundary's speed in D directions, and the grid of speeds (C,) [m/s]."""
    speeds = (np.arange(CELLS) + 0.5) * top / CELLS
    scores = np.zeros((directions, len(STEEPNESS), CELLS))
    for (direction, speed), runs, good in trials:
        # Log odds of a failure.
        odds = STEEPNESS[:, None] * (speed - speeds) - math.log(SHARE / (1.0 - SHARE))
        scores[direction] -= good * np.logaddexp(0.0, odds) + (runs - good) * np.logaddexp(0.0, -odds)
    peaks = scores.max(axis=(1, 2), keepdims=True)
    likely = np.exp(scores - peaks)
    # What each direction says about the steepness, in the logarithm.
    says = np.log(np.maximum(likely.sum(axis=2), 1e-300))
    others = says.sum(axis=0) - says
    weights = np.einsum("dsc,ds->dc", likely, np.exp(others - others.max(axis=1, keepdims=True)))
    return weights / weights.sum(axis=1, keepdims=True), speeds


def _quantiles(weights: NumpyArray, speeds: NumpyArray, shares: Sequence[float]) -> list[float]:
    """Return the wind speeds [m/s] below which the given shares of a posterior's weights lie."""
    step = float(speeds[1] - speeds[0])
    ends = np.concatenate([[0.0], speeds + 0.5 * step])
    return [float(each) for each in np.interp(shares, np.concatenate([[0.0], np.cumsum(weights)]), ends)]
