"""Missions in scenarios: legs and plans, what of them is refused, and that they are flown and told of."""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.errors import ScenarioError
from qrsim.runs import open_run
from qrsim.runs.recorder import fly
from qrsim.runs.summary import summarise
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

HOME = (47.0, 8.0)


def scenario(*legs: Any, start: Any = (0.0, 0.0, -20.0), seconds: float = 60.0, **fleet: Any) -> dict[str, Any]:
    own = {"controller": {"type": "cascade", "feed": "truth"}, "ground": "parked", **fleet}
    vehicle = {"position_ned": list(start), "legs": list(legs)}
    return {
        "name": "mission",
        "duration": seconds,
        "site": {"latitude_deg": HOME[0], "longitude_deg": HOME[1]},
        "fleets": {"a": {**own, "vehicles": [vehicle]}},
    }


def to(north: float, east: float, down: float, **more: Any) -> dict[str, Any]:
    return {"to_ned": [north, east, down], **more}


TAKE_OFF, LAND = {"type": "take_off", "height": 30.0}, {"type": "land"}


@pytest.mark.parametrize(
    ("legs", "more", "expected"),
    [
        ([{"to_nde": [1.0, 2.0, -3.0]}], {}, "legs.0.to_nde: no such parameter of 'fly'; did you mean 'to_ned'?"),
        ([{"type": "fyl"}], {}, "legs.0.type: no such type 'fyl'; did you mean 'fly'?"),
        ([{}], {}, "legs.0: the place is missing; give to_ned or to_geodetic"),
        ([to(0.0, 0.0, -9.0, yaw_deg=5.0, facing_ned=[0.0, 0.0])], {}, "gives both 'yaw_rad' and 'facing_ned'"),
        ([to(0.0, 0.0, -9.0, speed=0.0)], {}, "legs.0.speed: 0.0 is out of range; allowed: above 0, at most 50"),
        ([{"type": "loiter", "time": 1.0, "turns": 1.0}], {}, "legs.0: gives both 'time' and 'turns'; give one"),
        ([{"type": "loiter", "turns": 1.0}], {}, "legs.0: gives 'turns' without a circle; give 'radius' too"),
        ([{"type": "loiter"}, LAND], {}, "legs.1: is never flown, because legs.0, a loiter, does not end"),
        ([LAND, to(1.0, 0.0, -9.0)], {}, "legs.1: legs.0 has landed; the next leg must be of type take_off"),
        ([LAND], {"ground": "stop"}, "legs.0: lands, but touching the ground ends the flight of this fleet; set "),
        ([{"type": "take_off", "height": 5.0}], {}, "legs.0.height: 5 m is not above the vehicle, which is at 20 m"),
        ([to(0.0, 0.0, 3.0)], {}, "legs.0: z = 3 m is outside world.area; allowed: -120 to 0"),
        ([to(0.0, 0.0, -500.0)], {}, "legs.0: z = -500 m is outside world.area; allowed: -120 to 0"),
        ([{"type": "loiter", "turns": 1.0, "radius": 9e3}], {}, "legs.0: x = 9000 m is outside world.area"),
        ([TAKE_OFF], {"guidance": {"type": "route"}}, "legs: the guidance 'route' flies no legs"),
        ([TAKE_OFF], {"placement": {"type": "uniform"}}, "'uniform' does not go with the guidance 'mission'"),
    ],
)
def test_what_cannot_be_flown_is_said_in_one_line(legs: list[Any], more: dict[str, Any], expected: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(expected)) as caught:
        load_scenario(scenario(*legs, **more))
    assert len(caught.value.problems) == 1


def test_legs_are_kept_in_ned_and_fly_by_default() -> None:
    place = {"latitude_deg": HOME[0], "longitude_deg": HOME[1], "height": 25.0}
    loaded = load_scenario(scenario({"to_geodetic": place, "yaw_deg": 90.0}, {"type": "loiter"}))
    (vehicle,) = loaded.spec.fleets["a"].vehicles
    assert loaded.spec.fleets["a"].guidance.type == "mission"
    assert vehicle.legs[0].to_ned == pytest.approx([0.0, 0.0, -25.0], abs=1e-6)
    assert vehicle.legs[0].yaw_rad == pytest.approx(np.pi / 2)
    again = load_scenario(json.loads(json.dumps(loaded.spec.model_dump(mode="json"))))
    assert again.spec == loaded.spec


