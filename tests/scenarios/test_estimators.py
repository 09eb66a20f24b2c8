"""A fleet's estimator: what a scenario says, what is flown on, and what is logged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.cli import main
from qrsim.core.fastmath import wrap_angle
from qrsim.errors import ScenarioError, UsageError
from qrsim.runs import open_run
from qrsim.runs.estimate_figure import draw_estimate

EKF = "fleets.pelicans.estimator=ekf"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["fleets.pelicans.estimator=efk"], "did you mean 'ekf'"),
        (
            [EKF, "fleets.pelicans.sensors={baro: {type: barometer}}"],
            "the estimator is of type ekf, but no sensor gives rates_body; add one of type gyroscope, or leave out "
            "fleets.pelicans.estimator",
        ),
        ([EKF, "fleets.pelicans.estimator.gate=0"], "estimator.gate: 0 is out of range; allowed: above 0"),
        ([EKF, "fleets.pelicans.estimator.gate=[1, 2]"], "2 numbers in a list; allowed: 5, one for each vehicle"),
        ([EKF, "fleets.pelicans.estimator.ages=[]"], "ages"),
    ],
)  # fmt: skip
def test_what_is_refused(overrides: list[str], words: str):
    with pytest.raises(ScenarioError) as caught:
        qrsim.load_scenario("patrol_plain", overrides)
    assert words in str(caught.value)


def test_it_knows_how_late_fixes_are():
    """Those of the default scenario are one period of 0.2 s: ten ticks."""
    estimator = qrsim.load_scenario("patrol_plain", [EKF], quiet=True).world().fleets[0].own_estimator
    assert estimator is not None
    assert dict(estimator.ages)["gnss"] == 10


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short flight of two on the filter, recorded."""
    folder = tmp_path_factory.mktemp("ekf") / "run"
    words = ["--set", EKF, "--duration", "12", "--seed", "4", "--no-figure", "--out", str(folder)]
    assert main(["run", "patrol_plain", *words]) == 0
    return folder


def test_what_is_logged_is_of_the_same_tick_as_the_truth(flown: Path):
    """At 5 m/s a tick is 0.1 m; attitude and height err by less than the readings do."""
    run = open_run(flown)
    names = ["position_ned.z", "attitude.roll"]
    own = [f"estimate.{name}" for name in names]
    found = run["commands"].arrays([*own, "estimate_std.position_ned.x", "innovation.position_ned"])
    truth = run["truth"].arrays(names)
    late = run["commands"].time > 6.0
    assert np.abs(found["estimate.position_ned.z"] - truth["position_ned.z"])[late].max() < 1.2
    assert np.abs(found["estimate.attitude.roll"] - truth["attitude.roll"])[late].max() < 0.1
    std = found["estimate_std.position_ned.x"][late]
    # Two seconds of fixes of 1.5 m, five a second, each 0.2 s late.
    assert ((std > 0.1) & (std < 0.8)).all()
    assert (found["innovation.position_ned"][late] < 5.0).all()


@pytest.mark.long
def test_its_errors_are_drawn(flown: Path, capsys):
    figure = draw_estimate(open_run(flown), ["pelicans_1"])
    # Position, velocity, attitude, and two biases.
    assert [axes.get_visible() for axes in figure.axes] == [True] * 15
    assert "biases and fields as estimated" in figure.get_suptitle()
    assert "3 std as stated" in figure.get_suptitle()
    assert main(["plot", str(flown), "--panel", "estimate", "--panel", "truth.position_ned.z"]) == 2
    assert "a figure of its own" in capsys.readouterr().err


@pytest.mark.long
def test_a_controller_that_flies_on_the_truth_can_have_one_beside(tmp_path: Path):
    folder = tmp_path / "run"
    words = ["--set", EKF, "--set", "fleets.pelicans.controller.feed=truth", "--duration", "4", "--no-figure"]
    assert main(["run", "patrol_plain", *words, "--out", str(folder)]) == 0
    found = open_run(folder)["commands"].arrays(["estimate.position_ned.x"])["estimate.position_ned.x"]
    truth = open_run(folder)["truth"].arrays(["position_ned.x"])["position_ned.x"]
    assert 0.01 < np.abs(found - truth).max() < 8.0


