"""Checks of fixed wings: fast enough at the start, and circles that the wind lets them fly."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.scene.contracts import down_at
from qrsim.models.vehicles.fixed_wing import FixedWing
from qrsim.models.vehicles.fixed_wing.trim import stall_speed
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.build import ground_if_any, vehicle_of
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.vehicle_checks import grams_hint
from qrsim.scenarios.wind_limits import mean_wind

# Steady bank of a circle; what is left up to the controller's limit keeps to it.
BANK_RAD = math.radians(40.0)


def fixed_wing_problems(name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the reasons why a fleet of fixed wings cannot fly; nothing for other fleets."""
    if not issubclass(known.VEHICLES[fleet.vehicle.type], FixedWing):
        return
    try:
        vehicle = vehicle_of(fleet, scenario)
        stall = stall_speed(vehicle)
    except UsageError:
        return
    yield from _inertia(name, vehicle)
    cruise = float(np.min(np.asarray(vehicle.cruise_airspeed)))
    if cruise < stall:
        hint = grams_hint(float(np.max(vehicle.mass)))
        yield f"fleets.{name}.vehicle.cruise_airspeed: {cruise:g} m/s {_stalls(stall)}{hint}"
    for part, key in ((fleet.controller, "airspeed"), (fleet.guidance, "airspeed")):
        slow = np.ravel(np.asarray(vars(part).get(key, 0.0), float))
        slow = slow[(slow > 0.0) & (slow < stall)]
        if slow.size:
            which = "controller" if part is fleet.controller else "guidance"
            yield f"fleets.{name}.{which}.{key}: {slow[0]:g} m/s {_stalls(stall)}"
    for i, each in enumerate(fleet.vehicles):
        # A wind from the side or from behind lifts no wing, so it is the part ahead that counts.
        if any(each.velocity_body) and each.velocity_body[0] < stall:
            yield (
                f"fleets.{name}.vehicles.{i}.velocity_body: starts at an airspeed of {each.velocity_body[0]:.4g} m/s "
                f"ahead, which {_stalls(stall)}; without it, it starts at {cruise:g} m/s"
            )
    yield from _on_ground(name, fleet, scenario, float(np.max(np.asarray(vehicle.span))))
    yield from _circles(name, fleet, scenario, cruise)


def _stalls(stall: float) -> str:
    """Return the text which says that an airspeed is below the stall speed ``stall`` [m/s]."""
    return f"is below its stall at {stall:.3g} m/s; allowed: above that"


def _on_ground(name: str, fleet: FleetSpec, scenario: ScenarioSpec, span: float) -> Iterator[str]:
    """Yield the starts lower than half a wing span, where a wing would touch the ground at the first bank."""
    ground = ground_if_any(scenario)
    if ground is None or fleet.placement.type != "given":
        return
    places = Vec3(*np.array([each.position_ned for each in fleet.vehicles], np.float32).reshape(-1, 3).T)
    for i, down in enumerate(down_at(ground, places).tolist()):
        z, least = fleet.vehicles[i].position_ned[2], down - 0.5 * span
        if z > least:
            yield (
                f"fleets.{name}.vehicles.{i}.position_ned: z = {z:g} m, but a 'fixed_wing' starts in flight; allowed: "
                f"z at most {least:.4g} m, half a span above the ground"
            )


def _inertia(name: str, vehicle: FixedWing) -> Iterator[str]:
    """Yield an error if a fixed wing's inertia tensor is impossible: inertia_xz^2 >= inertia_x * inertia_z."""
    x, z, xz = (np.asarray(part, float) for part in (vehicle.inertia_x, vehicle.inertia_z, vehicle.inertia_xz))
    if np.any(x * z <= xz * xz):
        yield (
            f"fleets.{name}.vehicle.inertia_xz: no body has this product of inertia; allowed: at most the root of "
            "inertia_x times inertia_z"
        )


def _circles(name: str, fleet: FleetSpec, scenario: ScenarioSpec, cruise: float) -> Iterator[str]:
    """Yield an error for each circle that is too tight for the bank limit at the downwind ground speed."""
    path, radius = "guidance.radius", vars(fleet.guidance).get("radius")
    if fleet.guidance.type == "route":
        path, radius = "controller.loiter_radius", vars(fleet.controller).get("loiter_radius")
    if fleet.controller.type != "fixed_wing" or radius is None:
        return
    size = len(fleet.vehicles)
    given = [radius, *(vars(part).get("airspeed", 0.0) for part in (fleet.guidance, fleet.controller)), cruise]
    try:
        wide, *fast = (np.broadcast_to(np.asarray(part, float), (size,)) for part in given)
    except ValueError:
        return  # lists of the wrong length are a problem of their own
    own = np.select([part > 0.0 for part in fast], fast)
    gravity = float(np.min(np.asarray(vars(fleet.vehicle)["gravity"])))
    for i, each in enumerate(fleet.vehicles):
        if fleet.guidance.type == "fixed_wing" and fleet.guidance.repeat and len(each.waypoints_ned) > 1:
            continue
        centre = each.waypoints_ned[-1] if each.waypoints_ned else each.position_ned
        wind = float(mean_wind(scenario, np.array([-centre[2]]))[0])
        least = (own[i] + wind) ** 2 / (max(gravity, 1e-3) * math.tan(BANK_RAD))
        if abs(wide[i]) < least:
            yield (
                f"fleets.{name}.{path}: {wide[i]:g} m is tighter than the wind allows: at an airspeed of {own[i]:g} "
                f"m/s in {wind:.3g} m/s of wind a bank of 40 deg flies a circle of {least:.0f} m downwind; allowed: at "
                f"least {math.ceil(least):g}, or less airspeed"
            )
            return
