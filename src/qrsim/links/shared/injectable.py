"""What clients may let fail: the option ``--injectable`` of every command that has clients."""

from __future__ import annotations

from collections.abc import Sequence

from qrsim.errors import UsageError, did_you_mean
from qrsim.files import Content
from qrsim.models.vehicles.multirotor.vehicle import Multirotor
from qrsim.scenarios.catalogue import BATTERIES, VEHICLES
from qrsim.scenarios.scenario import Scenario, load_scenario

# Names that are no sensors, and why no fleet of a scenario has such a part.
WITHOUT = {
    "rotors": "only a 'multirotor' has rotors that can fail, and no fleet has this type of vehicle",
    "battery": "no fleet has a battery that drains, such as battery: {type: lithium_polymer}",
    "body": "no vehicle can be pushed; one of type 'fixed_point' cannot",
    "radio": "no fleet has a radio; the scenario needs world.radio, and a fleet without radio: none",
}
PARTS = ("all", *WITHOUT)
# Longest delay of readings [s] that may be injected where all may be.
DELAY_MAX = 0.5


def may_fail(content: Content, names: Sequence[str]) -> None:
    """Declare sensors and parts (``names``) as open to injected faults in all fleets of a scenario's content, in place.

    Args:
        content: of the scenario.
        names: sensors, ``rotors``, ``battery``, ``radio``, ``body``, or ``all``.

    Raises:
        UsageError: no fleet has a sensor of that name, or such a part.
    """
    fleets = content["fleets"].values()
    known = set(PARTS).union(*(fleet["sensors"] for fleet in fleets))
    for name in names:
        if name not in known:
            raise UsageError(f"--injectable {name}: there is no such sensor{did_you_mean(name, sorted(known))}")
        if name in WITHOUT and not any(_has_part(content, fleet, name) for fleet in fleets):
            raise UsageError(f"--injectable {name}: {WITHOUT[name]}")
    for fleet in fleets:
        if "all" in names:
            everything = {"sensors": "all", "rotors": "all", "battery": True, "radio": True, "body": True}
            fleet["injectable"] = everything | {"delay_max": DELAY_MAX}
            continue
        spec = fleet["injectable"] or {}
        before = spec.get("sensors", [])
        sensors = [name for name in fleet["sensors"] if before == ["all"] or name in {*names, *before}]
        more: Content = {"sensors": sensors}
        # Of what a fleet does not have nothing can fail.
        more |= {
            part: "all" if part == "rotors" else True
            for part in WITHOUT
            if part in names and _has_part(content, fleet, part)
        }
        fleet["injectable"] = spec | more


def _has_part(content: Content, fleet: Content, part: str) -> bool:
    """Return whether a fleet in a scenario's content has a part, such as a battery, other than its sensors."""
    if part == "rotors":
        return issubclass(VEHICLES[fleet["vehicle"]["type"]], Multirotor)
    if part == "battery":
        return bool(BATTERIES[fleet["battery"]["type"]].drains)
    if part == "body":
        return bool(VEHICLES[fleet["vehicle"]["type"]].pushable)
    return content["world"]["radio"] is not None and (fleet["radio"] or {}).get("works", True)


def with_injectable(scenario: Scenario, names: Sequence[str]) -> Scenario:
    """Return a scenario in which clients may inject faults into the named sensors and parts; itself without names.

    Raises:
        UsageError: see ``may_fail``.
    """
    if not names:
        return scenario
    content = scenario.spec.model_dump(mode="json")
    may_fail(content, names)
    return load_scenario(content, quiet=True)


def of_those(scenario: Scenario, names: Sequence[str]) -> list[str]:
    """Return those of ``names`` that are sensors or parts of some vehicle in the scenario."""
    content = scenario.spec.model_dump(mode="json")
    fleets = content["fleets"].values()
    return [
        name
        for name in names
        if name == "all"
        or any(_has_part(content, fleet, name) if name in WITHOUT else name in fleet["sensors"] for fleet in fleets)
    ]
