"""A law of whole simulations: whatever a world is made of, a run that is saved and resumed is the uninterrupted one.

A few worlds hold every component of the catalogue between them; a new one is covered by being there.
"""

from __future__ import annotations

from itertools import chain
from typing import Any

import pytest
from component_cases import GROUPS, START, parameters_needed

from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.scenarios import catalogue
from qrsim.scenarios.scenario import load_scenario
from qrsim.scenarios.vehicle_checks import can_fly
from qrsim.simulation.simulation import Simulation

# A world has one of each of these, a fleet one of each of the others; obstacles and sensors go together.
OF_A_WORLD = {
    "WINDS": "wind",
    "TURBULENCES": "turbulence",
    "GUSTS": "gust",
    "AREAS": "area",
    "GROUNDS": "ground",
    "ORBITS": "orbits",
    "SKY_ERRORS": "errors",
}
# What no thrust carries.
WITHOUT_BATTERY = ("fixed_wing", "rover", "differential_rover")
OF_A_FLEET = {"VEHICLES": "vehicle", "BATTERIES": "battery", "CONTROLLERS": "controller"}
TEAMS = [name for name, kind in GROUPS["GUIDANCE"].items() if kind.sees_mates]
BESIDE = {"waypoint": "ekf", "velocity": "complementary"}
# Calm air has nothing to resume: a profile takes its place in these worlds.
NAMES = {group: list(known) for group, known in GROUPS.items()}
NAMES["WINDS"] = ["profile", *(name for name in NAMES["WINDS"] if name not in ("calm", "profile"))]
WORLDS = range(max(len(NAMES[group]) for group in OF_A_WORLD))
# The sky steps every 10 ticks, so both parts have one of its steps.
SAVED_AT, TICKS = 13, 30


# What only the worlds of tasks contain; see the law of resumed tasks.
OF_TASKS = {"PLUMES", "PERSONS", "TASKS", "PLACEMENTS", "TERRAINS"}


def part(group: str, number: int) -> dict[str, Any]:
    """Return one of a group's components, counted around, as a scenario writes it."""
    names = NAMES[group]
    name = names[number % len(names)]
    return {"type": name, **parameters_needed(group, name)}


def flown_by(controller: str, number: int) -> dict[str, Any]:
    """Return one of the vehicles that a controller flies, counted around, as a scenario writes it."""
    pilot = GROUPS["CONTROLLERS"][controller]
    fitting = [name for name, kind in GROUPS["VEHICLES"].items() if can_fly(pilot, kind)]
    name = fitting[number % len(fitting)]
    return {"type": name, **parameters_needed("VEHICLES", name)}


def content(number: int) -> dict[str, Any]:
    """Return the scenario of one of WORLDS, with every so-many-th of the controllers and sensors."""
    world = {key: part(group, number) for group, key in OF_A_WORLD.items()}
    world["sky"] = {"orbits": world.pop("orbits"), "errors": world.pop("errors")}
    # One thermal, narrower than the polygon.
    of_one = {"thermals": {"z_i": 600.0, "count": 1}}
    hilly = world["ground"]["type"] != "flat"
    names = [name for name in GROUPS["UPDRAFTS"] if name != "ridge_lift" or hilly]
    world["updrafts"] = [{"type": name, **of_one.get(name, {})} for name in names]
    world["obstacles"] = [part("OBSTACLES", i) for i in range(len(GROUPS["OBSTACLES"]))]
    sensors = {name: {"type": name} for name in list(GROUPS["SENSORS"])[number :: len(WORLDS)]}
    faults = [{"sensor": name, "kind": "frozen", "start": 0.1, "end": 0.4} for name in sensors]
    if world["sky"]["orbits"]["type"] == "sp3":
        sensors["listed"] = {"type": "gnss_receiver", "satellites": "hand_list"}
    fleets = {}
    for i in range(number, len(GROUPS["CONTROLLERS"]), len(WORLDS)):
        fleet = {key: part(group, i) for group, key in OF_A_FLEET.items()}
        fleet["vehicles"] = [{"position_ned": [0.0, 5.0 * i - 30.0, -30.0]}]
        fleet["vehicle"] = flown_by(fleet["controller"]["type"], i)
        if fleet["controller"]["type"] == "cascade":
            fleet |= {"vehicle": {"type": "multirotor"}, "battery": {"type": "lithium_cells"}}
        elif fleet["battery"]["type"] == "lithium_cells":
            fleet["battery"] = {"type": "lithium_polymer"}
        if fleet["vehicle"]["type"] in WITHOUT_BATTERY:
            fleet["battery"] = {"type": "given"}
        if fleet["controller"]["type"] == "none":
            fleet["battery"] = {"type": "given"}
        else:
            fleet["controller"]["feed"] = "truth"
            fleet["vehicles"][0]["waypoints_ned"] = [[0.0, 0.0, -32.0]]
            if fleet["vehicle"]["type"] == "fixed_wing":
                # It flies on, towards north, through the narrow end of the areas.
                fleet["vehicles"][0]["position_ned"] = [-35.0, -10.0, -30.0]
            if fleet["vehicle"]["type"] in ("rover", "differential_rover"):
                fleet["vehicles"] = [{"position_ned": [0.0, 5.0 * i - 30.0, 0.0], "waypoints_ned": [[9.0, 0.0, 0.0]]}]
            if issubclass(catalogue.VEHICLES[fleet["vehicle"]["type"]], Quadrotor):
                fleet["ground"] = "parked"
        if fleet["controller"]["type"] == "cascade":
            # With its filter, and what that reads.
            fleet["controller"]["feed"] = "filter"
            fleet["guidance"] = {"type": "mission"}
            own = ("gnss_receiver", "barometer", "attitude_estimator", "accelerometer")
            sensors = {name: {"type": name} for name in own} | sensors
        if fleet["controller"]["type"] in BESIDE:
            # On the truth, with an estimator beside.
            fleet["estimator"] = {"type": BESIDE[fleet["controller"]["type"]]}
            own = ("gnss_receiver", "barometer", "attitude_estimator", "accelerometer", "gyroscope")
            sensors = {name: {"type": name} for name in own} | sensors
        fleets[f"fleet_{i}"] = {**fleet, "sensors": sensors, "faults": faults}
        sensors, faults = {}, []
    for i, name in enumerate(TEAMS[number :: len(WORLDS)]):
        guidance = {"type": name, **parameters_needed("GUIDANCE", name)}
        places = [{"position_ned": [0.0, 6.0 * i + 3.0 * j - 20.0, -20.0]} for j in range(2)]
        controller = {"type": "velocity_height", "feed": "truth"}
        fleets[name] = {"controller": controller, "guidance": guidance, "vehicles": places}
    if number == 0:
        # Both kinds of rovers are driven by one controller.
        driven = {"controller": {"type": "rover", "feed": "truth"}, "vehicles": [{"position_ned": [9.0, 9.0, 0.0]}]}
        fleets["driven"] = {**driven, "vehicle": {"type": "rover", **parameters_needed("VEHICLES", "rover")}}
    return {"name": f"world_{number}", "duration": 30.0, "start_time": START, "world": world, "fleets": fleets}


