"""Failures of a flight: their frequency over many seeds, and the worst moments."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.models.scene.area import REASONS
from qrsim.simulation.rollout import Rollout

CONFIDENCE = 0.95
# Outcomes by the kinds of reason for which a vehicle stops; a lost fix is no reason to stop.
KINDS = {
    "leaves the area": "out_of_area",
    "collides": "collision",
    "hits the ground": "hit_ground",
    "crashes": "crashed",
    "runs out of battery": "battery_empty",
    "asks the battery for too much power": "brown_out",
    "breaks a state limit": "state_limit",
    "is not finite": "not_finite",
}
LOST = "loses GNSS"
UNFINISHED = "is still on its mission at the end"
FAILSAFE = "is taken over by a failsafe"
# Where breaches end no flight; the moment is that of the farthest place outside.
BREACHES = "is outside the zones"
ANY = "any of these"
# Reported even if nothing went wrong: (metric, whether its smallest value is the worst, unit). A metric without a time
# and position is reported for the end of the flight. Those from
# 'nearest to the ground' on are of scenarios with missions.
MARGINS = {
    "nearest to the edge of the area": ("fence_distance_min", True, "m"),
    "nearest to another vehicle": ("separation_min", True, "m"),
    "farthest from its leg": ("tracking_error_max", False, "m"),
    "strongest wind": ("wind_max", False, "m/s"),
    "least charge left": ("charge_min", True, "1"),
    "shortest battery endurance": ("endurance", True, "s"),
    "nearest to the ground between take-off and landing": ("ground_min", True, "m"),
    "nearest to an obstacle in flight": ("obstacle_min", True, "m"),
    "nearest to the fence's sides in flight": ("fence_horizontal_min", True, "m"),
    "nearest to its ceiling in flight": ("ceiling_min", True, "m"),
    "least charge at the end of a mission": ("charge_end", True, "1"),
    "longest mission": ("finished", False, "s"),
}


@dataclass(frozen=True)
class Moment:
    """A moment of one run.

    Attributes:
        seed: of the run.
        vehicle: name.
        time_s: simulated time.
        position_ned: true position [m].
        value: of the quantity concerned, None where there is none.
    """

    seed: int
    vehicle: str
    time_s: float
    position_ned: tuple[float, float, float]
    value: float | None = None


@dataclass(frozen=True)
class Outcome:
    """Frequency of one kind of failure.

    Attributes:
        name: what.
        runs: in how many runs it happened to any vehicle.
        fraction, low, high: of the runs, and the exact (Clopper-Pearson) interval at CONFIDENCE.
        seeds: of these runs, the earliest first.
        worst: the earliest moment of the run in which it came first; None where it never happened.
    """

    name: str
    runs: int
    fraction: float
    low: float
    high: float
    seeds: tuple[int, ...]
    worst: Moment | None

    def to_json(self) -> dict[str, object]:
        """Return the fields by name, for JSON."""
        return asdict(self)


def outcomes(flown: Rollout) -> list[Outcome]:
    """Count the runs with each kind of failure (crash, area left, and so on); the last entry counts runs with any of
    them."""
    kinds = np.array([kind for kind, _ in REASONS])[flown["reason"]]
    stopped, places = flown["stopped_at_s"], flown["position_ned"]
    times = {name: np.where(kinds == kind, stopped, np.nan) for name, kind in KINDS.items()}
    found = [_outcome(flown, name, when, places) for name, when in times.items()]
    lost = flown["fix_lost_at_s"]
    found.append(_outcome(flown, LOST, lost, flown["fix_lost_position_ned"]))
    first = np.fmin(stopped, lost)
    where = np.where((first == stopped)[..., None], places, flown["fix_lost_position_ned"])
    end = np.where(flown["unfinished"] > 0.0, flown["flown_s"], np.nan)
    found.append(_outcome(flown, UNFINISHED, end, places))
    any_first = np.fmin(first, end)
    taken = flown["failsafe_at_s"]
    if np.isfinite(taken).any():
        there = flown["failsafe_position_ned"]
        found.append(_outcome(flown, FAILSAFE, taken, there))
        places = np.where((taken < end)[..., None] | np.isnan(end)[..., None], there, places)
        any_first = np.fmin(any_first, taken)
    where = np.where((first == any_first)[..., None], where, places)
    if "breaches" in flown.metrics:
        outside = np.where(flown["breaches"] > 0, flown["fence_distance_min_at_s"], np.nan)
        there = flown["fence_distance_min_position_ned"]
        found.append(_outcome(flown, BREACHES, outside, there))
        any_first = np.fmin(any_first, outside)
        where = np.where((outside == any_first)[..., None], there, where)
    return [*found, _outcome(flown, ANY, any_first, where)]


def _outcome(flown: Rollout, name: str, times: NumpyArray, places: NumpyArray) -> Outcome:
    """Return an outcome from the times (W, n) [s] at which it happened, NaN where not, and the places (W, n, 3) NED
    [m]."""
    from scipy.stats import binomtest

    earliest = np.nanmin(np.where(np.isnan(times), np.inf, times), axis=1)
    happened = np.flatnonzero(np.isfinite(earliest))
    runs, total = len(happened), len(times)
    interval = binomtest(runs, total).proportion_ci(CONFIDENCE, method="exact")
    order = happened[np.argsort(earliest[happened], kind="stable")]
    worst = None
    if runs:
        world = int(order[0])
        worst = _moment(flown, world, int(np.nanargmin(times[world])), times, places)
    seeds = tuple(int(flown.seeds[world]) for world in order)
    return Outcome(name, runs, runs / total, float(interval.low), float(interval.high), seeds, worst)


def _moment(
    flown: Rollout, world: int, vehicle: int, times: NumpyArray, places: NumpyArray, value: float | None = None
) -> Moment:
    """Return the time, place and seed at which an outcome happened to a vehicle of world number ``world``; ``value``:
    of a margin."""
    north, east, down = (float(x) for x in places[world, vehicle])
    return Moment(
        int(flown.seeds[world]), flown.vehicles[vehicle], float(times[world, vehicle]), (north, east, down), value
    )


def margins(flown: Rollout) -> dict[str, tuple[Moment, str]]:
    """Return name -> (worst moment over all runs, unit) for each of MARGINS, except those that never occurred."""
    found = {}
    for name, (metric, smallest, unit) in MARGINS.items():
        key = metric if unit == "1" else f"{metric}_{unit.replace('/', '_')}"
        if key not in flown.metrics:
            continue
        values = flown[key]
        seen = np.isfinite(values)
        if not seen.any():
            continue
        ranked = np.where(seen, values if smallest else -values, np.inf)
        world, vehicle = np.unravel_index(int(np.argmin(ranked)), ranked.shape)
        names = f"{metric}_at_s", f"{metric}_position_ned"
        own = names[0] in flown.metrics
        times, places = flown[names[0] if own else "flown_s"], flown[names[1] if own else "position_ned"]
        found[name] = (_moment(flown, int(world), int(vehicle), times, places, float(values[world, vehicle])), unit)
    return found
