"""A fleet's estimator: what a scenario says, what is flown on, and what is logged."""

from __future__ import annotations

import warnings
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
        ([EKF, "fleets.pelicans.estimator.height_std=0"], "estimator.height_std: 0 is out of range; allowed: above 0"),
        ([EKF, "fleets.pelicans.estimator.ages=[]"], "ages"),
    ],
)
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
    # Range errors of 1.5 m with a dilution of 0.85 per axis are errors of the position for as long as the flight lasts.
    assert ((std > 1.2) & (std < 1.5)).all()
    assert (found["innovation.position_ned"][late] < 5.0).all()


@pytest.mark.long
def test_its_errors_are_drawn(flown: Path, capsys):
    figure = draw_estimate(open_run(flown), ["pelicans_1"])
    # Position, velocity, attitude, and two biases.
    assert [axes.get_visible() for axes in figure.axes] == [True] * 15
    assert "biases and fields as estimated" in figure.get_suptitle()
    assert "3 std as stated" in figure.get_suptitle()
    assert main(["plot", str(flown), "--panel", "estimate", "--panel", "truth.position_ned.z"]) == 2
    assert "is a separate figure" in capsys.readouterr().err


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


def _yaws(sensors: str, seeds: int, more: str = "") -> np.ndarray:
    """Errors of the yaw and the std stated of it (seeds, T, 2) at every second of a hover of 120 s in 6 m/s."""
    overrides = [
        "fleets.pelicans.vehicles=[{position_ned: [0, 0, -20]}]",
        f"fleets.pelicans.sensors={{gnss: {{type: gnss_receiver}}, barometer: {{type: barometer}}, {sensors}}}",
        f"fleets.pelicans.estimator={{type: ekf{more}}}",
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
    """It stays within 4 std for two minutes; without a magnetometer the std rises, and the heading drifts.

    A gyroscope that was calibrated level is off by another 0.1 degrees a second for each g once it leans into the wind:
    the filter that does not know of it is off by 2.0 std rms at the end.
    """
    held = _yaws("imu: {type: imu}, compass: {type: magnetometer}", 16)
    squares = np.square(held[..., 0] / held[..., 1])
    assert 0.7 < np.mean(squares) < 1.4
    assert np.mean(squares[:, -1]) < 2.0
    assert (np.abs(held[..., 0]) < 4.0 * held[..., 1]).all()
    assert (held[:, 30:, 1] < 0.035).all()
    lost = _yaws("imu: {type: imu}", 4, ", calibration_time: 0")
    assert (lost[:, 30:, 1] > 0.08).all()
    assert (np.abs(lost[..., 0]) < 3.0 * lost[..., 1]).all(), "it says that it is lost"
    assert np.abs(lost[:, 30:, 0]).max() > 2.0 * np.abs(held[: len(lost), 30:, 0]).max()


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
    """ANEES of flights: far above 1 where GNSS errors are taken for white; NaN where nothing is stated."""
    white = "fleets.pelicans.estimator={type: ekf, gnss_errors: white}"
    scenario = qrsim.load_scenario("patrol_plain", [white, "duration=20"], quiet=True)
    found = qrsim.rollout(scenario, seeds=range(4)).metrics
    assert found["anees_position"].mean() > 4.0
    assert np.isfinite(found["anees_bias"]).all()
    bare = qrsim.rollout(qrsim.load_scenario("patrol_plain", ["duration=2"], quiet=True), seeds=range(2)).metrics
    assert np.isnan(bare["anees"]).all()


PATROL = "fleets.pelicans"


def _filter(*overrides: str) -> Any:
    return qrsim.load_scenario("outdoor_patrol", list(overrides), quiet=True).world().fleets[0].own_estimator


def test_the_numbers_of_the_filter_are_those_of_its_sensors():
    """By the data sheet of the ICM-42688-P and the numbers of the magnetometer, and of another chip likewise.

    An accelerometer that is off by 20 mg and leans by 1 % in 9.81 m/s^2; hard iron of 0.5 uT, currents of 1 uT in any
    direction, and soft iron of 1 % of 50 uT.
    """
    kalman = _filter()
    scale = ((0.005**2 + 2.0 * 0.01**2) / 3.0) ** 0.5
    assert float(kalman.accelerometer_scale) == pytest.approx(scale, rel=1e-3)
    assert float(kalman.accelerometer_bias_std) == pytest.approx((0.196133**2 + (9.81 * scale) ** 2) ** 0.5, rel=1e-3)
    soft = 0.01**2 + (0.005**2 + 2.0 * 0.002**2) / 3.0
    bias = 0.5**2 + 1.0 / 3.0 + 0.02**2 + soft * 50.0**2
    assert float(kalman.field_bias_std) == pytest.approx(bias**0.5, rel=1e-3)
    assert float(kalman.height_drift_std) == pytest.approx(0.26)
    # 0.1 degrees a second for each g.
    assert float(kalman.gyroscope_g_sensitivity) == pytest.approx(1.7797e-4, rel=1e-4)
    mpu = _filter(f"{PATROL}.sensors.imu.preset=mpu6000")
    # 20 degrees a second, and 0.1 for each g.
    assert float(mpu.gyroscope_bias_std) == pytest.approx(0.3491, rel=1e-3)


def test_a_number_that_is_given_counts():
    kalman = _filter(f"{PATROL}.estimator.accelerometer_bias_std=0.5", f"{PATROL}.estimator.height_std=0.7")
    assert [float(kalman.accelerometer_bias_std), float(kalman.height_std)] == pytest.approx([0.5, 0.7])
    assert float(kalman.height_drift_std) == pytest.approx(0.26)


def test_a_scenario_that_is_read_again_is_the_same():
    """Numbers that are left out are still left out, so that other sensors have others."""
    spec = qrsim.load_scenario("outdoor_patrol", quiet=True).spec
    biased = f"{PATROL}.sensors.imu.gyroscope_turn_on_bias=0.3"
    again: Any = qrsim.load_scenario(spec.model_dump(mode="json"), [biased], quiet=True).world().fleets[0].own_estimator
    assert float(again.gyroscope_bias_std) == pytest.approx(0.3, rel=1e-3)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([f"{PATROL}.estimator.accelerometer_bias_std=0.05"], "accelerometer_bias_std: 0.05 m/s^2, but the errors of"),
        ([f"{PATROL}.estimator={{type: ekf, calibration_time: 0, gyroscope_bias_std: 0.001}}"], "gyroscope_bias_std"),
        ([f"{PATROL}.estimator.accelerometer_bias_std=0.1"], None),
        ([f"{PATROL}.estimator.gyroscope_bias_std=0.0001"], None),
    ],
    ids=["a fourth", "no calibration", "half", "calibrated away"],
)
def test_numbers_that_are_far_too_small_are_warned_of(overrides: list[str], words: str | None):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        qrsim.load_scenario("outdoor_patrol", overrides)
    told = [str(warning.message) for warning in found if "errors of its sensors" in str(warning.message)]
    assert len(told) == (words is not None)
    assert words is None or words in told[0]


