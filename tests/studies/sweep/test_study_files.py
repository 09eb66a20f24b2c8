"""Studies as they are written: what is wrong is said before anything is flown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.studies.sweep.killing import SMALL

from qrsim.errors import QrsimError
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.sweep.prepare import plan_of
from qrsim.studies.sweep.study import built_in_studies, load_study

WIND = "world.wind.speed_20ft"
RANGE = {"low": 0.0, "high": 5.0}


def complaint(path: Path) -> str:
    with pytest.raises(QrsimError) as caught:
        plan_of(load_study(str(path)))
    assert caught.value.exit_code == 2
    return str(caught.value)


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"vary": {"world.wind.sped_20ft": RANGE | {"count": 3}}},
         ["vary.world.wind.sped_20ft", "no such parameter of 'log_shear'", "did you mean 'speed_20ft'?"]),
        ({"vary": {"fleets.pelican.vehicle.mass": {"values": [1.5]}}}, ["no fleet is called", "'pelicans'"]),
        ({"vary": {WIND: {"low": -4.0, "high": 4.0, "count": 5}, "duration": {"values": [1.0, 2.0, -1.0]}}},
         ["9 of 15 points", "-4.0: ", "-2.0: ", "allowed: 0 to 50", "duration: -1.0", "nothing was flown"]),
        ({"vary": {WIND: {"low": -4.0, "high": 4.0, "count": 2001}}},
         ["1000 of 2001 points", "-4.0: ", "... and 995 more of its 2001 values"]),
        ({"vary": {WIND: {"low": -1.0, "high": 5.0}}, "sampling": {"type": "sobol", "points": 8}},
         [f"vary.{WIND}: -1.0", "nothing was flown"]),
        ({"vary": {"fleets.pelicans.vehicles.count": {"values": [1, 2]}}}, ["2", "allowed: 1 to 1"]),
        ({"vary": {"fleets.pelicans.battery.voltage_empty": {"values": [9.5, 11.5]},
                   "fleets.pelicans.battery.voltage_full": {"values": [11.0, 12.0]}},
          "set": {"fleets.pelicans.battery": {"type": "lithium_polymer"}}},
         ["do not go together, nothing was flown", "voltage_empty = 11.5", "voltage_full = 11.0"]),
        ({"vary": {WIND: RANGE}}, ["sampling: missing", WIND]),
        ({"sampling": {"type": "sobol", "points": 4}}, ["no parameter has a range"]),
        ({"vary": {"fleets.pelicans.sensors.gnss.period": {"low": 0.2, "high": 0.4}},
          "sampling": {"type": "sobol", "points": 4}}, ["changes what is compiled", "give values"]),
        ({"sampling": {"type": "saltelli", "points": 12}, "vary": {WIND: RANGE}}, ["12 is not a power of 2"]),
        ({"vary": {WIND: {"low": 3.0, "high": 1.0, "count": 2}}}, ["low, 3, is not below high, 1"]),
        ({"vary": {WIND: {"values": [1.0, 1.0]}}}, ["a value is given twice"]),
        ({"metrics": ["tracking_eror_rms_m"]}, ["tracking_eror_rms_m", "did you mean 'tracking_error_rms_m'?"]),
        ({"metrics": ["persons_found"]}, ["'persons_found' is of a task"]),
        ({"sede": 3}, ["no such parameter of 'study'", "did you mean 'seeds'?"]),
        ({"seeds": None}, ["seeds: missing"]),
        ({"scenario": "hoover"}, ["no scenario is called 'hoover'", "did you mean 'hover'?"]),
        ({"policy": "baseline", "estimator": "x:y"}, ["'baseline' has no estimator"]),
        ({"policy": "no_such.py:fly"}, ["policy", "there is no file", "no_such.py"]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_place(
    study: Callable[..., Path], changes: dict[str, Any], parts: list[str]
) -> None:
    said = complaint(study(**changes))
    for part in parts:
        assert part in said, said


def test_a_study_is_looked_for_by_name_and_by_file(tmp_path: Path) -> None:
    with pytest.raises(QrsimError, match="no study is called 'station_keping'; did you mean 'station_keeping'"):
        load_study("station_keping")
    with pytest.raises(QrsimError, match="no such file"):
        load_study(str(tmp_path / "none.yaml"))


def test_a_scenario_in_place_of_a_study_and_the_other_way_round(study: Callable[..., Path], tmp_path: Path) -> None:
    path = tmp_path / "field.yaml"
    path.write_text("name: field\nextends: hover\n", encoding="utf-8")
    with pytest.raises(QrsimError, match="is a scenario and no study; a study has scenario: FILE, vary, seeds and met"):
        load_study(str(path))
    with pytest.raises(QrsimError, match=r"is a study and no scenario: 'qrsim sweep .*' flies it"):
        load_scenario(study())
    path.write_text("name: none\nseeds: 3\n", encoding="utf-8")
    with pytest.raises(QrsimError, match="scenario: missing"):
        load_study(str(path))


@pytest.mark.parametrize("name", built_in_studies())
def test_every_study_that_comes_with_qrsim_can_be_planned(name: str) -> None:
    plan = plan_of(load_study(name, values=2))
    assert plan.episodes > 0
    assert plan.study.spec.description


def test_settings_tell_studies_apart_and_words_do_not(study: Callable[..., Path]) -> None:
    digest = load_study(str(study())).digest
    assert load_study(str(study(description="said otherwise"))).digest == digest
    assert load_study(str(study(failure={"metric": "tracking_error_max_m", "above": 9.0}))).digest == digest
    for changes in ({"seeds": 6}, {"first_seed": 1}, {"set": {"duration": 2.0}}, {"precision": "float64"}):
        assert load_study(str(study(**changes))).digest != digest


def test_a_policy_that_is_changed_makes_another_study(study: Callable[..., Path], tmp_path: Path) -> None:
    policy = tmp_path / "mine.py"
    digests = set()
    for gain in (1, 2):
        policy.write_text(f"def fly(reading):\n    return {gain} and None\n")
        digests.add(load_study(str(study(policy="mine.py:fly"))).digest)
    assert len(digests) == 2


def test_policies_of_teams_are_told_apart_by_their_files(study: Callable[..., Path], tmp_path: Path) -> None:
    one, other = tmp_path / "one.py", tmp_path / "other.py"
    one.write_text("def fly(reading):\n    return None\n")
    digests = set()
    for answer in ("None", "{}"):
        other.write_text(f"def fly(reading):\n    return {answer}\n")
        found = load_study(str(study(policy={"pelicans": "one.py:fly", "pelicans_0": "other.py:fly"})))
        assert found.spec.policy == f"pelicans={one}:fly,pelicans_0={other}:fly"
        digests.add(found.digest)
    assert len(digests) == 2
    assert "has no 'fli'" in complaint(study(policy={"pelicans": "one.py:fli"}))


def test_the_command_line_makes_a_study_small(study: Callable[..., Path]) -> None:
    small = load_study(str(study()), {"seeds": 2}, ["duration=0.5"], 2)
    assert small.spec.seeds == 2
    assert small.spec.vary[WIND].values == [0.0, 4.0]
    assert small.spec.vary["fleets.pelicans.vehicle.mass"].count == 2
    assert plan_of(small).groups[()].ticks == 25
    assert SMALL["seeds"] == 5


@pytest.mark.parametrize("name", ["station_keeping", "swarm_collisions"])
def test_studies_of_flights_outdoors_fly_what_the_default_scenario_flies(name: str) -> None:
    world = load_scenario(load_study(name).content, quiet=True).world()
    [fleet] = world.fleets
    assert type(world.turbulence).__name__ == "DrydenField"
    assert set(fleet.sensor_names) == {"gnss", "imu", "magnetometer", "barometer"}
    assert type(fleet.controller).__name__ == "CascadeController"
    assert fleet.own_estimator is not None


def test_a_search_in_wind_flies_it_too() -> None:
    """With the camera of the task, and sinking as fast as the task may ask for."""
    world = load_scenario(load_study("search_in_wind").content, quiet=True).world()
    [fleet] = world.fleets
    assert type(world.turbulence).__name__ == "DrydenField"
    assert (
        type(world.sky.errors).__name__ == type(load_scenario("outdoor_patrol", quiet=True).world().sky.errors).__name__
    )
    assert set(fleet.sensor_names) == {"gnss", "imu", "magnetometer", "barometer", "camera"}
    assert type(fleet.controller).__name__ == "CascadeController"
    assert fleet.own_estimator is not None
    assert float(fleet.controller.sink_limit) == 3.0


def test_what_station_keeping_was_is_kept() -> None:
    """The published measurements of sweeps are of it."""
    content = load_study("station_keeping_plain").content
    assert content["world"]["turbulence"]["type"] == "dryden_first_order"
    assert content["fleets"]["pelicans"]["controller"] == {"type": "waypoint", "feed": "measurements"}
    assert plan_of(load_study("station_keeping_plain")).episodes == 10_000
