"""The inertial sensor: its noise against closed forms, its errors against what the equations say of given numbers."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy
from evidence import imu as study

from qrsim import make_scenario
from qrsim.core.noise import Drawn
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError
from qrsim.models.sensors.imu import Imu
from qrsim.models.sensors.imu_presets import PRESETS
from qrsim.models.sensors.vibration import Vibration
from qrsim.models.vehicles.contracts import Load

Array = np.ndarray[Any, Any]
DEG = math.pi / 180.0
NAMES = ("noise", "bias_instability", "random_walk", "turn_on_bias", "scale", "misalignment")
# Nothing but what a test adds.
CLEAN = {f"{kind}_{name}": 0.0 for kind in study.KINDS for name in (*NAMES, "range", "resolution")}
CLEAN |= {"gyroscope_g_sensitivity": 0.0}


def chip(**given: Any) -> Imu:
    found: Imu = cast(Imu(**{**CLEAN, **given}), np.float32)
    return found


def vector(*values: float) -> Vec3:
    return Vec3(*(np.array([value], np.float32) for value in values))  # type: ignore[arg-type]


def zeros(count: int) -> Drawn:
    return Drawn((np.zeros(1),) * count)  # type: ignore[arg-type]


def steps(sensor: Imu, rates: list[Any], forces: list[Any]) -> list[Array]:
    """Readings (12,) of steps after a start with the first values; no normal is drawn but zero."""
    load = Load(np.ones(1), np.ones(1))  # type: ignore[arg-type]
    state, _ = sensor.init(zeros(sensor.first_normals), vector(*rates[0]), vector(*forces[0]), load)
    found = []
    for rate, force in zip(rates[1:], forces[1:], strict=True):
        state, reading = sensor.step(state, zeros(sensor.normals), vector(*rate), vector(*force), load)
        parts = (reading.rates_body, reading.specific_force, reading.delta_angle, reading.delta_velocity)
        found.append(np.concatenate([np.asarray(part.stack())[0] for part in parts]))
    return found


class TestAllan:
    """N, B and K of IEEE Std 952: sigma^2 = N^2/t, (2 ln 2/pi) B^2, K^2 t/3."""

    def only(self, period: float = 0.02, **given: float) -> Any:
        names = {f"gyroscope_{name}": 0.0 for name in NAMES}
        return SimpleNamespace(**{**names, **{f"gyroscope_{k}": v for k, v in given.items()}}, period=period)

    def test_the_closed_form_has_the_standard_slopes(self) -> None:
        lengths = np.array([1, 10, 1000])
        white = study.expected_variance(self.only(noise=0.3), "gyroscope", lengths)
        np.testing.assert_allclose(white, 0.09 / (0.02 * lengths), rtol=1e-12)
        walk = study.expected_variance(self.only(random_walk=0.3), "gyroscope", np.array([3000, 30000]))
        np.testing.assert_allclose(walk, 0.09 * np.array([60.0, 600.0]) / 3.0, rtol=1e-4)
        # Flicker noise between the shortest and the longest correlation time: flat, 0.664 B.
        lengths = np.round(np.array([15.0, 30.0, 90.0, 300.0, 700.0]) / 0.2).astype(int)
        flicker = study.expected_variance(self.only(0.2, bias_instability=2.0), "gyroscope", lengths)
        np.testing.assert_allclose(np.sqrt(flicker), 0.664 * 2.0, rtol=0.08)
        assert math.sqrt(flicker[2]) == pytest.approx(0.664 * 2.0, rel=0.015)

    @pytest.mark.long
    def test_readings_at_rest_have_it(self) -> None:
        """Sixteen chips for an hour, every term visible; 99.9 % over all windows of a kind, N and K within 10 %."""
        given = {"noise": 0.01, "bias_instability": 0.004, "random_walk": 0.001}
        numbers = {f"{kind}_{name}": value for kind in study.KINDS for name, value in given.items()}
        sensor = cast(replace(chip(period=0.2), **numbers), np.float32)
        taken = study.readings(sensor, 18_000, 16)
        lengths = np.array([1, 3, 10, 30, 100, 300, 1000, 3000])
        for kind in study.KINDS:
            series = taken[kind].reshape(18_000, -1).astype(np.float64)
            sums = np.concatenate([np.zeros((1, series.shape[1])), np.cumsum(series - series.mean(axis=0), axis=0)])
            variance = np.array(
                [np.mean((sums[2 * n :] - 2 * sums[n:-n] + sums[: -2 * n]) ** 2) / (2 * n * n) for n in lengths]
            )
            ratio = variance / study.expected_variance(sensor, kind, lengths)
            freedom = 48 * (18_000 / lengths - 1.0)
            edges = 0.0005 / len(lengths)
            low, high = (scipy.stats.chi2.ppf(p, freedom) / freedom for p in (edges, 1.0 - edges))
            assert np.all((low < ratio) & (ratio < high)), (kind, ratio)
            fit = study.fitted(0.2 * lengths, variance)
            assert fit["noise"] == pytest.approx(0.01, rel=0.1)
            assert fit["random_walk"] == pytest.approx(0.001, rel=0.1)

    @pytest.mark.long
    def test_the_study(self) -> None:
        found = study.run(full=False)
        for kind in study.KINDS:
            row = found["at_rest"]["icm42688p"][kind]
            assert row["fitted_over_true"]["noise"] == pytest.approx(1.0, abs=0.1)
            assert row["worst_ratio"] < 1.6
        rows = found["recording"]
        for axis in "xyz":
            assert rows[axis]["simulated"] == pytest.approx(rows[axis]["recorded"], rel=0.05)
        assert rows["worst_band_ratio"] < 1.7


class TestOnce:
    def test_what_is_drawn_once_has_its_spread(self) -> None:
        count = 20_000
        numbers = np.random.default_rng(5)
        sensor = chip(
            gyroscope_turn_on_bias=0.3,
            accelerometer_turn_on_bias=0.7,
            gyroscope_scale=0.02,
            gyroscope_misalignment=0.005,
            accelerometer_scale=0.03,
            accelerometer_misalignment=0.01,
            gyroscope_g_sensitivity=0.001,
            gyroscope_bias_instability=2.0,
        )
        drawn = Drawn(tuple(numbers.standard_normal((sensor.first_normals, count))))  # type: ignore[arg-type]
        zero = np.zeros(count)
        still: Any = Vec3(zero, zero, zero)  # type: ignore[arg-type]
        state, _ = sensor.init(drawn, still, still, Load(zero + 1.0, zero + 1.0))  # type: ignore[arg-type]
        found = [np.std(axis) for axis in state.walk]
        np.testing.assert_allclose(found, [0.3] * 3 + [0.7] * 3, rtol=0.03)
        for rows, diagonal, beside in (
            (state.gyroscope_error, 0.02, 0.005),
            (state.accelerometer_error, 0.03, 0.01),
            (state.g_sensitivity, 0.001, 0.001),
        ):
            spread = np.array([[np.std(axis) for axis in (row.x, row.y, row.z)] for row in rows])
            expected = np.full((3, 3), beside) + (diagonal - beside) * np.eye(3)
            np.testing.assert_allclose(spread, expected, rtol=0.03)
        # Three processes of variance ln 10/pi each.
        wandering = np.asarray(sensor.bias(state)[0].x) - np.asarray(state.walk[0])
        assert np.std(wandering) == pytest.approx(2.0 * math.sqrt(3 * 0.73294), rel=0.03)

    def test_scale_misalignment_and_sensitivity_act_as_the_equation_says(self) -> None:
        sensor = chip()
        rates, force = np.array([0.5, -1.0, 2.0]), np.array([3.0, -1.0, -9.0])
        load = Load(np.ones(1), np.ones(1))  # type: ignore[arg-type]
        state, _ = sensor.init(zeros(sensor.first_normals), vector(*rates), vector(*force), load)
        matrices = [np.arange(9.0).reshape(3, 3) * scale for scale in (1e-2, -2e-3, 5e-3)]
        rows = [tuple(vector(*row) for row in matrix) for matrix in matrices]
        bias = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
        state = replace(
            state,
            gyroscope_error=rows[0],
            accelerometer_error=rows[1],
            g_sensitivity=rows[2],
            walk=tuple(np.array([b]) for b in bias),
        )
        _, reading = sensor.step(state, zeros(sensor.normals), vector(*rates), vector(*force), load)
        expected = (np.eye(3) + matrices[0]) @ rates + matrices[2] @ force + bias[:3]
        np.testing.assert_allclose(np.asarray(reading.rates_body.stack())[0], expected, rtol=1e-6)
        expected = (np.eye(3) + matrices[1]) @ force + bias[3:]
        np.testing.assert_allclose(np.asarray(reading.specific_force.stack())[0], expected, rtol=1e-6)

    def test_a_chip_keeps_its_bias_where_its_vehicle_is_placed_anew(self) -> None:
        sensor = chip(gyroscope_turn_on_bias=0.3, accelerometer_turn_on_bias=0.7)
        ones = Drawn((np.ones(1, np.float32),) * sensor.first_normals)  # type: ignore[arg-type]
        load, still = Load(np.ones(1), np.ones(1)), vector(0.0, 0.0, 0.0)  # type: ignore[arg-type]
        state, _ = sensor.init(ones, still, still, load)
        moved = vector(1.0, 2.0, 3.0)
        state, reading = sensor.restart(state, zeros(sensor.first_normals), np.zeros(1), moved, moved, load)  # type: ignore[arg-type]
        np.testing.assert_allclose(np.asarray(reading.rates_body.stack())[0], [1.3, 2.3, 3.3], rtol=1e-6)
        np.testing.assert_allclose(np.asarray(reading.specific_force.stack())[0], [1.7, 2.7, 3.7], rtol=1e-6)


class TestSignal:
    def test_a_clean_chip_says_the_means_of_the_step(self) -> None:
        found = steps(chip(), [[0.0, 0.0, 0.0], [0.2, 0.4, -0.6]], [[0, 0, -9], [1, 2, -10]])[0]
        np.testing.assert_allclose(found[:3], [0.1, 0.2, -0.3], rtol=1e-6)
        np.testing.assert_allclose(found[3:6], [1, 2, -10], rtol=1e-6)
        np.testing.assert_allclose(found[9:], [0.02, 0.04, -0.2], rtol=1e-6)

    def test_range_and_resolution(self) -> None:
        """Steps of 0.1 of samples at 100 Hz, of which a reading is the mean of two."""
        sensor = chip(
            gyroscope_range=1.0,
            gyroscope_resolution=0.1,
            accelerometer_range=20.0,
            accelerometer_resolution=0.5,
            sample_rate=100.0,
        )
        found = steps(sensor, [[0.33, 0.02, -7.0]] * 2, [[0.3, 0.1, -30.0]] * 2)[0]
        np.testing.assert_allclose(found[:6], [0.35, 0.0, -1.0, 0.25, 0.0, -20.0], atol=1e-6)

    def test_the_low_pass_is_a_butterworth_filter(self) -> None:
        sensor = chip(bandwidth_hz=8.0)
        rates = [[1.0, 0.5, 0.0]] + [[1.0, -0.5, 0.0]] * 2 + [[3.0, 0.0, 0.0]] * 9
        found = np.array(steps(sensor, rates, [[0.0, 0.0, -9.81]] * 12))
        mean = np.array([[0.5 * (a[i] + b[i]) for i in range(3)] for a, b in itertools.pairwise(rates)])
        b, a = scipy.signal.butter(2, 8.0, fs=50.0)
        for axis in range(3):
            start = scipy.signal.lfilter_zi(b, a) * rates[0][axis]
            # The first reading, at the start, has gone through it too.
            whole, _ = scipy.signal.lfilter(b, a, np.concatenate([[rates[0][axis]], mean[:, axis]]), zi=start)
            np.testing.assert_allclose(found[:, axis], whole[1:], atol=1e-6)
        np.testing.assert_allclose(found[:, 5], -9.81, rtol=1e-6)

    @pytest.mark.parametrize(("parts", "tolerance"), [(1, 1.8e-3), (8, 1e-4)])
    def test_the_angle_of_a_coning_motion(self, parts: int, tolerance: float) -> None:
        """Against the rotation of many small ones; 3e-3 rad off without correction; one sample halves that."""
        rates = [[1.0, 0.0, 0.2], [1.0, 0.0, 0.2], [0.0, 1.0, 0.2]]
        sensor = chip(subsamples=parts, period=0.2)
        found = steps(sensor, rates, [[0.0, 0.0, 0.0]] * 3)[1][6:9]
        turned, many = scipy.spatial.transform.Rotation.identity(), 2000
        for i in range(many):
            share = (i + 0.5) / many
            rate = (1 - share) * np.array(rates[1]) + share * np.array(rates[2])
            turned = turned * scipy.spatial.transform.Rotation.from_rotvec(rate * 0.2 / many)
        expected = turned.as_rotvec()
        plain = 0.1 * (np.array(rates[1]) + np.array(rates[2]))
        assert np.abs(plain - expected).max() > 3e-3
        assert np.abs(found - expected).max() < tolerance


class TestVibration:
    def test_levels_are_rms_in_hover_and_grow_with_thrust(self) -> None:
        vibration = cast(Vibration(broadband=0.36, gyroscope_x=0.5, accelerometer_z=2.0), np.float64)  # type: ignore[arg-type]
        phase = np.linspace(-0.5, 0.5, 1000, endpoint=False)
        for thrust in (1.0, 1.5):
            waves = vibration.harmonics(phase, np.full(1000, thrust))  # type: ignore[arg-type]
            spread = vibration.spreads(np.array([thrust]))  # type: ignore[arg-type]
            assert np.std(waves[0].x) == pytest.approx(0.8 * 0.5 * thrust, rel=1e-5)
            assert np.std(waves[1].z) == pytest.approx(0.8 * 2.0 * thrust, rel=1e-5)
            assert float(spread[0].x[0]) == pytest.approx(0.6 * 0.5 * thrust, rel=1e-6)
        # Amplitudes of the harmonics are as 1 to 1/2 to 1/3.
        lines = np.abs(np.fft.rfft(np.asarray(waves[0].x)))[1:5]
        np.testing.assert_allclose(lines / lines[0], [1.0, 0.5, 1 / 3, 0.0], atol=1e-6)

    def test_it_is_seen_at_another_frequency(self) -> None:
        """90 Hz in readings at 50 Hz look like 10 Hz; four times the thrust has twice the frequency."""
        vibration = cast(Vibration(rotor_frequency=90.0), np.float64)  # type: ignore[arg-type]
        phase = np.zeros(1)
        turns = []
        for _ in range(10):
            phase = np.asarray(vibration.turned(phase, np.ones(1), 0.02))  # type: ignore[arg-type]
            turns.append(phase[0])
        np.testing.assert_allclose(turns, [-0.2, -0.4, 0.4, 0.2, 0.0] * 2, atol=1e-6)
        doubled = np.asarray(vibration.turned(np.zeros(1), np.full(1, 4.0), 0.002))  # type: ignore[arg-type]
        assert doubled[0] == pytest.approx(0.36, abs=1e-6)


# Of data sheets: densities one-sided [deg/s/sqrt(Hz)], [ug/sqrt(Hz)]; turn-on bias [deg/s], [mg]; in-run [deg/h], [ug];
# docs/howto/sensors_inertial.md.
SHEETS = {
    "mpu6000": (0.005, 400.0, 20.0, 80.0, 10.0, 100.0),
    "icm20689": (0.006, 150.0, 5.0, 40.0, 10.0, 60.0),
    "bmi088": (0.014, 175.0, 1.0, 20.0, 7.0, 50.0),
    "icm42688p": (0.0028, 70.0, 0.5, 20.0, 6.0, 40.0),
    "adis16470": (0.008, 89.0, 0.2, 2.0, 8.0, 13.0),
}
# Full scale [deg/s], [g], and counts [LSB/(deg/s)], [LSB/g]: PS-MPU-6000A-00 6.1 and 6.2, the same on the ICM-20689;
# BST-BMI088-DS001; DS-000347, of 20 bits in the FIFO; ADIS16470 rev. C, of 32 bits.
SCALES = {
    "mpu6000": (2000.0, 16.0, 16.4, 2048.0),
    "icm20689": (2000.0, 16.0, 16.4, 2048.0),
    "bmi088": (2000.0, 24.0, 16.384, 1365.3),
    "icm42688p": (2000.0, 16.0, 131.0, 8192.0),
    "adis16470": (2000.0, 40.0, 655360.0, 52428800.0),
}


@pytest.mark.parametrize("name", SHEETS)
def test_presets_are_those_of_the_data_sheets(name: str) -> None:
    gyroscope, accelerometer, rate, force, in_run, in_run_force = SHEETS[name]
    found = PRESETS[name]
    assert found["gyroscope_noise"] == pytest.approx(gyroscope * DEG / math.sqrt(2.0), rel=0.01)
    assert found["accelerometer_noise"] == pytest.approx(accelerometer * 9.80665e-6 / math.sqrt(2.0), rel=0.01)
    assert found["gyroscope_turn_on_bias"] == pytest.approx(rate * DEG)
    assert found["accelerometer_turn_on_bias"] == pytest.approx(force * 9.80665e-3)
    # The floor of the Allan deviation is 0.664 B, and K has as much over 500 s: K sqrt(500/3).
    floor = np.array([in_run * DEG / 3600.0, in_run_force * 9.80665e-6])
    parts = ("gyroscope", "accelerometer")
    np.testing.assert_allclose([found[f"{part}_bias_instability"] for part in parts], floor / 0.664, rtol=1e-3)
    np.testing.assert_allclose([found[f"{part}_random_walk"] for part in parts], floor * 0.0774597, rtol=1e-6)
    turn, pull, counts, counts_per_g = SCALES[name]
    assert found["gyroscope_range"] == pytest.approx(turn * DEG)
    assert found["accelerometer_range"] == pytest.approx(pull * 9.80665)
    assert found["gyroscope_resolution"] == pytest.approx(DEG / counts, rel=1e-4)
    assert found["accelerometer_resolution"] == pytest.approx(9.80665 / counts_per_g, rel=1e-4)


def test_the_mpu6000_has_the_tolerances_of_its_sheet() -> None:
    """PS-MPU-6000A-00, 6.1 and 6.2: scale 3 %, cross-axis 2 %, 0.1 deg/s/g; samples at 1 kHz."""
    found = PRESETS["mpu6000"]
    for part in ("gyroscope", "accelerometer"):
        assert (found[f"{part}_scale"], found[f"{part}_misalignment"]) == pytest.approx((0.03, 0.02))
    assert found["gyroscope_g_sensitivity"] == pytest.approx(0.1 * DEG / 9.80665)
    assert (found["sample_rate"], PRESETS["adis16470"]["sample_rate"]) == (1000.0, 2000.0)


def test_the_adis16470_has_its_random_walks() -> None:
    """0.34 deg/sqrt(h) and 0.037 m/s/sqrt(h); in-run stability 8 deg/h and 13 ug are the floor, 0.664 B."""
    found = PRESETS["adis16470"]
    assert found["gyroscope_noise"] == pytest.approx(0.34 * DEG / 60.0, rel=0.01)
    assert found["accelerometer_noise"] == pytest.approx(0.037 / 60.0, rel=0.01)
    assert 0.664 * found["gyroscope_bias_instability"] == pytest.approx(8.0 * DEG / 3600.0, rel=0.001)
    assert 0.664 * found["accelerometer_bias_instability"] == pytest.approx(13e-6 * 9.80665, rel=0.001)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"preset": "icm42688"}, "did you mean 'icm42688p'"),
        ({"bandwidth_hz": 25.0}, "imu.bandwidth_hz: 25 Hz; allowed: below 25 Hz, half the rate"),
        ({"gyroscope_noise": -1.0}, "imu.gyroscope_noise: -1.0 is out of range"),
        ({"subsamples": 0}, "imu.subsamples: 0 is out of range"),
        ({"vibration": "rotor"}, "did you mean 'rotors'"),
    ],
)
def test_errors(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make_scenario(
            [[0.0, 0.0, -10.0]],
            sensors={"imu": {"type": "imu", **given}},
            controller={"type": "waypoint", "feed": "truth"},
        )


@pytest.mark.long
@pytest.mark.usefixtures("optimised")
def test_both_compilers_fly_it_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    import warnings

    from qrsim import Simulation

    flown = []
    for compiler in ("llvm", "xla"):
        monkeypatch.setenv("QRSIM_COMPILER", compiler)
        sensors = {"imu": {"type": "imu", "vibration": "rotors", "bandwidth_hz": 20.0, "subsamples": 2}}
        world = make_scenario(
            [[0.0, 0.0, -10.0]], sensors=sensors, controller={"type": "waypoint", "feed": "truth"}
        ).world()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            simulation = Simulation(world, seed=3)
            simulation.reset()
            reading = simulation.step(ticks=100).imu
        assert simulation.compiled_by[0] == compiler
        flown.append((reading.rates_body, reading.delta_velocity))
    np.testing.assert_allclose(flown[0][0], flown[1][0], atol=1e-4)
    np.testing.assert_allclose(flown[0][1], flown[1][1], atol=1e-4)
    assert np.abs(flown[0][0]).max() > 1e-4
