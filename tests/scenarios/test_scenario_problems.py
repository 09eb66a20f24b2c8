"""Every bad input of a scenario: the message has its exact path, the value and what was allowed."""

from __future__ import annotations

import copy
import json
import math
import sys
from pathlib import Path
from typing import Any

import pytest

from qrsim.errors import ScenarioError, did_you_mean
from qrsim.scenarios import problems
from qrsim.scenarios.scenario import load_scenario


class _Removed:
    def __repr__(self) -> str:
        return "removed"


REMOVED = _Removed()


def valid() -> dict[str, Any]:
    return {
        "name": "valid",
        "duration": 1.0,
        "world": {
            "area": {"type": "box"},
            "wind": {"type": "log_shear", "speed_20ft": 5.0, "wind_from_deg": 200.0},
            "turbulence": {"type": "dryden_first_order"},
            "sky": {"errors": {"type": "ou"}},
        },
        "fleets": {
            "alpha": {
                "vehicle": {"type": "pelican"},
                "controller": {"type": "waypoint", "height": {"kp": 0.03}},
                "guidance": {"type": "route"},
                "limits": {"pitch": 1.0},
                "sensors": {
                    "gnss": {"type": "gnss_receiver"},
                    "barometer": {"type": "barometer"},
                    "attitude": {"type": "attitude_estimator"},
                },
                "vehicles": [
                    {"name": "one", "position_ned": [0.0, 0.0, -10.0], "yaw_deg": 90.0},
                    {"position_ned": [10.0, 0.0, -10.0], "waypoints_ned": [[1.0, 2.0, -3.0]]},
                ],
            }
        },
    }


def changed(*changes: tuple[str, Any]) -> dict[str, Any]:
    """Return the valid scenario with values at dotted paths replaced, added or removed."""
    content = valid()
    for path, value in changes:
        *way, last = path.split(".")
        target: Any = content
        for part in way:
            target = target[int(part)] if isinstance(target, list) else target.setdefault(part, {})
        key: Any = int(last) if isinstance(target, list) else last
        if value is REMOVED:
            del target[key]
        else:
            target[key] = value
    return content


def problems_of(content: Any) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content)
    assert str(caught.value).startswith(f"scenario: {len(caught.value.problems)} problem")
    return caught.value.problems


def test_the_scenario_that_is_broken_below_is_valid() -> None:
    before = valid()
    content = copy.deepcopy(before)
    load_scenario(content)
    assert content == before, "loading must not change what it is given"


