"""The failsafes of a scenario: their checks, and what is built of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from qrsim.control import PathSetpoint, WaypointSetpoint
from qrsim.control.failsafe_flight import Failsafes, RallyPoint
from qrsim.control.rover import RoverController
from qrsim.core.tree import record_of, replace
from qrsim.core.vectors import Vec3
from qrsim.errors import did_you_mean
from qrsim.models.scene.contracts import Ground, down_at
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.faults import reading_fields
from qrsim.scenarios.ground import stands, top_of
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec

# Guidances that give one of these can be taken over from.
_TAKEN_OVER = (WaypointSetpoint, PathSetpoint)

# North coordinate of a rally point that a vehicle does not have [m].
FAR_AWAY = 1e6


def failsafes(
    given: Failsafes, fleet: FleetSpec, scenario: ScenarioSpec, ground_of: Callable[[ScenarioSpec], Ground]
) -> Failsafes:
    """Return a fleet's failsafes with the area's ceiling and rally points filled in; ``ground_of`` builds the ground.

    Args:
        given: as the scenario has them.
        fleet, scenario: where.
        ground_of: builds the ground, if there are rally points.
    """
    top = top_of(scenario.world.area)
    given = given if top is None else replace(given, top=np.array(-top))
    count = max((len(vehicle.rally_ned) for vehicle in fleet.vehicles), default=0)
    if not count:
        return given
    ground = ground_of(scenario)
    return replace(given, rally=tuple(_rally(fleet, number, ground) for number in range(count)))


def _rally(fleet: FleetSpec, number: int, ground: Ground) -> RallyPoint:
    """Return rally point ``number`` of all vehicles, arrays (n,); far away for vehicles with fewer rally points."""
    none = [FAR_AWAY, 0.0, 0.0]
    places = [each.rally_ned[number] if number < len(each.rally_ned) else none for each in fleet.vehicles]
    north, east, down = np.array(places, np.float64).T
    below = down_at(ground, record_of(Vec3, north, east, np.zeros_like(north)))
    return record_of(RallyPoint, record_of(Vec3, north, east, down), np.asarray(below, np.float64))


def failsafe_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors in the failsafes of a scenario."""
    for name, fleet in scenario.fleets.items():
        if fleet.failsafes is None:
            for i, vehicle in enumerate(fleet.vehicles):
                if vehicle.rally_ned:
                    yield f"fleets.{name}.vehicles.{i}.rally_ned: only failsafes return there; give failsafes: {{}}"
        else:
            path = f"fleets.{name}.failsafes"
            yield from _flight_problems(path, fleet)
            yield from _level_problems(path, fleet)
            yield from _floor_problems(path, scenario)
            yield from _link_problems(path, name, fleet, scenario)


def _flight_problems(path: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield the errors of a fleet that cannot fly its failsafes, cannot land by them, or in which nothing can fail."""
    controller, guidance = known.CONTROLLERS.get(fleet.controller.type), known.GUIDANCE.get(fleet.guidance.type)
    if controller is None or guidance is None:
        return
    if not _flies_paths(controller):
        fitting = [name for name, kind in known.CONTROLLERS.items() if _flies_paths(kind)]
        yield (
            f"{path}: the controller '{fleet.controller.type}' does not fly paths, as failsafes do; allowed: "
            f"{', '.join(fitting)}"
        )
    elif guidance.gives not in _TAKEN_OVER:
        fitting = [name for name, kind in known.GUIDANCE.items() if kind.gives in _TAKEN_OVER]
        yield (
            f"{path}: failsafes cannot take over from the guidance '{fleet.guidance.type}'; allowed: "
            f"{', '.join(fitting)}"
        )
    elif not stands(fleet):
        yield f"{path}: they land, but touching the ground ends the flight of this fleet; give it ground: parked"
    spec: Any = fleet.failsafes
    has_fix = any(
        name.startswith("position_ned.") for sensor in fleet.sensors.values() for name in reading_fields(sensor.type)
    )
    if not (has_fix or known.BATTERIES[fleet.battery.type].drains or spec.NAV_DLL_ACT != "none"):
        yield f"{path}: nothing can fail: the fleet has no battery that drains, no GNSS receiver and no NAV_DLL_ACT"
    if spec.COM_GNSSLOSS_ACT != "warn" and not has_fix:
        yield f"{path}.COM_GNSSLOSS_ACT: the fleet has no GNSS receiver"


def _flies_paths(controller: Any) -> bool:
    """Return whether a controller class flies paths through the air; that of a rover drives along them."""
    return PathSetpoint in controller.setpoints and not issubclass(controller, RoverController)


def _level_problems(path: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield the errors of a failsafe's battery levels: their order, and a battery without a charge."""
    spec: Any = fleet.failsafes
    if spec.COM_LOW_BAT_ACT != "warn" and not known.BATTERIES[fleet.battery.type].drains:
        yield f"{path}.COM_LOW_BAT_ACT: a battery of type '{fleet.battery.type}' has no charge that could be low"
    names = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
    values: list[Any] = [np.ravel(getattr(spec, name)) for name in names]
    if any(value.size not in (1, len(fleet.vehicles)) for value in values):
        return  # a problem of its own
    for above, below, highs, lows in zip(names, names[1:], values, values[1:], strict=False):
        for high, low in np.broadcast(highs, lows):
            if low > high:
                yield f"{path}.{below}: {low:g} is above {above}, {high:g}; allowed: at most that"
                break


def _floor_problems(path: str, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error if a vehicle that a failsafe lands would leave the area by its floor."""
    area = scenario.world.area
    ground = scenario.world.ground
    if area.type in ("box", "polygon", "zones") and ground.type == "flat" and area.z_max < -ground.height:
        yield (
            f"{path}: they land, but the area ends {-ground.height - area.z_max:g} m above the ground; give world.area "
            f"z_max: {-ground.height + 0.0:g}"
        )


def _link_problems(path: str, name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of a radio-link failsafe of a fleet in which it cannot act."""
    spec: Any = fleet.failsafes
    if spec.NAV_DLL_ACT == "none":
        if spec.link_to:
            yield f"{path}.link_to: nothing is done when that link is lost; give NAV_DLL_ACT too: hold, return or land"
        return
    if scenario.world.radio is None:
        yield f"{path}.NAV_DLL_ACT: there is no link that could be lost; give world.radio"
    elif not spec.link_to:
        yield f"{path}.link_to: missing; NAV_DLL_ACT needs the fleet to listen to: {', '.join(scenario.fleets)}"
    elif spec.link_to not in scenario.fleets:
        yield (f"{path}.link_to: there is no fleet '{spec.link_to}'{did_you_mean(spec.link_to, list(scenario.fleets))}")
    else:
        for each in dict.fromkeys((name, spec.link_to)):
            radio = scenario.fleets[each].radio
            if radio is not None and not radio.works:
                yield f"{path}.NAV_DLL_ACT: fleets.{each}.radio is none"