def types_of(spec: Any) -> set[str]:
    """Return every type in a part of a resolved scenario."""
    if spec is None:
        return set()
    if isinstance(spec, list):
        return set(chain.from_iterable(map(types_of, spec)))
    if isinstance(spec, dict):
        return set(chain.from_iterable(map(types_of, spec.values()))) | {spec[key] for key in spec if key == "type"}
    return set()


def simulation(number: int, seed: int) -> Simulation:
    scenario = load_scenario(content(number))
    return Simulation(scenario.world(), seed=seed, name=scenario.name)


def test_between_them_the_worlds_hold_every_component() -> None:
    specs = [load_scenario(content(number)).spec.model_dump() for number in WORLDS]
    places = {
        group: [spec["world"].get(key, spec["world"]["sky"].get(key)) for spec in specs]
        for group, key in OF_A_WORLD.items()
    }
    fleets = [fleet for spec in specs for fleet in spec["fleets"].values()]
    places |= {group: [fleet[key] for fleet in fleets] for group, key in OF_A_FLEET.items()}
    # The mouse flees in the worlds of cats_and_mouse.
    places["GUIDANCE"] = [*(fleet["guidance"] for fleet in fleets), {"type": "flee"}]
    places["SENSORS"] = [fleet["sensors"] for fleet in fleets]
    places["UPDRAFTS"] = [spec["world"]["updrafts"] for spec in specs]
    places["OBSTACLES"] = [spec["world"]["obstacles"] for spec in specs]
    places["FILTERS"] = [fleet["estimator"] for fleet in fleets]
    assert set(places) | OF_TASKS == set(GROUPS), "a new kind of component needs its place in these worlds"
    for group, found in places.items():
        assert types_of(found) >= set(NAMES[group]), group


@pytest.mark.parametrize("name", ["search_and_rescue/2D", "cats_and_mouse/1C", "plume_mapping/3F"])
@pytest.mark.long
def test_a_resumed_task_is_the_uninterrupted_one_bit_for_bit(name: str) -> None:
    """What an episode draws and what is in its world too: terrain and persons, a mouse, a plume."""
    scenario = load_scenario(name)

    def fresh(seed: int) -> Simulation:
        started = Simulation(scenario.world(), seed=seed, name=scenario.name)
        started.reset()
        return started

    whole, first, resumed = fresh(5), fresh(5), fresh(6)
    whole.step(ticks=40)
    first.step(ticks=15)
    resumed.load(first.save())
    resumed.step(ticks=25)
    assert resumed.save() == whole.save()


@pytest.mark.long
@pytest.mark.parametrize("number", WORLDS)
@pytest.mark.filterwarnings("ignore:fleets.*hand list")
def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(number: int) -> None:
    whole = simulation(number, seed=5)
    whole.reset()
    whole.step(ticks=TICKS)
    assert whole.valid.all(), whole.reasons
    first = simulation(number, seed=5)
    first.reset()
    first.step(ticks=SAVED_AT)
    resumed = simulation(number, seed=6)
    resumed.load(first.save())
    resumed.step(ticks=TICKS - SAVED_AT)
    assert resumed.save() == whole.save()
