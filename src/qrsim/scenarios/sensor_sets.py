"""Sensors of a fleet by the name of a set: ``sensors: ideal`` and ``sensors: noisy``."""

from __future__ import annotations

import copy
from collections.abc import Mapping

from qrsim.errors import ScenarioError, did_you_mean
from qrsim.files import Content

SETS: dict[str, Content] = {
    "ideal": {
        "gnss": {"type": "ideal_gnss"},
        "barometer": {"type": "ideal_barometer"},
        "attitude": {"type": "ideal_attitude"},
        "gyroscope": {"type": "ideal_gyroscope"},
        "accelerometer": {"type": "ideal_accelerometer"},
    },
    "noisy": {
        "gnss": {"type": "gnss", "preset": "f9p_single"},
        "imu": {"type": "imu", "preset": "icm42688p"},
        "magnetometer": {"type": "magnetometer"},
        "barometer": {"type": "barometer"},
    },
}
# Goes with the noisy set unless the scenario has its own: gusts that neighbours share, and a filter of the readings.
TURBULENCE = {"type": "dryden_field"}
# Winds that turbulence takes its strength from, as from a ``speed_20ft``.
PROFILES = ("profile", "weather")
ESTIMATOR = {"type": "ekf"}


def or_a_set(schema: Content) -> None:
    """Extend the JSON schema of a fleet's sensors, in place, so that it allows the name of a sensor set."""
    named = {name: schema.pop(name) for name in ("type", "additionalProperties") if name in schema}
    schema["anyOf"] = [named, {"type": "string", "enum": list(SETS)}]


def insert_sensor_sets(content: Mapping[str, object], source: str) -> None:
    """Replace the name of a sensor set in each fleet's content by its sensors, in place.

    With "noisy" a fleet gets an estimator and, in a wind that states its strength, the world gets turbulence, unless
    the scenario says otherwise; an estimator of null stays none.

    Raises:
        ScenarioError: no set has that name.
    """
    fleets, problems = content.get("fleets"), []
    for name, fleet in fleets.items() if isinstance(fleets, dict) else ():
        chosen = fleet.get("sensors") if isinstance(fleet, dict) else None
        if not isinstance(chosen, str):
            continue
        if chosen not in SETS:
            problems.append(
                f"fleets.{name}.sensors: no set of sensors is called '{chosen:.60}'{did_you_mean(chosen, SETS)}; or "
                "list sensors by name"
            )
            continue
        fleet["sensors"] = copy.deepcopy(SETS[chosen])
        if chosen == "noisy":
            fleet.setdefault("estimator", dict(ESTIMATOR))
            _add_turbulence(content)
    if problems:
        raise ScenarioError(source, problems)


def _add_turbulence(content: Mapping[str, object]) -> None:
    """Add a turbulence model to a scenario's world, in place, if its wind gives the strength of gusts."""
    world = content.get("world")
    wind = world.get("wind") if isinstance(world, dict) else None
    if isinstance(world, dict) and isinstance(wind, dict) and ("speed_20ft" in wind or wind.get("type") in PROFILES):
        world.setdefault("turbulence", dict(TURBULENCE))
