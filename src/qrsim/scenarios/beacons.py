"""Beacons of a scenario, to which sensors of type ``ranging`` measure ranges: schema, checks, what is built of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import Field

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.errors import did_you_mean
from qrsim.models.sensors.ranging import EVERY, IdealRanging, Ranging
from qrsim.scenarios.component_schema import Strict
from qrsim.scenarios.legs import Position

TYPES = ("ranging", "ideal_ranging")
# Beacons of a world, and partners of a sensor: each is a column of the log.
MOST_BEACONS, MOST_PARTNERS = 64, 64


class BeaconSpec(Strict):
    """A radio at a known place."""

    name: str = Field(description="name", min_length=1)
    position_ned: Position = Field(description="position of its antenna [m]: north, east, down")


def beacon_problems(scenario: Any) -> Iterator[str]:
    """Yield the errors in a scenario's ranging beacons and in the sensors that range to them."""
    names = [beacon.name for beacon in scenario.world.beacons]
    for name, count in Counter(names).items():
        if count > 1:
            yield f"world.beacons: {count} are called '{name}'; names must differ"
    everybody = sum(len(fleet.vehicles) for fleet in scenario.fleets.values())
    for fleet_name, fleet in scenario.fleets.items():
        for sensor_name, sensor in fleet.sensors.items():
            if sensor.type not in TYPES:
                continue
            path = f"fleets.{fleet_name}.sensors.{sensor_name}"
            asked = _asked(sensor, names)
            for name in asked:
                if name not in names:
                    there = f"no beacon is called '{name}'{did_you_mean(name, names)}"
                    yield f"{path}.beacons: {there if names else f'{there}; world.beacons has none'}"
            others = {"none": 0, "fleet": len(fleet.vehicles), "all": everybody}[sensor.vehicles]
            partners = len(asked) + max(others - 1, 0)
            if not partners:
                yield f"{path}: nothing to range to; give world.beacons, or vehicles: all with several vehicles"
            elif partners > MOST_PARTNERS:
                yield (
                    f"{path}: ranges to {partners} beacons and vehicles; allowed: {MOST_PARTNERS}; name fewer beacons, "
                    "or give vehicles: fleet or none"
                )


def with_beacons(sensor: object, scenario: Any) -> object:
    """Return a ranging sensor with the positions of its beacons filled in; other sensors unchanged."""
    if not isinstance(sensor, Ranging | IdealRanging):
        return sensor
    places = {beacon.name: beacon.position_ned for beacon in scenario.world.beacons}
    chosen = _asked(sensor, list(places))
    found = np.array([places[name] for name in chosen], np.float64)
    return replace(sensor, beacon_ned=Vec3(*found.T.copy()) if chosen else None)


def _asked(sensor: Ranging | IdealRanging, names: list[str]) -> list[str]:
    """Return the names of the beacons that a sensor ranges to; "every beacon" means all of ``names``."""
    return names if tuple(sensor.beacons) == (EVERY,) else list(sensor.beacons)