# (path that is changed, new value, start of the sentence that is expected)
ONE_FAULT: list[tuple[str, Any, str]] = [
    # unknown parameters, with the nearest known one
    ("nme", "x", "nme: no such parameter of 'scenario'; did you mean 'name'?"),
    ("world.wnd", {}, "world.wnd: no such parameter of 'world'; did you mean 'wind'?"),
    ("world.sky.perod", 1.0, "world.sky.perod: no such parameter of 'sky'; did you mean 'period'?"),
    ("site.latitude", 51.0, "site.latitude: no such parameter of 'site'; did you mean 'latitude_deg'?"),
    (
        "world.wind.sped_20ft",
        3.0,
        "world.wind.sped_20ft: no such parameter of 'log_shear'; did you mean 'speed_20ft'?",
    ),
    (
        "world.wind.wind_form_deg",
        3.0,
        "world.wind.wind_form_deg: no such parameter of 'log_shear'; did you mean 'wind_from_deg'?",
    ),
    (
        "fleets.alpha.vehicels",
        [],
        "fleets.alpha.vehicels: no such parameter of 'fleet'; did you mean 'vehicles'?",
    ),
    (
        "fleets.alpha.vehicle.mas",
        1.0,
        "fleets.alpha.vehicle.mas: no such parameter of 'pelican'; did you mean 'mass'?",
    ),
    (
        "fleets.alpha.controller.height.kpp",
        1.0,
        "fleets.alpha.controller.height.kpp: no such parameter of 'height'; did you mean 'kp'?",
    ),
    (
        "fleets.alpha.limits.pich",
        1.0,
        "fleets.alpha.limits.pich: no such parameter of 'limits'; did you mean 'pitch'?",
    ),
    (
        "fleets.alpha.sensors.gnss.perid",
        1.0,
        "fleets.alpha.sensors.gnss.perid: no such parameter of 'gnss_receiver'; did you mean 'period'?",
    ),
    (
        "fleets.alpha.vehicles.1.waypoints",
        [],
        "fleets.alpha.vehicles.1.waypoints: no such parameter of 'vehicle'; did you mean 'waypoints_ned'?",
    ),
    # unknown types
    ("world.wind.type", "log_sheer", "world.wind.type: no such type 'log_sheer'; did you mean 'log_shear'?"),
    ("world.wind.type", 5, "world.wind.type: no such type '5'; known: calm, log_shear"),
    (
        "fleets.alpha.faults",
        [{"type": "rotr", "rotor": 1, "at": 2.0}],
        "fleets.alpha.faults.0.type: no such type 'rotr'; did you mean 'rotor'?",
    ),
    (
        "fleets.alpha.vehicle.type",
        "pelikan",
        "fleets.alpha.vehicle.type: no such type 'pelikan'; did you mean 'pelican'?",
    ),
    ("world.area.type", "sphere", "world.area.type: no such type 'sphere'; known: box"),
    (
        "fleets.alpha.sensors.gnss.type",
        "gnss_reciever",
        "fleets.alpha.sensors.gnss.type: no such type 'gnss_reciever'; did you mean 'gnss_receiver'?",
    ),
    ("world.wind.type", REMOVED, "world.wind.type: missing; it names what this is: calm, log_shear"),
    ("fleets.alpha.vehicle", {"mass": "heavy"}, "fleets.alpha.vehicle.mass: 'heavy' is not a number"),
    ("world.wind", [4.0], "world.wind: expected keys and values, found [4.0]"),
    (
        "fleets.alpha.vehicle",
        "drone",
        "fleets.alpha.vehicle.type: no such type 'drone'; did you mean 'rover'?",
    ),
    # out of bounds
    ("world.wind.speed_20ft", -1.0, "world.wind.speed_20ft: -1.0 is out of range; allowed: 0 to 50 ("),
    ("world.wind.speed_20ft", 51, "world.wind.speed_20ft: 51 is out of range; allowed: 0 to 50 ("),
    ("world.wind.wind_from_deg", 900, "world.wind.wind_from_deg: 900 is out of range; allowed: -360 to 360 ("),
    ("fleets.alpha.vehicle.mass", 0.0, "fleets.alpha.vehicle.mass: 0.0 is out of range; allowed: above 0 ("),
    ("fleets.alpha.vehicle.kw", 0.1, "fleets.alpha.vehicle.kw: 0.1 is out of range; allowed: at most 0 ("),
    (
        "fleets.alpha.limits.pitch",
        2.0,
        "fleets.alpha.limits.pitch: 2.0 is out of range; allowed: above 0, at most 1.57",
    ),
    (
        "fleets.alpha.controller.height.hover_throttle",
        1.5,
        "fleets.alpha.controller.height.hover_throttle: 1.5 is out of range; allowed: 0 to 1 (",
    ),
    ("fleets.alpha.sensors.gnss.delay", 51, "fleets.alpha.sensors.gnss.delay: 51 is out of range; allowed: 0 to 50 ("),
    (
        "fleets.alpha.sensors.gnss.elevation_mask_deg",
        91.0,
        "fleets.alpha.sensors.gnss.elevation_mask_deg: 91 is out of range; allowed: 0 to 90 (",
    ),
    ("world.sky.errors.std", -1.0, "world.sky.errors.std: -1.0 is out of range; allowed: at least 0 ("),
    ("duration", -1.0, "duration: -1.0 is out of range; allowed: above 0, at most 10 000 000 ("),
    ("duration", 0, "duration: 0 is out of range; allowed: above 0, at most 10 000 000 ("),
    ("time_step", 0.2, "time_step: 0.2 is out of range; allowed: 0.0001 to 0.1 ("),
    ("site.latitude_deg", 91.0, "site.latitude_deg: 91.0 is out of range; allowed: -90 to 90 ("),
    # not finite
    ("world.wind.speed_20ft", math.nan, "world.wind.speed_20ft: nan is not a finite number ("),
    ("world.wind.wind_from_deg", math.inf, "world.wind.wind_from_deg: inf is not a finite number ("),
    ("world.collision_distance", math.inf, "world.collision_distance: inf is not a finite number ("),
    ("duration", math.inf, "duration: inf is not a finite number ("),
    (
        "fleets.alpha.vehicles.0.position_ned.1",
        -math.inf,
        "fleets.alpha.vehicles.0.position_ned.1: -inf is not a finite number (",
    ),
    ("fleets.alpha.sensors.gnss.period", math.nan, "fleets.alpha.sensors.gnss.period: nan is not a finite number ("),
    # the wrong kind
    ("world.wind.speed_20ft", "5", "world.wind.speed_20ft: '5' is not a number ("),
    ("world.wind.speed_20ft", True, "world.wind.speed_20ft: True is not a number ("),
    ("world.wind.speed_20ft", None, "world.wind.speed_20ft: has no value ("),
    ("world.wind.wind_from_deg", "north", "world.wind.wind_from_deg: 'north' is not a number ("),
    ("fleets.alpha.sensors.gnss.delay", 1.5, "fleets.alpha.sensors.gnss.delay: 1.5 is not a whole number ("),
    ("fleets.alpha.guidance.repeat", "yes", "fleets.alpha.guidance.repeat: 'yes' is neither true nor false ("),
    ("fleets.alpha.guidance.repeat", 1, "fleets.alpha.guidance.repeat: 1 is neither true nor false ("),
    (
        "fleets.alpha.controller.feed",
        "thruth",
        "fleets.alpha.controller.feed: 'thruth' is not allowed; allowed: measurements, truth; did you mean 'truth'?",
    ),
    ("name", 3, "name: 3 is not a text ("),
    ("name", "a b", "name: 'a b' is no name; allowed: letters, digits and any of _ . -, a letter or digit first ("),
    ("name", "../x", "name: '../x' is no name; allowed: letters, digits and any of _ . -, a letter or digit first ("),
    ("fleets.alpha.vehicles.0.name", "", "fleets.alpha.vehicles.0.name: '' is no name; allowed: "),
    ("world", None, "world: expected keys and values, found nothing ("),
    ("fleets.alpha", None, "fleets.alpha: expected keys and values, found nothing ("),
    ("fleets.alpha.controller.height", 3, "fleets.alpha.controller.height: expected keys and values, found 3 ("),
    ("fleets.alpha.sensors", [], "fleets.alpha.sensors: expected keys and values, found [] ("),
    (
        "fleets.alpha.vehicles",
        {},
        "fleets.alpha.vehicles: expected a list, or rows with a count; found keys and values without one",
    ),
    ("fleets.alpha.vehicles", [], "fleets.alpha.vehicles: expected at least 1, found none ("),
    ("fleets", {}, "fleets: expected at least 1, found none ("),
    (
        "fleets.alpha.vehicles.0.position_ned",
        [1.0, 2.0],
        "fleets.alpha.vehicles.0.position_ned: expected 3 numbers, found 2 (",
    ),
    (
        "fleets.alpha.vehicles.0.position_ned",
        "here",
        "fleets.alpha.vehicles.0.position_ned: expected 3 numbers, found 'here' (",
    ),
    (
        "fleets.alpha.vehicles.1.waypoints_ned",
        [[1.0, 2.0, -3.0, 4.0]],
        "fleets.alpha.vehicles.1.waypoints_ned.0: expected 3 numbers, found 4 (",
    ),
    (
        "fleets.alpha.vehicles.1.waypoints_ned",
        [[1.0, 2.0, -3.0]] * 2001,
        "fleets.alpha.vehicles.1.waypoints_ned: expected at most 2000 entries, found 2001 (",
    ),
    (
        "start_time",
        "2026-06-21T10:00:00",
        "start_time: '2026-06-21T10:00:00' has no offset from UTC; write for example ",
    ),
    ("start_time", "noon", "start_time: 'noon' is not a date and time; write for example 2026-06-21T10:00:00Z ("),
    # missing
    ("name", REMOVED, "name: missing ("),
    ("fleets", REMOVED, "fleets: missing ("),
    ("fleets.alpha.vehicles", REMOVED, "fleets.alpha.vehicles: missing ("),
    (
        "fleets.alpha.vehicles.0.position_ned",
        REMOVED,
        "fleets.alpha.vehicles.0: the start is missing; give position_ned, position_geodetic or plan",
    ),
    ("world.wind.speed_20ft", REMOVED, "world.wind.speed_20ft: missing ("),
    ("world.wind.wind_from_deg", REMOVED, "world.wind.wind_from_rad: missing ("),
    # an angle in both units
    ("world.wind.wind_from_rad", 1.0, "world.wind: gives both 'wind_from_rad' and 'wind_from_deg'; give one"),
    ("fleets.alpha.vehicles.0.yaw_rad", 1.0, "fleets.alpha.vehicles.0: gives both 'yaw_rad' and 'yaw_deg'; give one"),
    # parts that do not fit each other
    ("duration", 0.03, "duration: 0.03 s is not a multiple of the time step 0.02 s"),
    ("world.sky.period", 0.05, "world.sky.period: 0.05 s is not a multiple of the time step 0.02 s"),
    (
        "fleets.alpha.sensors.barometer.period",
        0.03,
        "fleets.alpha.sensors.barometer.period: 0.03 s is not a multiple of the time step 0.02 s",
    ),
    (
        "fleets.alpha.sensors.gnss.period",
        0.3,
        "fleets.alpha.sensors.gnss.period: 0.3 s is not a multiple of world.sky.period, 0.2 s",
    ),
    (
        "fleets.alpha.vehicles.0.position_ned.0",
        5000.0,
        "fleets.alpha.vehicles.0.position_ned: x = 5000 m is outside world.area; allowed: -1000 to 1000",
    ),
    (
        "fleets.alpha.vehicles.1.waypoints_ned.0.2",
        3.0,
        "fleets.alpha.vehicles.1.waypoints_ned.0: z = 3 m is outside world.area; allowed: -120 to 0",
    ),
    (
        "fleets.alpha.vehicles.1.position_ned",
        [1.5, 0.0, -10.0],
        "fleets.alpha.vehicles.1.position_ned: starts 1.5 m from fleets.alpha.vehicles.0; allowed: at least 2 m",
    ),
    (
        "fleets.alpha.vehicles.1.name",
        "one",
        "fleets.alpha.vehicles.1.name: 'one' is also the name of fleets.alpha.vehicles.0",
    ),
    (
        "fleets.alpha.vehicles.0.name",
        "alpha_1",
        "fleets.alpha.vehicles.1.name: 'alpha_1' is also the name of fleets.alpha.vehicles.0",
    ),
    ("world.area.x_min", 1000.0, "world.area.x_min: 1000 m is not below x_max, 1000 m"),
    ("name", "a" * 101, f"name: {'a' * 101!r:.57}... is too long; allowed: at most 100 characters"),
    (
        "fleets.alpha.vehicles.0.name",
        "one/two",
        "fleets.alpha.vehicles.0.name: 'one/two' is no name; allowed: letters, digits and any of _ . -, a letter or "
        "digit first",
    ),
    (
        "fleets.alpha.vehicles.0.velocity_body",
        [0.0, -16.0, 0.0],
        "fleets.alpha.vehicles.0.velocity_body: v = -16 m/s; allowed: -15 to 15 (limits.velocity of the fleet)",
    ),
    (
        "fleets.alpha.sensors.barometer",
        REMOVED,
        "fleets.alpha.sensors: the controller is fed with measurements, but no sensor gives height; "
        "add one of type barometer, or set fleets.alpha.controller.feed to truth",
    ),
    (
        "fleets.alpha.sensors.process",
        {"type": "gyroscope"},
        "fleets.alpha.sensors.process: the name 'process' is taken by the simulator; choose another",
    ),
    *(
        (
            f"fleets.alpha.sensors.{name}",
            {"type": "gyroscope"},
            f"fleets.alpha.sensors.{name}: '{name}' is the name of another target of faults; choose another",
        )
        for name in ("battery", "radio", "link", "world", "rotor_1")
    ),
    (
        "fleets.alpha.sensors.my gyro",
        {"type": "gyroscope"},
        "fleets.alpha.sensors.my gyro: 'my gyro' is no name; allowed: letters, digits, '_' and '-'",
    ),
]


