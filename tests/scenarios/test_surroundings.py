"""Orbits, wind, obstacles and batteries of a scenario, held against its run: each misfit by path and value."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from tests.models.gnss.sp3_writing import line_of, sp3_text

from qrsim.errors import ScenarioError
from qrsim.scenarios.scenario import load_scenario

# The files below cover 15:00 to 19:45 GPS time on this day, 15 s earlier in UTC.
DURING = datetime(2010, 8, 31, 17, tzinfo=UTC)
BOX = {"type": "box", "x_min": 10.0, "x_max": 20.0, "y_min": -5.0, "y_max": 5.0, "z_min": -30.0}


def scenario(world: dict[str, Any] | None = None, start_time: datetime = DURING, **fleet: Any) -> dict[str, Any]:
    basic = {"controller": {"type": "waypoint", "feed": "truth"}, "vehicles": [{"position_ned": [0.0, 0.0, -10.0]}]}
    fleets = {"a": {**basic, **fleet}}
    return {"name": "x", "duration": 60.0, "start_time": start_time, "world": world or {}, "fleets": fleets}


def problems_of(content: dict[str, Any]) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content)
    return caught.value.problems


@pytest.fixture
def orbits(tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """Return a function that writes an SP3 file and returns the world that uses it."""

    def write(text: str, name: str = "orbits.sp3") -> dict[str, Any]:
        (tmp_path / name).write_text(text)
        return {"sky": {"orbits": {"type": "sp3", "file": str(tmp_path / name)}}}

    return write


HAND_LIST = {"gnss": {"type": "gnss_receiver", "satellites": "hand_list"}}


def test_a_run_outside_the_orbits(orbits: Any) -> None:
    covered = "is outside the time of world.sky.orbits; allowed: 2010-08-31 14:59:45 to 2010-08-31 19:44:45 UTC"
    for start in (datetime(2026, 6, 21, 10, tzinfo=UTC), datetime(2010, 8, 31, 19, 44, tzinfo=UTC)):
        (problem,) = problems_of(scenario(orbits(sp3_text()), start))
        assert problem == f"start_time: the run, {start:%Y-%m-%d %H:%M:%S} and 60 s, {covered}"
    load_scenario(scenario(orbits(sp3_text()), datetime(2010, 8, 31, 19, 43, 45, tzinfo=UTC)))


def test_a_run_beyond_the_cut_of_a_file_names_the_file_and_the_cut(orbits: Any) -> None:
    """Also where so little is left that nothing can be interpolated."""
    text = sp3_text()
    expected = {
        14: "start_time: the run, 2010-08-31 19:00:00 and 60 s, is outside the time of world.sky.orbits; allowed: ",
        5: "world.sky.orbits: ",
    }
    for epochs, start in expected.items():
        cut = line_of(text, "*", epochs) - 1
        world = orbits("\n".join(text.splitlines()[:cut]))
        (problem,) = problems_of(scenario(world, datetime(2010, 8, 31, 19, tzinfo=UTC)))
        assert problem.startswith(start)
        assert problem.endswith(f"orbits.sp3: no EOF line; the file may be cut off after line {cut}")


def test_a_missing_orbit_file_has_a_suggestion(orbits: Any, tmp_path: Path) -> None:
    world = orbits(sp3_text(), "igs15992.sp3")
    world["sky"]["orbits"]["file"] = str(tmp_path / "igs1599.sp3")
    (problem,) = problems_of(scenario(world))
    assert problem.startswith(f"world.sky.orbits: {tmp_path / 'igs1599.sp3'}: cannot be read: No such file")
    assert problem.endswith("; did you mean 'igs15992.sp3'?")


def test_the_hand_list_needs_satellites_with_numbers(orbits: Any) -> None:
    path = "fleets.a.sensors.gnss.satellites: "
    (problem,) = problems_of(scenario(sensors=HAND_LIST))
    assert problem.startswith(f"{path}'hand_list' names satellites by PRN, which the nominal constellation has not")
    # The file has G01 to G24, of the list all but 29 and 31.
    with pytest.warns(UserWarning, match="hand list") as caught:
        load_scenario(scenario(orbits(sp3_text()), sensors=HAND_LIST)).world()
    assert [str(warning.message) for warning in caught] == [
        f"{path}world.sky.orbits lacks the satellites 29, 31 of the hand list; receivers choose among 11 instead of 13"
    ]
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scenario(scenario(orbits(sp3_text(names=[f"G{i:02}" for i in range(1, 33)])), sensors=HAND_LIST)).world()


def test_a_wind_series_that_is_too_short(tmp_path: Path) -> None:
    (tmp_path / "wind.csv").write_text("time,north,east,down\n0,1,2,0\n5,1,2,0\n")
    world = {"wind": {"type": "series", "file": str(tmp_path / "wind.csv")}}
    said = "the series goes from 0 s to 5 s, which does not cover the run, 0 s to 60 s"
    assert problems_of(scenario(world)) == [f"world.wind: {tmp_path / 'wind.csv'}: {said}"]


@pytest.mark.parametrize(
    ("point", "where"),
    [([15.0, 0.0, -10.0], "inside"), ([10.0, 0.0, -10.0], "inside"), ([9.5, 0.0, -10.0], "0.5 m from")],
)
def test_starts_and_waypoints_keep_away_from_obstacles(point: list[float], where: str) -> None:
    said = f"{where} world.obstacles.0; allowed: at least 1 m from it (half of world.collision_distance)"
    vehicles = [{"position_ned": point}, {"position_ned": [0.0, 9.0, -9.0], "waypoints_ned": [[0.0, 0.0, -9.0], point]}]
    assert problems_of(scenario({"obstacles": [BOX]}, vehicles=vehicles)) == [
        f"fleets.a.vehicles.0.position_ned: {said}",
        f"fleets.a.vehicles.1.waypoints_ned.1: {said}",
    ]


def test_without_a_collision_distance_only_the_inside_is_refused() -> None:
    world = {"obstacles": [BOX], "collision_distance": 0.0}
    load_scenario(scenario(world, vehicles=[{"position_ned": [9.99, 0.0, -10.0]}]))
    (problem,) = problems_of(scenario(world, vehicles=[{"position_ned": [11.0, 0.0, -10.0]}]))
    assert problem.startswith("fleets.a.vehicles.0.position_ned: inside world.obstacles.0; ")


@pytest.mark.parametrize(
    ("full", "empty", "said"),
    [
        (9.5, 9.6, "voltage_full: 9.5 V; allowed: above voltage_empty, 9.6 V"),
        (9.6, 9.6, "voltage_full: 9.6 V; allowed: above voltage_empty, 9.6 V"),
        ([12.0, 9.1], 9.6, "voltage_full.1: 9.1 V; allowed: above voltage_empty, 9.6 V"),
        (11.0, [10.0, 11.5], "voltage_full: 11 V; allowed: above voltage_empty, 11.5 V"),
    ],
)
def test_a_battery_is_higher_when_full(full: Any, empty: Any, said: str) -> None:
    vehicles = [{"position_ned": [0.0, 9.0 * i, -9.0]} for i in range(2)]
    battery = {"type": "lithium_polymer", "voltage_full": full, "voltage_empty": empty}
    assert problems_of(scenario(vehicles=vehicles, battery=battery)) == [f"fleets.a.battery.{said}"]
