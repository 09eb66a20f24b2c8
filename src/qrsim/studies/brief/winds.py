"""The stage of the wind: the speed that an operation stands in each direction, all vehicles together."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qrsim.errors import RunError
from qrsim.files import Content
from qrsim.files.atomic import write_atomically
from qrsim.files.yaml_text import dump_yaml
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.wind_limits import gust_sigma, limits_of, mean_wind
from qrsim.studies.brief.boundary import SEEDS, Boundary, Point, Trial, explore
from qrsim.studies.brief.flights import Flights, bearing_deg, speed_20ft
from qrsim.studies.brief.judging import ORDER, Row, Verdict
from qrsim.studies.brief.operation import OperationSpec
from qrsim.studies.brief.studying import BATCH, Flyer
from qrsim.studies.sweep.results import Results

NAME, SCENARIO = "wind", "wind_scenario.yaml"
BEARINGS = tuple(45.0 * i for i in range(8))
# Speed at which vehicles without a known envelope begin [m/s], a wind below a limit by this much is a go [m/s], and
# standard deviations of gusts that count.
USUAL_HELD, BELOW, SIGMAS = 12.0, 2.0, 3.0
METRICS = ("stopped", "not_finished", "charge_end")
# Largest speed of a scenario's wind at 20 ft [m/s].
LARGEST = 50.0


@dataclass(frozen=True)
class Winds:
    """Winds that a brief flies.

    Attributes:
        scenario: the flights in a wind that is one number and a bearing.
        factor: from a speed at the forecast's height to that at 20 ft.
        held: speed that the vehicles hold, at the forecast's height [m/s].
        bearings: of all directions [deg]; the last is that of the forecast.
    """

    scenario: Scenario
    factor: float
    held: float
    bearings: tuple[float, ...]


def winds_of(operation: OperationSpec, flights: Flights, folder: Path) -> Winds:
    """Return the winds that a brief explores, after writing their scenario into its folder."""
    content = copy.deepcopy(flights.content)
    content["name"] = NAME
    factor, bearing = speed_20ft(flights.wind), bearing_deg(flights.wind)
    # A unit of speed here; each point gives its own.
    content["world"]["wind"] = {"type": "log_shear", "speed_20ft": factor, "wind_from_deg": bearing}
    low, high = operation.uncertain.initial_charge
    for fleet in content["fleets"].values():
        fleet["battery"]["initial_charge"] = 0.5 * (low + high)
    scenario = load_scenario(content, quiet=True)
    write_atomically(folder / SCENARIO, dump_yaml(content).encode())
    return Winds(scenario, factor, _held(scenario, factor), (*BEARINGS, bearing % 360.0))


def _held(scenario: Scenario, factor: float) -> float:
    """Return the largest wind speed [m/s], at the forecast's height, in which every vehicle can hold its position."""
    found = []
    for fleet in scenario.spec.fleets.values():
        limits = limits_of(fleet, scenario.spec)
        if limits is not None and not limits.too_heavy:
            lets = limits.own.airspeed if limits.lets is None else limits.lets.airspeed
            # The wind of the scenario is 1 m/s.
            found.append(float(np.min(np.minimum(limits.own.airspeed, lets) / np.maximum(limits.mean, 0.5))))
    return float(np.clip(min(found, default=USUAL_HELD), 3.0, 0.6 * LARGEST / factor))


def wind_study(name: str, first_seed: int, points: Sequence[Point], winds: Winds) -> Content:
    """Return the content of a study of a round of winds: a condition for each wind, with SEEDS runs."""
    conditions = {
        f"wind_{i}": {
            "world.wind.speed_20ft": min(point.speed * winds.factor, LARGEST),
            "world.wind.wind_from_deg": (winds.bearings[point.direction] + 180.0) % 360.0 - 180.0,
        }
        for i, point in enumerate(points)
    }
    return {
        "name": name,
        "description": "A round of points of the boundary of the wind.",
        "scenario": SCENARIO,
        "vary": {"wind": {"conditions": conditions}},
        "seeds": SEEDS,
        "first_seed": first_seed,
        "metrics": list(METRICS),
        "batch": BATCH,
    }