@pytest.mark.parametrize(("path", "value", "expected"), ONE_FAULT, ids=[f"{p}={v!r}"[:60] for p, v, _ in ONE_FAULT])
def test_a_bad_input_is_named_with_its_path_and_what_was_allowed(path: str, value: Any, expected: str) -> None:
    problems = problems_of(changed((path, value)))
    assert any(problem.startswith(expected) for problem in problems), problems
    # A fault of one parameter is not reported twice or under another path.
    if path != "world.area.x_min":
        assert len(problems) == 1, problems


@pytest.mark.parametrize(("value", "told"), [("7 m/s", True), ("-3.5deg", True), ("5", False), ("north", False)])
def test_a_number_with_its_unit_is_told_to_come_alone(value: str, told: bool) -> None:
    [problem] = problems_of(changed(("world.wind.speed_20ft", value)))
    assert problem.endswith("; write the number alone, without a unit") == told


def test_a_turbulence_with_nothing_to_inherit_says_where_it_would_have_come_from() -> None:
    problems = problems_of(changed(("world.wind", {"type": "calm"})))
    assert problems == [
        f"world.turbulence.{name}: missing; it would be taken from world.wind.{name}, "
        "but world.wind is 'calm', which has none; give it, or world.turbulence: still"
        for name in ("speed_20ft", "wind_from_rad")
    ]


