"""The satellites of a scenario: its receivers of type gnss, and the sky they need."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.core.tree import record_of, replace
from qrsim.errors import UsageError, did_you_mean, warn_user
from qrsim.models.gnss.base_station import BaseStation
from qrsim.models.gnss.constellations import check_systems
from qrsim.models.gnss.contracts import RangeErrors
from qrsim.models.gnss.orbits import Ephemeris, Orbits
from qrsim.models.gnss.sensor import Gnss
from qrsim.models.gnss.sight import LETTERS, MASK_LOWEST, system_numbers
from qrsim.models.gnss.slots import SlottedSky, slots_needed
from qrsim.models.gnss.sp3 import Sp3Ephemeris
from qrsim.models.site import Site
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.faults import vehicle_names
from qrsim.scenarios.interference import interference, interference_problems, spoofed
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec

RECEIVER = "gnss"
BASED = ("dgps", "rtk")
# How far from a base its corrections are meant for [m].
FARTHEST_BASE = 50e3


def receivers(scenario: ScenarioSpec) -> dict[str, Any]:
    """Return scenario path -> specification of each receiver of type gnss."""
    return {
        f"fleets.{name}.sensors.{sensor_name}": sensor
        for name, fleet in scenario.fleets.items()
        for sensor_name, sensor in fleet.sensors.items()
        if sensor.type == RECEIVER
    }


def needs_slots(scenario: ScenarioSpec, errors: RangeErrors) -> bool:
    """Return whether the scenario's sky stores satellites in view in a fixed number of slots."""
    return bool(receivers(scenario)) or bool(errors.needs_sight)


def for_receivers(scenario: ScenarioSpec, ephemeris: object) -> Any:
    """Return an orbits file limited to the satellite systems that receivers use, if it does not name them itself.

    Raises:
        UsageError: the file cannot be read.
    """
    if not isinstance(ephemeris, Sp3Ephemeris) or ephemeris.systems is not None:
        return ephemeris
    asked = {letter for sensor in receivers(scenario).values() for letter in sensor.systems}
    if asked and _sky_has_other_readers(scenario):
        asked.add("G")
    systems = "".join(letter for letter in LETTERS if letter in asked and not ephemeris.lacking(letter))
    found = replace(ephemeris, systems=systems or None)
    # Read once.
    vars(found)["data"] = ephemeris.data
    return found


def warn_of_systems(scenario: ScenarioSpec, ephemeris: object) -> None:
    """Warn of receivers that use satellite systems which the file of orbits lacks."""
    if not isinstance(ephemeris, Sp3Ephemeris):
        return
    for path, sensor in receivers(scenario).items():
        lacking = ephemeris.lacking(sensor.systems)
        if lacking:
            warn_user(
                f"{path}.systems: '{sensor.systems}', but {ephemeris.file} has no satellite of "
                f"'{lacking}'; it has {ephemeris.content}"
            )


def _sky_has_other_readers(scenario: ScenarioSpec) -> bool:
    """Return whether any sensor other than a receiver of type gnss reads the sky."""
    return any(
        sensor.type != RECEIVER and "sky" in known.SENSORS[sensor.type].reads
        for fleet in scenario.fleets.values()
        for sensor in fleet.sensors.values()
    )


def slotted_sky(
    scenario: ScenarioSpec, ephemeris: Ephemeris, orbits: Orbits, errors: RangeErrors, site: Site, start: float
) -> SlottedSky:
    """Build the sky for receivers of type gnss, with satellites in view in slots, from ``start`` [GPS s] on."""
    masks = [sensor.elevation_mask_rad for sensor in receivers(scenario).values()]
    lowest = math.sin(min(masks, default=MASK_LOWEST))
    return record_of(
        SlottedSky,
        orbits,
        errors,
        ephemeris.satellite_ids,
        system_numbers(ephemeris.system_of).astype(np.int32),
        scenario.world.sky.period,
        scenario.time_step,
        slots_needed(ephemeris, site, start, scenario.duration, lowest),
        lowest,
        each_epoch=_sky_has_other_readers(scenario),
        base=base_station(scenario),
        interference=interference(scenario, ephemeris) if receivers(scenario) else None,
    )