def boundary_of(
    winds: Winds, reserve: float | None, seed: int, folder: Path, flyer: Flyer | None, polar: bool
) -> tuple[Boundary, bool]:
    """Explore the wind boundary in the forecast's direction (``polar``: then in all); return it, and whether complete.

    Args:
        winds: of the brief.
        reserve: charge that a run has left at its end if it succeeds; None: any.
        seed: of the first run; each round has new seeds.
        folder: of the brief.
        flyer: flies what is missing; None: only what is in the folder counts.
        polar: whether the other directions follow.
    """

    def flying(part: str) -> Callable[[int, list[Point]], tuple[list[Trial], bool]]:
        """Return a function that flies a round of winds: from number and winds to (trials, whether complete)."""

        def fly(number: int, points: list[Point]) -> tuple[list[Trial], bool]:
            """Fly the winds of round ``number``; return their trials, and whether all are complete."""
            name = f"{part}_{number}"
            complete = flyer is not None and flyer.fly(wind_study(name, seed + SEEDS * number, points, winds))
            found = _trials(folder / f"{name}.zarr", points, reserve)
            return found, complete or (len(found) == len(points) and all(each.runs == SEEDS for each in found))

        return fly

    last = len(winds.bearings) - 1
    found, complete = explore(winds.bearings, [last], winds.held, flying(f"{NAME}_forecast"))
    if polar and complete:
        return explore(winds.bearings, range(last), winds.held, flying(NAME), found.trials)
    return found, complete


def _trials(path: Path, points: Sequence[Point], reserve: float | None) -> list[Trial]:
    """Return how many runs at each wind succeeded, with ``reserve`` charge left, from a store; [] before any run."""
    try:
        results = Results(path) if path.exists() else None
    except RunError:  # nothing has been flown yet
        results = None
    if results is None:
        return []
    good = (results.metric("stopped") == 0.0) & (results.metric("not_finished") == 0.0)
    if reserve is not None:
        good &= results.metric("charge_end") >= reserve
    found = []
    for number, point in enumerate(points):
        here = results.points == number
        if here.any():
            found.append(Trial(point, int(here.sum()), int(good[here].sum())))
    return found


def _gusty(spec: ScenarioSpec, height: float) -> float:
    """Return the mean wind plus SIGMAS standard deviations of its gusts at a height [m], in m/s."""
    heights = np.array([height])
    return float((mean_wind(spec, heights) + SIGMAS * gust_sigma(spec, heights))[0])


def _at_speed(winds: Winds, speed: float, height: float) -> float:
    """Return the wind with gusts [m/s] at a height, for a mean speed [m/s] at the forecast's height."""
    spec = winds.scenario.spec
    wind = spec.world.wind.model_copy(update={"speed_20ft": winds.factor * speed})
    return _gusty(spec.model_copy(update={"world": spec.world.model_copy(update={"wind": wind})}), height)


def wind_row(flights: Flights, limit: float | None, winds: Winds | None, boundary: Boundary | None) -> Row | None:
    """Return the row with the verdict on the wind with gusts at the highest leg; None without any limit.

    Both sides have three standard deviations of gusts: the wind of the forecast, and the boundary in its direction.

    Args:
        flights: of the brief.
        limit: the maker's, gusts included [m/s], or None.
        winds: of the stage of the wind, or None.
        boundary: of that stage, or None.
    """
    spec = flights.scenario.spec
    places = [place for fleet in spec.fleets.values() for each in fleet.vehicles for place in each.places_ned.values()]
    height = max([-place[2] for place in places] or [0.0])
    wind = max(_gusty(scenario.spec, height) for scenario in flights.at_starts)
    told = f"wind: {wind:.1f} m/s with gusts of 3 sigma at {height:.0f} m"
    found: list[tuple[Verdict, float]] = []
    if limit is not None:
        found.append((_against(wind, limit, limit), limit))
        told += f"; the maker's limit is {limit:g} m/s"
    if winds is not None and boundary is not None and len(winds.bearings) - 1 in boundary.flown:
        low, middle, high = (
            _at_speed(winds, float(each[-1]), height) for each in (boundary.low, boundary.speed, boundary.high)
        )
        found.append((_against(wind, low, high), low))
        told += (
            f"; from {winds.bearings[-1]:.0f} deg, 90 % of the runs succeed up to {middle:.1f} m/s with gusts "
            f"(at least {low:.1f})"
        )
    if not found:
        return None
    verdict, nearest = max(found, key=lambda each: (ORDER.index(each[0]), -each[1]))
    return Row("wind", verdict, wind, None, nearest, "m/s", told)


def _against(wind: float, low: float, high: float) -> Verdict:
    """Return the verdict on a wind [m/s] with a limit known to be between ``low`` and ``high`` [m/s]."""
    return "go" if wind < low - BELOW else "no-go" if wind > high else "marginal"