def test_a_turbulence_that_brings_its_own_numbers_needs_no_wind() -> None:
    own = {"type": "dryden_first_order", "speed_20ft": 3.0, "wind_from_deg": 90.0}
    scenario = load_scenario(changed(("world.wind", {"type": "calm"}), ("world.turbulence", own)))
    assert scenario.spec.world.turbulence.speed_20ft == 3.0
    assert math.isclose(scenario.spec.world.turbulence.wind_from_rad, math.pi / 2)


def test_a_controller_fed_with_measurements_names_every_sensor_it_lacks() -> None:
    problems = problems_of(changed(("fleets.alpha.sensors", {})))
    assert len(problems) == 1
    assert "the fleet has no sensors; set sensors to noisy or ideal" in problems[0]
    rotation = {"type": "gyroscope"}
    problems = problems_of(changed(("fleets.alpha.sensors", {"rates": rotation})))
    assert [problem.partition("gives ")[2].partition(";")[0] for problem in problems] == [
        "position_ned",
        "height",
        "attitude",
    ]
    load_scenario(changed(("fleets.alpha.sensors", {}), ("fleets.alpha.controller.feed", "truth")))


def test_starts_of_different_fleets_are_compared_too() -> None:
    bravo = copy.deepcopy(valid()["fleets"]["alpha"])
    bravo["vehicles"] = [{"position_ned": [0.0, 1.0, -10.0]}]
    problems = problems_of(changed(("fleets.bravo", bravo)))
    assert problems == [
        "fleets.bravo.vehicles.0.position_ned: starts 1 m from fleets.alpha.vehicles.0; "
        "allowed: at least 2 m (world.collision_distance)"
    ]


