"""Scenarios as an autopilot's firmware flies them: its rate, rigid bodies with rotors, an IMU at every tick."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.errors import ScenarioError, UsageError, did_you_mean
from qrsim.models.vehicles.multirotor.vehicle import Multirotor
from qrsim.scenarios.catalogue import VEHICLES
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.world.state import Fleet, World

# Signs of forward and right of the firmware's rotors, in its order, and how they turn (+1: clockwise from above).
ROTORS = (((1, 1), -1), ((-1, -1), -1), ((1, -1), 1), ((-1, 1), 1))
INERTIAL = ("imu", "gyroscope", "accelerometer")
IDENTIFIED = ("pelican", "quadrotor")


def prepared(scenario: Scenario, fleets: tuple[str, ...], model: str, rate: float) -> tuple[Scenario, tuple[str, ...]]:
    """Return a scenario whose fleets the firmware can fly, and the names of these.

    Identified quadrotors, which have an autopilot in them, become multirotors of a model with a ``cascade``; sensors of
    rates and forces read at every tick.

    Args:
        scenario: of the user.
        fleets: names; none: all with vehicles of rotors.
        model: of the multirotors.
        rate: ticks a second [Hz].

    Raises:
        UsageError: an unknown fleet, or one that has no rotors; a scenario that cannot be at this rate.
    """
    content, flown = refitted(scenario, fleets, model, rate, "Betaflight")
    try:
        made = load_scenario(content, quiet=True)
    except ScenarioError as error:
        raise UsageError(f"flown at {rate:g} Hz by Betaflight: {error}") from None
    return made, flown


def refitted(
    scenario: Scenario, fleets: tuple[str, ...], model: str, rate: float, who: str
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the content of ``prepared``'s scenario for an autopilot called ``who``, and the names of its fleets.

    Raises:
        UsageError: an unknown fleet, or one that has no rotors.
    """
    content = scenario.spec.model_dump(mode="json")
    found = content["fleets"]
    for name in fleets:
        if name not in found:
            raise UsageError(f"--fleet {name}: the scenario has {', '.join(found)}{did_you_mean(name, list(found))}")
        if not _has_rotors(found[name]):
            kind = found[name]["vehicle"]["type"]
            raise UsageError(f"--fleet {name}: a {kind} is flown by no {who} here; expected a multirotor or quadrotor")
    flown = fleets or tuple(name for name, fleet in found.items() if _has_rotors(fleet))
    if not flown:
        raise UsageError(f"no fleet of the scenario has rotors, and {who} flies these only here")
    content["time_step"] = 1.0 / rate
    for name in flown:
        _fit(found[name], model, 1.0 / rate)
    return content, flown


def _has_rotors(fleet: dict[str, Any]) -> bool:
    kind = fleet["vehicle"]["type"]
    return kind in IDENTIFIED or VEHICLES.get(kind) is Multirotor


def _fit(fleet: dict[str, Any], model: str, period: float) -> None:
    if fleet["vehicle"]["type"] in IDENTIFIED:
        fleet["vehicle"] = {"type": "multirotor", "model": model}
        # Those of the identified vehicle are where it was identified.
        fleet.pop("limits", None)
        if fleet["controller"]["type"] != "cascade":
            feed = fleet["controller"].get("feed")
            fleet["controller"] = {"type": "cascade"} | ({"feed": feed} if feed else {})
    for sensor in (fleet.get("sensors") or {}).values():
        if sensor["type"] in INERTIAL and "period" in sensor:
            sensor["period"] = period


def rotor_order(fleet: Fleet) -> tuple[int, ...]:
    """Return for each rotor of the vehicles its number in the firmware's order: FR, RL, FL, RR.

    Raises:
        UsageError: they are not the four of an X that turn as the firmware has it.
    """
    vehicle = fleet.vehicle
    rotors = vehicle.rotors if isinstance(vehicle, Multirotor) else ()
    order = []
    for rotor in rotors:
        corner = (int(np.sign(rotor.position[0])), int(np.sign(rotor.position[1])))
        numbers = [number for number, (where, turn) in enumerate(ROTORS) if (where, turn) == (corner, rotor.direction)]
        order += numbers
    if len(rotors) != 4 or sorted(order) != [0, 1, 2, 3]:
        raise UsageError(
            f"fleet '{fleet.name}': Betaflight flies four rotors in an X here, front right and rear left counter-"
            "clockwise from above; take model x500, hummingbird or crazyflie"
        )
    return tuple(order)


def checked_fleet(world: World, name: str) -> Fleet:
    """Return a fleet that is to be flown; raises UsageError where it has no rotors in an X, handling or sensors."""
    fleet = next(each for each in world.fleets if each.name == name)
    rotor_order(fleet)
    if "AttitudeSetpoint" not in {kind.__name__ for kind in fleet.controller.setpoints}:
        raise UsageError(f"fleet '{name}': its controller gives no tilt and throttle for sticks; take a cascade")
    return fleet