def _starts(overrides: list[str], seeds: range) -> np.ndarray:
    """Errors of roll, pitch and yaw of the five vehicles at their start, (seeds, 3, 5)."""

    def look(state: Any) -> Any:
        fleet = state.fleets[0]
        angles = zip(vars(fleet.belief.estimate.attitude).values(), vars(fleet.vehicle.attitude).values(), strict=True)
        return jnp.stack([wrap_angle(mine - true) for mine, true in angles])

    scenario = qrsim.load_scenario("outdoor_patrol", overrides, quiet=True)
    return np.asarray(qrsim.rollout(scenario, ticks=1, seeds=seeds, record=look).recorded)[:, 0]


@pytest.mark.long
def test_a_start_in_flight_is_not_on_the_truth():
    """0.015 rad of roll and pitch and 0.03 of the yaw, within 4 standard errors; the same of the same seed."""
    found = _starts([], range(40))
    stds = found.std(axis=(0, 2))
    assert stds == pytest.approx([0.015, 0.015, 0.03], rel=4.0 / (2.0 * 200.0) ** 0.5)
    np.testing.assert_array_equal(_starts([], range(3)), found[:3])
    np.testing.assert_allclose(_starts([f"{PATROL}.estimator.start=truth"], range(2)), 0.0, atol=1e-6)


@pytest.mark.long
def test_a_gyroscope_that_is_off_by_degrees_a_second_is_calibrated():
    """20 degrees a second as one std: the estimate of the attitude stays within 0.1 rad, and everybody flies."""

    def look(state: Any) -> Any:
        fleet = state.fleets[0]
        return fleet.belief.estimate.attitude.roll - fleet.vehicle.attitude.roll

    overrides = [f"{PATROL}.sensors.imu.preset=mpu6000", "duration=40"]
    found = qrsim.rollout(qrsim.load_scenario("outdoor_patrol", overrides, quiet=True), seeds=range(4), record=look)
    assert np.asarray(found.metrics["flown_s"]) == pytest.approx(40.0)
    assert np.abs(np.asarray(found.recorded)).max() < 0.1
