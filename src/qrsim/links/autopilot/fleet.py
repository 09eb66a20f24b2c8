"""Scenarios as an autopilot's firmware flies them: its rate, rigid bodies with rotors, an IMU at every tick."""

from __future__ import annotations

import math

from qrsim.errors import ScenarioError, UsageError, did_you_mean
from qrsim.files import Content
from qrsim.links.shared.grounding import put_down, standing
from qrsim.links.shared.motor_frames import FRAMES
from qrsim.models.vehicles.multirotor.vehicle import Multirotor
from qrsim.scenarios.catalogue import VEHICLES
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.world.state import Fleet, World

# An arm may be this far from that of the frame [deg]: anywhere in its corner, or near it.
CORNER_DEG, NEAR_DEG = 45.0, 12.0
INERTIAL = ("imu", "gyroscope", "accelerometer")
IDENTIFIED = ("pelican", "quadrotor")
# A period is a whole number of ticks up to this part of one.
NEAR_TICK = 1e-6


def prepared(
    scenario: Scenario,
    fleets: tuple[str, ...],
    model: str,
    rate: float,
    who: str = "Betaflight",
    on_ground: bool = False,
    inertial_rate: float | None = None,
) -> tuple[Scenario, tuple[str, ...]]:
    """Adapt a scenario (multirotor ``model``, controllers, sensor periods) to an autopilot (``who``) at a rate [Hz];
    also return the names of the fleets that it flies.

    Identified quadrotors, which have an autopilot in them, become multirotors of a model with a ``cascade``. Sensors of
    rates and forces read at every tick; periods of others become multiples of a tick.

    Args:
        scenario: of the user.
        fleets: names; none: all with vehicles of rotors.
        model: of the multirotors.
        rate: ticks a second [Hz].
        who: name of the autopilot, for messages.
        on_ground: whether vehicles start at rest on the ground below their places, without a route.
        inertial_rate: of rates and forces [Hz]; None: at every tick.

    Raises:
        UsageError: an unknown fleet, or one that has no rotors; a scenario that cannot be at this rate.
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
        _adapt_fleet(found[name], model, rate, inertial_rate or rate)
    where = ""
    try:
        if on_ground:
            where = "on the ground, "
            for name in flown:
                standing(found[name], True)
            put_down(content, load_scenario(content, quiet=True).world(), flown)
        return load_scenario(content, quiet=True), flown
    except ScenarioError as error:
        raise UsageError(f"{where}flown at {rate:g} Hz by {who}: {error}") from None


def _has_rotors(fleet: Content) -> bool:
    """Return whether a fleet's vehicle is a multirotor."""
    kind = fleet["vehicle"]["type"]
    return kind in IDENTIFIED or VEHICLES.get(kind) is Multirotor


def _adapt_fleet(fleet: Content, model: str, rate: float, inertial_rate: float) -> None:
    """Change a fleet's scenario entries in place: multirotor model, cascade controller, sensor periods in whole
    ticks."""
    if fleet["vehicle"]["type"] in IDENTIFIED:
        fleet["vehicle"] = {"type": "multirotor", "model": model}
        # Those of the identified vehicle are where it was identified.
        fleet.pop("limits", None)
        if fleet["controller"]["type"] != "cascade":
            feed = fleet["controller"].get("feed")
            fleet["controller"] = {"type": "cascade"} | ({"feed": feed} if feed else {})
    for sensor in (fleet.get("sensors") or {}).values():
        if "period" not in sensor:
            continue
        ticks = max(1, round(sensor["period"] * rate))
        if sensor["type"] in INERTIAL:
            sensor["period"] = 1.0 / inertial_rate
        elif abs(ticks - sensor["period"] * rate) > NEAR_TICK:
            sensor["period"] = ticks / rate


def motor_order(fleet: Fleet, away_deg: float = NEAR_DEG) -> tuple[int, ...] | None:
    """Return the motor number (from 0) of each rotor in an X frame whose arms are within ``away_deg`` [deg]; None for
    other frames.

    Args:
        fleet: of multirotors.
        away_deg: rotors are this close to the arms of the frame [deg].
    """
    rotors = fleet.vehicle.rotors if isinstance(fleet.vehicle, Multirotor) else ()
    frame = FRAMES.get(len(rotors), ())
    order = []
    for rotor in rotors:
        bearing = math.degrees(math.atan2(rotor.position[1], rotor.position[0]))
        order += [
            number
            for number, (arm, turn) in enumerate(frame)
            if abs((bearing - arm + 180.0) % 360.0 - 180.0) < away_deg and turn == rotor.direction
        ]
    return tuple(order) if frame and sorted(order) == list(range(len(frame))) else None


def rotor_order(fleet: Fleet) -> tuple[int, ...]:
    """Return the number of each rotor in Betaflight's motor order: 0 front right, 1 rear left, 2 front left, 3 rear
    right.

    Raises:
        UsageError: they are not the four of an X that turn as the firmware has it.
    """
    order = motor_order(fleet, CORNER_DEG)
    if order is None or len(order) != 4:
        raise UsageError(
            f"fleet '{fleet.name}': Betaflight flies four rotors in an X here, front right and rear left counter-"
            "clockwise from above; take model x500, hummingbird or crazyflie"
        )
    return order


def checked_fleet(world: World, name: str) -> Fleet:
    """Return a fleet by name; raises UsageError unless Betaflight can fly it: four rotors in an X, a controller with
    attitude set-points."""
    fleet = next(each for each in world.fleets if each.name == name)
    rotor_order(fleet)
    if "AttitudeSetpoint" not in {kind.__name__ for kind in fleet.controller.setpoints}:
        raise UsageError(f"fleet '{name}': its controller gives no tilt and throttle for sticks; take a cascade")
    return fleet