def plan_item(command: int, params: list[Any], frame: int = 3) -> dict[str, Any]:
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": params, "autoContinue": True}


@pytest.fixture
def planned(tmp_path: Path) -> str:
    """Write a plan: up, faster to a place with a hold, round a circle and back; a camera on the way."""
    north = [HOME[0] + 40.0 / 111_170.0, HOME[1]]
    items = [
        plan_item(22, [0, 0, 0, None, *HOME, 15]),
        plan_item(178, [1, 4.0, -1, 0, 0, 0, 0], 2),
        plan_item(206, [25, 0, 1, 0, 0, 0, 0], 2),
        plan_item(16, [2, 1.5, 0, 90, *north, 20]),
        plan_item(115, [180, 0, 0, 0, 0, 0, 0], 2),
        plan_item(18, [1, 0, -8, 0, *north, 20]),
        plan_item(2000, [0, 0, 1, 0, 0, 0, 0], 2),
        plan_item(206, [0, 0, 1, 0, 0, 0, 0], 2),
        plan_item(20, [0, 0, 0, 0, 0, 0, 0], 2),
    ]
    mission = {"version": 2, "plannedHomePosition": [*HOME, 0.0], "items": items}
    path = tmp_path / "field.plan"
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    return str(path)


def test_a_plan_is_flown_and_not_ignored(planned: str) -> None:
    content = scenario(seconds=120.0)
    content["fleets"]["a"] = {
        "controller": {"type": "cascade", "feed": "truth"},
        "vehicles": [{"plan": {"file": planned}}],
    }
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        loaded = load_scenario(content)
    assert [str(warning.message) for warning in caught] == [
        f"{planned}: not carried out: DO_SET_CAM_TRIGG_DIST (items 3, 8), IMAGE_START_CAPTURE (item 7)"
    ]
    fleet = loaded.spec.fleets["a"]
    assert (fleet.guidance.type, fleet.ground, fleet.vehicles[0].position_ned) == ("mission", "parked", [0.0, 0.0, 0.0])
    assert [(leg.type, leg.item, leg.speed) for leg in fleet.vehicles[0].legs] == [
        ("take_off", 1, None),
        ("fly", 4, 4.0),
        ("loiter", 6, 4.0),
        ("land", 9, 4.0),
    ]
    simulation = Simulation(loaded.world(), seed=1, name="planned")
    simulation.reset()
    flown = simulation.record(6000).state.fleets[0]
    assert simulation.compiled_by == ("llvm", "")
    assert flown.guidance.finished[-1, 0]
    assert flown.guidance.reached[-1, 0] == 4
    north, east, down = (np.asarray(getattr(flown.vehicle.position_ned, axis))[:, 0] for axis in "xyz")
    speed = np.hypot(np.diff(north), np.diff(east)) / 0.02
    assert 3.8 < speed.max() < 4.6
    arm = np.hypot(north - 40.0, east)
    on_circle = (flown.guidance.index[:, 0] == 3) & (arm > 6.0)
    assert on_circle.sum() * 0.02 > 2.0 * np.pi * 8.0 / 4.0
    assert arm[on_circle] == pytest.approx(8.0, abs=0.6)
    assert np.hypot(north[-1], east[-1]) < 0.5
    assert down[-1] == 0.0
    # Idle motors: throttle 0.
    assert float(flown.command.throttle[-1, 0]) == 0.0


def test_legs_from_one_on_are_flown_for_ever(tmp_path: Path) -> None:
    """Up, then a triangle of 12 m sides: 4 m/s take 3 s a side and more; a plan with a jump for ever is the same."""
    corners = [to(12.0, 0.0, -20.0), to(6.0, 10.4, -20.0), to(0.0, 0.0, -20.0)]
    content = scenario({"type": "take_off", "height": 20.0}, *corners, seconds=40.0)
    vehicle = content["fleets"]["a"]["vehicles"][0]
    vehicle["repeat_from"] = 1
    loaded = load_scenario(content)
    simulation = Simulation(loaded.world(), seed=1, name="for_ever")
    simulation.reset()
    now = simulation.record(2000).state.fleets[0]
    # Three sides, and the three that are repeated; it is up already.
    assert set(now.guidance.index[:, 0].tolist()) == {1, 2, 3, 4, 5, 6}
    assert (np.diff(now.guidance.index[:, 0]) < 0).sum() >= 1
    assert not now.guidance.finished.any()
    vehicle["repeat_from"] = 4
    with pytest.raises(ScenarioError, match=r"fleets.a.vehicles.0.repeat_from: is 4; allowed: below 4, the number of"):
        load_scenario(content)
    places = [[HOME[0] + 1e-4 * i, HOME[1], 20] for i in range(3)]
    items = [plan_item(16, [0, 0, 0, None, *place]) for place in places]
    mission = {"version": 2, "plannedHomePosition": [*HOME, 0.0], "items": [*items, plan_item(177, [2, -1, *[0] * 5])]}
    path = tmp_path / "loop.plan"
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    del content["fleets"]["a"]["vehicles"][0]
    content["fleets"]["a"]["vehicles"] = [{"plan": str(path)}]
    (planned,) = load_scenario(content).spec.fleets["a"].vehicles
    assert ([leg.item for leg in planned.legs], planned.repeat_from) == ([1, 2, 3, 2, 3], 3)