def test_several_faults_are_reported_together() -> None:
    problems = problems_of(
        changed(
            ("duration", -1.0),
            ("world.wind.sped_20ft", 3.0),
            ("world.wind.speed_20ft", 99.0),
            ("fleets.alpha.vehicle.type", "pelikan"),
            ("fleets.alpha.vehicles.1.position_ned", [1.0]),
        )
    )
    paths = {problem.partition(":")[0] for problem in problems}
    assert paths == {
        "duration",
        "world.wind.sped_20ft",
        "world.wind.speed_20ft",
        "fleets.alpha.vehicle.type",
        "fleets.alpha.vehicles.1.position_ned",
    }


def test_thousands_of_faults_are_counted_and_the_first_are_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    """To look for the nearest name of each would take half a minute for a file of a megabyte."""
    asked: list[str] = []

    def counted(name: str, known: Any) -> str:
        asked.append(name)
        return did_you_mean(name, known)

    monkeypatch.setattr(problems, "did_you_mean", counted)
    content = valid()
    content["fleets"]["alpha"]["vehicles"] = [{"position_nde": [0.0, 0.0, -1.0]}] * 3000
    with pytest.raises(ScenarioError, match=r"0.position_nde: no such .*; did you mean 'position_ned'") as caught:
        load_scenario(content)
    assert len(caught.value.problems) == 3000
    assert len(asked) == 200
    assert str(caught.value).endswith("... and 2798 more like it")


