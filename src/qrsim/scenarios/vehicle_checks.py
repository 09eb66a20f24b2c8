"""Checks of a fleet against its vehicle."""

from __future__ import annotations

from collections.abc import Iterator

from qrsim.control.contracts import Controller
from qrsim.models.vehicles.commands import fields_of
from qrsim.models.vehicles.contracts import Vehicle
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.schema import FleetSpec

# No vehicle of this simulator is so heavy [kg]; builders weigh theirs in grams.
MOST_KG = 100.0


def controller_problems(fleet_name: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield errors of a controller that cannot fly its vehicle, and of battery or route of a vehicle
    that cannot move."""
    vehicle = known.VEHICLES[fleet.vehicle.type]
    fitting = [name for name, cls in known.CONTROLLERS.items() if can_fly(cls, vehicle)]
    if fleet.controller.type not in fitting:
        yield (
            f"fleets.{fleet_name}.controller: '{fleet.controller.type}' does not fly a '{fleet.vehicle.type}'; "
            f"allowed: {', '.join(fitting) or 'none of the built-in ones'}"
        )
    if fields_of(vehicle.command_type):
        return
    if fleet.battery.type != "given":
        yield (
            f"fleets.{fleet_name}.battery: '{fleet.battery.type}' is drained by thrust, and a '{fleet.vehicle.type}' "
            "has none; leave it out"
        )
    for i, vehicle_spec in enumerate(fleet.vehicles):
        if vehicle_spec.waypoints_ned:
            yield (
                f"fleets.{fleet_name}.vehicles.{i}.waypoints_ned: a '{fleet.vehicle.type}' stays where it is; leave "
                "its waypoints out"
            )


def can_fly(controller: type[Controller], vehicle: type[Vehicle]) -> bool:
    """Return whether a controller class gives the kind of command that a vehicle class takes."""
    if controller.gives is object:
        # The vehicle's own command of tilt and throttle, if it has one.
        return vehicle.handling is not Vehicle.handling
    return any(issubclass(kind, controller.gives) for kind in vehicle.actions)


def grams_hint(mass: float) -> str:
    """Return a hint that a mass [kg] looks like grams; "" if it is plausible."""
    return f"; masses are in kg: {mass:g} g are {mass / 1000.0:g} kg" if mass >= MOST_KG else ""