@pytest.mark.long
def test_without_one_there_is_nothing_to_draw(tmp_path: Path):
    folder = tmp_path / "run"
    assert main(["run", "patrol_published", "--duration", "0.2", "--no-figure", "--out", str(folder)]) == 0
    with pytest.raises(UsageError, match="no estimate was recorded; a fleet has one with an estimator"):
        draw_estimate(open_run(folder))


@pytest.mark.long
def test_the_default_patrol_is_flown_on_it_in_wind():
    """8 m/s at 20 ft, five seeds of 120 s: nobody stops, and each flies 300 m at least."""
    scenario = qrsim.load_scenario("patrol_plain", [EKF, "world.wind.speed_20ft=8", "duration=120"], quiet=True)
    found = qrsim.rollout(scenario, seeds=range(5))
    assert np.asarray(found.metrics["flown_s"]) == pytest.approx(120.0)
    assert np.asarray(found.metrics["distance_m"]).min() > 300.0


def _yaws(sensors: str, seeds: int) -> np.ndarray:
    """Errors of the yaw and the std stated of it (seeds, T, 2) at every second of a hover of 120 s in 6 m/s."""
    overrides = [
        "fleets.pelicans.vehicles=[{position_ned: [0, 0, -20]}]",
        f"fleets.pelicans.sensors={{gnss: {{type: gnss_receiver}}, barometer: {{type: barometer}}, {sensors}}}",
        "fleets.pelicans.estimator={type: ekf}",
        "world.wind.speed_20ft=6",
        "duration=120",
    ]

    def look(state: Any) -> Any:
        fleet = state.fleets[0]
        error = fleet.belief.estimate.attitude.yaw - fleet.vehicle.attitude.yaw
        return jnp.stack([wrap_angle(error), fleet.belief.std.attitude.yaw])[:, 0]

    scenario = qrsim.load_scenario("patrol_plain", overrides, quiet=True)
    found = qrsim.rollout(scenario, seeds=range(seeds), record=look)
    assert np.asarray(found.metrics["flown_s"]) == pytest.approx(120.0)
    return np.asarray(found.recorded)


@pytest.mark.long
def test_a_magnetometer_holds_the_yaw_of_a_hover():
    """Within 3 std, which fall below 0.05 rad, those of the start; without one they rise above it, and it drifts."""
    held = _yaws("imu: {type: imu}, compass: {type: magnetometer}", 4)
    assert (np.abs(held[..., 0]) < 3.0 * held[..., 1]).all()
    assert (held[:, 30:, 1] < 0.035).all()
    lost = _yaws("imu: {type: imu}", 4)
    assert (lost[:, 30:, 1] > 0.08).all()
    assert (np.abs(lost[..., 0]) < 3.0 * lost[..., 1]).all(), "it says that it is lost"
    assert np.abs(lost[:, 30:, 0]).max() > 2.0 * np.abs(held[:, 30:, 0]).max()


@pytest.mark.long
def test_the_default_patrol_is_flown_on_a_magnetometer_in_wind():
    """8 m/s at 20 ft, three seeds of 120 s, on an inertial chip and a magnetometer and no reported attitude."""
    sensors = "gnss: {type: gnss_receiver}, barometer: {type: barometer}, imu: {type: imu}, m: {type: magnetometer}"
    overrides = [EKF, f"fleets.pelicans.sensors={{{sensors}}}", "world.wind.speed_20ft=8", "duration=120"]
    found = qrsim.rollout(qrsim.load_scenario("patrol_plain", overrides, quiet=True), seeds=range(3))
    assert np.asarray(found.metrics["flown_s"]) == pytest.approx(120.0)
    assert np.asarray(found.metrics["distance_m"]).min() > 300.0


@pytest.mark.long
def test_what_is_stated_is_compared_with_the_truth():
    """ANEES of flights: far above 1 on GNSS errors that are not white; NaN where nothing is stated."""
    found = qrsim.rollout(qrsim.load_scenario("patrol_plain", [EKF, "duration=20"], quiet=True), seeds=range(4)).metrics
    assert found["anees_position"].mean() > 5.0
    assert found["anees"].mean() > 3.0
    assert np.isfinite(found["anees_bias"]).all()
    bare = qrsim.rollout(qrsim.load_scenario("patrol_plain", ["duration=2"], quiet=True), seeds=range(2)).metrics
    assert np.isnan(bare["anees"]).all()