@pytest.mark.long
def test_a_run_tells_of_its_missions(tmp_path: Path) -> None:
    """Leg 2 of the first is 40 m away, and the run ends on the way; the third never comes as near as it is to come."""
    guidance = {"type": "mission", "leg_timeout": 2.0}
    content = scenario(to(0.0, 0.0, -22.0, stop=True), to(40.0, 0.0, -22.0), seconds=9.0, guidance=guidance)
    content["fleets"]["a"]["vehicles"] += [
        {"position_ned": [0.0, 50.0, -20.0], "legs": [to(5.0, 50.0, -20.0)]},
        {"position_ned": [0.0, 90.0, -20.0], "legs": [to(5.0, 90.0, -20.0, accept_radius=1e-4)]},
        # These two meet on the way, and then tell of no leg any more.
        {"position_ned": [0.0, 130.0, -20.0], "legs": [to(0.0, 140.0, -20.0, accept_radius=1e-4)]},
        {"position_ned": [0.0, 134.0, -20.0], "legs": [to(0.0, 124.0, -20.0, accept_radius=1e-4)]},
    ]
    fly(load_scenario(content), tmp_path / "run", seed=1, precision="float32")
    run = open_run(tmp_path / "run")
    told = {(event.vehicle, event.kind): event for event in run.events}
    late = told["a_0", "mission_unfinished"]
    assert (late.field, late.value) == ("leg", 2.0)
    said = r"a_0 has not finished its mission, it is at leg 2 of 2, to north 40 m, east 0 m, 22 m up: [\d.]+ m to go; "
    assert re.match(said + r"reached within 2 m, at 9.00 s", late.message)
    assert ("a_0", "leg_timeout") not in told
    assert told["a_1", "mission_finished"].message.startswith("a_1 finished its mission, at ")
    said = r"a_2 has not reached leg 1 of 1, to north 5 m, east 90 m, 20 m up: [\d.]+ m to go; "
    assert re.match(said + r"reached within 0.0001 m, at ", told["a_2", "leg_timeout"].message)
    for name in ("a_3", "a_4"):
        assert {kind for vehicle, kind in told if vehicle == name} == {"collision"}
    assert [summary.stopped for summary in summarise(run)][:3] == ["", "", ""]
    assert [summary.waypoints for summary in summarise(run)] == [1, 1, 0, 0, 0]


@pytest.mark.long
def test_a_leg_that_takes_too_long_says_why(tmp_path: Path) -> None:
    """Wind of 14 m/s at 20 ft carries the vehicle away: the path waits, and it is told once."""
    guidance = {"type": "mission", "leg_timeout": 2.0}
    content = scenario(to(3.0, 0.0, -20.0), seconds=15.0, guidance=guidance)
    content["world"] = {"wind": {"type": "log_shear", "speed_20ft": 14.0, "wind_from_deg": 0.0}}
    with pytest.warns(UserWarning, match="world.wind"):
        loaded = load_scenario(content)
    fly(loaded, tmp_path / "run", seed=1, precision="float32")
    told = [event for event in open_run(tmp_path / "run").events if event.kind == "leg_timeout"]
    assert len(told) == 1
    said = r"a_0 has not reached leg 1 of 1, to north 3 m, east 0 m, 20 m up: [\d.]+ m to go, [\d.]+ m from the path, "
    assert re.match(said + r"which waits from 2 m on, at [\d.]+ s", told[0].message)
