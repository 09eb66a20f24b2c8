"""What clients may let fail: the option ``--injectable`` of every command that has clients."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from qrsim.errors import UsageError, did_you_mean
from qrsim.models.vehicles.multirotor.vehicle import Multirotor
from qrsim.scenarios.catalogue import BATTERIES, VEHICLES
from qrsim.scenarios.scenario import Scenario, load_scenario

# Names that are no sensors.
PARTS = ("all", "rotors", "battery", "radio")
# Longest delay of readings [s] that may be injected where all may be.
DELAY_MAX = 0.5


def may_fail(content: dict[str, Any], names: Sequence[str]) -> None:
    """Have parts of all fleets of a scenario's content fail where clients ask for it, in place.

    Args:
        content: of the scenario.
        names: sensors, ``rotors``, ``battery``, ``radio``, or ``all``.

    Raises:
        UsageError: no fleet has a sensor of that name.
    """
    known = set(PARTS).union(*(fleet["sensors"] for fleet in content["fleets"].values()))
    for name in names:
        if name not in known:
            raise UsageError(f"--injectable {name}: there is no such sensor{did_you_mean(name, sorted(known))}")
    for fleet in content["fleets"].values():
        if "all" in names:
            everything = {"sensors": "all", "rotors": "all", "battery": True, "radio": True}
            fleet["injectable"] = everything | {"delay_max": DELAY_MAX}
            continue
        spec = fleet["injectable"] or {}
        before = spec.get("sensors", [])
        sensors = [name for name in fleet["sensors"] if before == ["all"] or name in {*names, *before}]
        more: dict[str, Any] = {"sensors": sensors}
        # Of what a fleet does not have nothing can fail.
        if "rotors" in names and issubclass(VEHICLES[fleet["vehicle"]["type"]], Multirotor):
            more["rotors"] = "all"
        if "battery" in names and BATTERIES[fleet["battery"]["type"]].drains:
            more["battery"] = True
        if "radio" in names and content["world"]["radio"] is not None and (fleet["radio"] or {}).get("works", True):
            more["radio"] = True
        fleet["injectable"] = spec | more


def with_injectable(scenario: Scenario, names: Sequence[str]) -> Scenario:
    """Return a scenario whose parts clients may let fail; the same one where nothing is named.

    Raises:
        UsageError: see ``may_fail``.
    """
    if not names:
        return scenario
    content = scenario.spec.model_dump(mode="json")
    may_fail(content, names)
    return load_scenario(content, quiet=True)


def of_those(scenario: Scenario, names: Sequence[str]) -> list[str]:
    """Return those of some names that a scenario has: its sensors, and parts of vehicles."""
    sensors = {sensor for fleet in scenario.spec.fleets.values() for sensor in fleet.sensors}
    return [name for name in names if name in PARTS or name in sensors]
