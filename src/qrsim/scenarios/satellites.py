"""The satellites of a scenario: its receivers of type gnss, and the sky they need."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.errors import UsageError
from qrsim.models.gnss.constellations import check_systems
from qrsim.models.gnss.sight import LETTERS, MASK_LOWEST, system_numbers
from qrsim.models.gnss.slots import SlottedSky, slots_needed
from qrsim.models.site import Site
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.schema import ScenarioSpec

RECEIVER = "gnss"


def receivers(scenario: ScenarioSpec) -> dict[str, Any]:
    """Return the receivers of type gnss by their paths."""
    return {
        f"fleets.{name}.sensors.{sensor_name}": sensor
        for name, fleet in scenario.fleets.items()
        for sensor_name, sensor in fleet.sensors.items()
        if sensor.type == RECEIVER
    }


def needs_slots(scenario: ScenarioSpec, errors: Any) -> bool:
    """Return whether the sky of a scenario gives satellites in view slots."""
    return bool(receivers(scenario)) or bool(errors.needs_sight)


def slotted_sky(scenario: ScenarioSpec, ephemeris: Any, orbits: Any, errors: Any, site: Site, start: float) -> Any:
    """Build the sky of receivers of type gnss."""
    masks = [sensor.elevation_mask_rad for sensor in receivers(scenario).values()]
    lowest = math.sin(min(masks, default=MASK_LOWEST))
    return SlottedSky(
        orbits,
        errors,
        ephemeris.satellite_ids,
        system_numbers(ephemeris.system_of).astype(np.int32),
        scenario.world.sky.period,
        scenario.time_step,
        slots_needed(ephemeris, site, start, scenario.duration, lowest),
        lowest,
        each_epoch=any(
            sensor.type != RECEIVER and "sky" in known.SENSORS[sensor.type].reads  # type: ignore[attr-defined]
            for fleet in scenario.fleets.values()
            for sensor in fleet.sensors.values()
        ),
    )


def satellite_problems(scenario: ScenarioSpec, ephemeris: Any) -> Iterator[str]:
    """Yield why receivers of type gnss could not work under these orbits."""
    there = set(ephemeris.system_of)
    for path, sensor in receivers(scenario).items():
        try:
            check_systems(sensor.systems, f"{path}.systems")
        except UsageError as error:
            yield str(error)
            continue
        if not there & set(sensor.systems):
            has = ", ".join(letter for letter in LETTERS if letter in there)
            yield f"{path}.systems: '{sensor.systems}', but world.sky.orbits has satellites of {has} only"
    if vars(scenario.world.sky.errors).get("common") == "per_vehicle":
        for name, fleet in scenario.fleets.items():
            for sensor_name, sensor in fleet.sensors.items():
                if sensor.type == "gnss_receiver":
                    yield (
                        f"fleets.{name}.sensors.{sensor_name}: 'gnss_receiver' has no errors of its own, which "
                        "world.sky.errors.common asks for; use a sensor of type gnss, or common: shared"
                    )
