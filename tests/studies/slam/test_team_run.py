"""Cooperative SLAM on a run folder: what is read of it, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.errors import RunError, UsageError
from qrsim.runs.recorder import fly
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.slam.between import distances

PLACES = [[0.0, 0.0, -20.0], [10.0, 5.0, -19.0], [-10.0, 5.0, -21.0]]


def scenario(sensors: dict[str, Any]) -> dict[str, Any]:
    """Three Pelicans that fly 8 s towards each other's places, with further sensors."""
    vehicles = [{"position_ned": place, "waypoints_ned": [[-x for x in place[:2]] + [place[2]]]} for place in PLACES]
    return {
        "name": "three",
        "extends": "range_only_slam",
        "duration": 8.0,
        "world": {"collision_distance": 0.0},
        # They pass through each other, where wakes would be the strongest.
        "fleets": {"pelicans": {"vehicle": {"downwash": "ignored"}, "sensors": sensors, "vehicles": vehicles}},
    }


def flown(folder: Path, sensors: dict[str, Any]) -> Path:
    fly(load_scenario(scenario(sensors)), folder, seed=3, precision="float32")
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sensors = {"uwb": {"type": "ranging", "beacons": [], "noise_std": 0.05, "period": 0.2, "dropouts": 0.3}}
    return flown(tmp_path_factory.mktemp("team") / "run", sensors)


@pytest.mark.long
def test_ranges_between_the_vehicles_of_a_run_are_those_that_they_measured(run: Path) -> None:
    """Both of a pair measured, 70 % each: 0.05 m, where both did the mean of two."""
    found = qrsim.slam.cooperative_from_run(run, states="poses")
    assert found.converged
    assert found.position_ned.shape == (3, 81, 3)
    assert found.between.std == 0.05
    error = found.between.ranges - distances(found.truth_ned, found.between.pairs)
    assert np.isnan(error[1::2]).all()
    assert set(np.unique(found.between.counts[::2])) == {0.0, 1.0, 2.0}
    assert found.between.counts[::2].mean() == pytest.approx(2.0 * 0.7, abs=4.0 * np.sqrt(2.0 * 0.21 / 123.0))
    for count, std in ((1.0, 0.05), (2.0, 0.05 / np.sqrt(2.0))):
        of_count = error[found.between.counts == count]
        assert of_count.std() == pytest.approx(std, rel=4.0 / np.sqrt(2.0 * len(of_count)))
    apart = qrsim.slam.cooperative_from_run(run, states="poses", between="none")
    assert found.relative_rmse_m < 0.8 * apart.relative_rmse_m


@pytest.mark.long
def test_two_of_three_in_another_order(run: Path) -> None:
    found = qrsim.slam.cooperative_from_run(run, vehicles=["pelicans_2", "pelicans_0"], states="poses")
    assert found.truth_ned[:, 0, :2].tolist() == [[-10.0, 5.0], [0.0, 0.0]]
    error = found.between.ranges - distances(found.truth_ned, found.between.pairs)
    assert np.nanmax(np.abs(error)) < 5.0 * 0.05


@pytest.mark.long
def test_what_a_run_does_not_have_is_named(run: Path, tmp_path: Path) -> None:
    solve = qrsim.slam.cooperative_from_run
    cases: list[tuple[dict[str, Any], str]] = [
        ({"vehicles": []}, "vehicles: none"),
        ({"vehicles": ["pelicans_0", "pelicans_0"]}, "'pelicans_0' is there twice"),
        ({"vehicles": ["pelicans_0", "pelican_1"]}, "no vehicle 'pelican_1'; did you mean 'pelicans_1'"),
        ({"between": "measure"}, "between: 'measure' is not known"),
        ({"between_std": -1.0}, "between_std: -1.0 is not a positive number"),
        ({"common_share": 2.0, "bias_time_constant": 9.0}, "common_share: 2.0"),
        ({"own_time_constant": -3.0, "bias_time_constant": 9.0}, "own_time_constant: -3.0 is not a positive number"),
        ({"seed": -1}, "seed: -1 is negative"),
        ({"ranges": [[[0.0, 0.0, 20.0]]], "landmarks_guess_ned": [[0.0, 0.0, 0.0]]}, "tables of 1 vehicles for 3"),
    ]
    for options, reason in cases:
        with pytest.raises(UsageError, match=reason):
            solve(run, **options)
    blind = flown(tmp_path / "blind", {})
    with pytest.raises(RunError, match=r"no ranges between pelicans_0, .*; give them a sensor \{type: ranging"):
        solve(blind)
    assert solve(blind, between="simulated", states="poses").between.counts.any()
    often = flown(tmp_path / "often", {"uwb": {"type": "ranging", "beacons": [], "period": 0.1}})
    with pytest.raises(UsageError, match=r"ranges every 0\.1 s are not all at states every 0\.2 s"):
        solve(often, state_period=0.2)
