"""The example with several vehicles: Pelicans between waypoints of their own, over the same landmarks.

The errors of their receivers are those of one sky, which they share, or each vehicle has a sky of its own: then nothing
is common to them. In a fleet vehicle 0 has the waypoints, ranges and noise of the same seed's flight alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.slam import example
from qrsim.studies.slam.between import BETWEEN_STD, Between, measure_between
from qrsim.studies.slam.flight import Flight
from qrsim.studies.slam.ranging import Ranging
from qrsim.world.state import World

# Where the lowest one flies at 16 m and the highest one still has landmarks in range.
MOST_VEHICLES = 9
# Seeds of the worlds of vehicles that are flown each under a sky of its own are so far apart.
NEXT_WORLD = 2**40


def check_vehicles(vehicles: int) -> None:
    """Raise UsageError for more vehicles than the example's area has room for."""
    if not 1 <= vehicles <= MOST_VEHICLES:
        raise UsageError(f"vehicles: {vehicles}; expected a number from 1 to {MOST_VEHICLES}")


def team_world(vehicles: int, gnss: str | None = None) -> World:
    """Return the example's world with N vehicles under one sky; ``gnss`` is a receiver preset.

    They fly on levels a metre apart and take no notice of each other: none of them collides.

    Args:
        vehicles: N.
        gnss: as for ``qrsim.studies.slam.example.base_world``.

    Raises:
        UsageError: too many vehicles, or none.
    """
    check_vehicles(vehicles)
    scenario: Content = {"name": example.SCENARIO, "extends": example.SCENARIO, "world": {}, "fleets": {}}
    if gnss is not None:
        scenario = example.with_receiver(gnss)
    scenario["world"]["collision_distance"] = 0.0
    place = [0.0, 0.0, -example.HEIGHT]
    scenario["fleets"].setdefault("pelicans", {})["vehicles"] = [
        {"position_ned": place, "waypoints_ned": [place]} for _ in range(vehicles)
    ]
    return load_scenario(scenario).world("float32")


def shared_flights(
    seeds: Sequence[int],
    vehicles: int,
    duration: float = example.DURATION,
    state_period: float = example.STATE_PERIOD,
    gnss: str | None = None,
) -> list[list[Flight]]:
    """Fly N vehicles of each seed in one world under a common sky; return N flights for each seed."""
    base = team_world(vehicles, gnss)
    worlds = [example.world_of(base, seed, range(vehicles)) for seed in seeds]
    return example.flown_together("shared", worlds, seeds, duration, state_period)


def own_flights(
    seeds: Sequence[int],
    vehicles: int,
    duration: float = example.DURATION,
    state_period: float = example.STATE_PERIOD,
    gnss: str | None = None,
) -> list[list[Flight]]:
    """Fly N vehicles of each seed, each in a world with a sky of its own; return N flights for each seed."""
    check_vehicles(vehicles)
    base = example.base_world(gnss=gnss)
    worlds = [example.world_of(base, seed, (i,)) for seed in seeds for i in range(vehicles)]
    flown = example.flown_alone("own", worlds, _world_seeds(seeds, vehicles), duration, state_period)
    return [flown[i : i + vehicles] for i in range(0, len(flown), vehicles)]


def white_flights(
    seeds: Sequence[int],
    coloured: Sequence[Sequence[Flight]],
    duration: float = example.DURATION,
    state_period: float = example.STATE_PERIOD,
) -> list[list[Flight]]:
    """Fly the vehicles of each seed with white GNSS errors, equal in size to those of their coloured flights."""
    vehicles, base = len(coloured[0]), example.base_world()
    worlds = [
        example.with_correlated(
            example.world_of(base, seed, (i,)), np.sqrt(np.mean(np.square(flight.fix_error), axis=0)), example.WHITE
        )
        for seed, flights in zip(seeds, coloured, strict=True)
        for i, flight in enumerate(flights)
    ]
    flown = example.flown_alone("white", worlds, _world_seeds(seeds, vehicles), duration, state_period)
    return [flown[i : i + vehicles] for i in range(0, len(flown), vehicles)]


def _world_seeds(seeds: Sequence[int], vehicles: int) -> list[int]:
    """Return the seeds of each vehicle's separate world; vehicle 0 gets the given seed."""
    return [seed + i * NEXT_WORLD for seed in seeds for i in range(vehicles)]


def rangings_of(flights: Sequence[Flight], seed: int) -> list[Ranging]:
    """Simulate the ranges of N flights to the landmarks of their seed; return a ``Ranging`` for each."""
    return [example.ranging_of(flight, seed, vehicle=i) for i, flight in enumerate(flights)]


def between_of(flights: Sequence[Flight], seed: int, std: float = BETWEEN_STD) -> Between:
    """Simulate ranges between the vehicles of N flights, with noise and losses of the sensor ``ranging``."""
    return measure_between(np.stack([flight.truth[:, :3] for flight in flights]), seed, std)