def base_station(scenario: ScenarioSpec) -> BaseStation | None:
    """Build the GNSS base station if any receiver uses its corrections; else None."""
    spec = scenario.world.base_station
    if spec is None or not any(
        _takes_base(sensor) and not sensor.moving_base for sensor in receivers(scenario).values()
    ):
        return None
    names = [field.name for field in dataclasses.fields(BaseStation)]
    values = {name: getattr(spec, name) for name in names}
    lists = {name: np.array(value, np.float64) for name, value in values.items() if isinstance(value, list)}
    return BaseStation(**{**values, **lists})


def of_vehicles(sensor: object, fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> object:
    """Return a GNSS receiver with its moving-base and spoofed vehicles marked; other sensors unchanged."""
    if not isinstance(sensor, Gnss):
        return sensor
    names = vehicle_names(fleet_name, fleet)
    base = np.array([name == sensor.moving_base for name in names]) if sensor.moving_base else None
    return replace(sensor, base_vehicle=base, spoofed=spoofed(scenario, names))


def _takes_base(sensor: Any) -> bool:
    """Return whether a receiver uses the corrections of a base station."""
    return sensor.corrections in BASED


def correction_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error for each receiver that cannot get the corrections that it is set to use."""
    base = scenario.world.base_station
    own = vars(scenario.world.sky.errors).get("common") == "per_vehicle"
    for fleet_name, fleet in scenario.fleets.items():
        for sensor_name, sensor in fleet.sensors.items():
            if sensor.type != RECEIVER or sensor.corrections == "none":
                continue
            path = f"fleets.{fleet_name}.sensors.{sensor_name}"
            if own:
                yield (
                    f"{path}.corrections: '{sensor.corrections}' takes away what receivers have in common, which "
                    "world.sky.errors.common: per_vehicle leaves them nothing of; use common: shared"
                )
            if _takes_base(sensor) and sensor.moving_base:
                names = vehicle_names(fleet_name, fleet)
                if sensor.moving_base not in names:
                    hint = did_you_mean(sensor.moving_base, names)
                    yield f"{path}.moving_base: no vehicle of the fleet is called '{sensor.moving_base}'{hint}"
            elif _takes_base(sensor) and base is None:
                yield (
                    f"{path}.corrections: '{sensor.corrections}' needs a base; "
                    "give world.base_station, such as {position_ned: [0, 0, -2]}, or moving_base"
                )
    if base is not None:
        yield from _base_problems(base, scenario.duration)


def _base_problems(base: Any, duration: float) -> Iterator[str]:
    """Yield the errors of a GNSS base station; ``duration`` is that of the run [s]."""
    away = math.hypot(*base.position_ned)
    if away > FARTHEST_BASE:
        yield (
            f"world.base_station.position_ned: {away / 1e3:.4g} km from the site; "
            f"allowed: up to {FARTHEST_BASE / 1e3:g} km, for which corrections are modelled"
        )
    for i, (start, end) in enumerate(base.silent):
        path = f"world.base_station.silent.{i}"
        if start < 0.0 or start >= duration:
            yield f"{path}: begins at {start:g} s; allowed: from 0 s to before the end of the run at {duration:g} s"
        elif end <= start:
            yield f"{path}: ends at {end:g} s, not after its start, {start:g} s"


def satellite_problems(scenario: ScenarioSpec, ephemeris: Ephemeris) -> Iterator[str]:
    """Yield an error for each receiver of type gnss that cannot work with these orbits."""
    yield from correction_problems(scenario)
    names = [name for fleet_name, fleet in scenario.fleets.items() for name in vehicle_names(fleet_name, fleet)]
    yield from interference_problems(scenario, ephemeris, names, bool(receivers(scenario)))
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