def test_several_faults_between_parts_are_reported_together() -> None:
    problems = problems_of(
        changed(
            ("duration", 1.01),
            ("world.sky.period", 0.05),
            ("fleets.alpha.vehicles.0.position_ned.2", 5.0),
            ("fleets.alpha.vehicles.1.name", "one"),
        )
    )
    paths = [problem.partition(":")[0] for problem in problems]
    assert paths == [
        "duration",
        "world.sky.period",
        "fleets.alpha.vehicles.0.position_ned",
        "fleets.alpha.vehicles.1.name",
    ]


def test_the_meaning_of_a_parameter_is_given_in_the_unit_that_was_used() -> None:
    (in_degrees,) = problems_of(changed(("fleets.alpha.vehicles.0.yaw_deg", 400.0)))
    assert "allowed: -360.963 to 360.963" in in_degrees
    assert "[deg]" in in_degrees
    assert "[rad]" not in in_degrees
    (in_radians,) = problems_of(
        changed(("fleets.alpha.vehicles.0.yaw_deg", REMOVED), ("fleets.alpha.vehicles.0.yaw_rad", 7.0))
    )
    assert "allowed: -6.3 to 6.3" in in_radians
    assert "[rad]" in in_radians


def test_a_key_that_is_no_text_is_named() -> None:
    content: dict[Any, Any] = valid()
    content[5] = 3
    assert problems_of(content) == ["5: the key 5 is not a text"]


@pytest.mark.parametrize("period", [0.02, 0.04, 0.1, 0.3, 1.0, 7.0])
def test_a_period_of_many_steps_is_not_lost_to_rounding(period: float) -> None:
    load_scenario(changed(("fleets.alpha.sensors.barometer.period", period)))


# Inputs that once got through, or ended in a traceback, and why.
ONCE_GAPS: list[tuple[str, Any, str, str]] = [
    ("start_time", 1.5e9, "start_time: ", "a number is taken for seconds since 1970, although nothing is coerced"),
    ("start_time", "20260621", "start_time: ", "digits are taken for seconds since 1970, and the path is another"),
    (
        "fleets.alpha.sensors.sensors",
        {"type": "gyroscope"},
        "fleets.alpha.sensors.sensors: ",
        "FleetReading.sensors hides a sensor of this name (so do Reading.time and Reading.fleets with one fleet)",
    ),
    ("world.wind.wind_from_deg", 10**400, "world.wind.wind_from_deg: ", "OverflowError of math.radians"),
]


@pytest.mark.parametrize(
    ("path", "value", "start"),
    [pytest.param(path, value, start, id=f"{path}={value!r}"[:60]) for path, value, start, _ in ONCE_GAPS],
)
def test_no_bad_input_gets_through(path: str, value: Any, start: str) -> None:
    (problem,) = problems_of(changed((path, value)))
    assert problem.startswith(start)


def test_the_smallest_time_step_that_is_said_to_be_allowed_is_allowed() -> None:
    load_scenario(changed(("time_step", 1e-4)))


def test_an_extra_that_is_missing_is_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not of each of the buildings."""
    square = {"type": "Polygon", "coordinates": [[[9, 9], [9, 20], [20, 20], [9, 9]]]}
    building = {"type": "Feature", "properties": {"height": 9}, "geometry": square}
    (tmp_path / "block.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [building] * 3}))
    monkeypatch.setitem(sys.modules, "shapely", None)
    content = {
        "name": "x", "world": {"buildings": {"file": str(tmp_path / "block.geojson"), "frame": "local"}},
        "fleets": {"a": {"controller": {"type": "waypoint", "feed": "truth"},
                         "vehicles": [{"position_ned": [0.0, 0.0, -3.0]}]}},
    }  # fmt: skip
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content)
    (problem,) = caught.value.problems
    assert (
        "world.buildings.file: a file of buildings needs shapely: python -m pip install 'qrsim[buildings]'" in problem
    )
