"""Numbers of sensors that no other test holds: normals that are drawn, codes, ends of what is seen, an IMU by hand."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from test_imu import chip, steps, vector, zeros
from test_optical_flow import seen
from test_rangefinder import read

from qrsim.core.noise import Drawn
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.sensors import optical_flow, rangefinder
from qrsim.models.sensors.airspeed import Airspeed, IdealAirspeed
from qrsim.models.sensors.attitude import AttitudeEstimator
from qrsim.models.sensors.barometer import Barometer
from qrsim.models.sensors.concentration import ConcentrationSensor
from qrsim.models.sensors.imu import IdealImu, Imu
from qrsim.models.sensors.inertial import Accelerometer, Gyroscope
from qrsim.models.sensors.magnetometer import USUAL_FIELD, Magnetometer
from qrsim.models.sensors.optical_flow import IdealOpticalFlow, OpticalFlow
from qrsim.models.sensors.pressure import PressureAltimeter
from qrsim.models.sensors.rangefinder import IdealRangefinder, Rangefinder
from qrsim.models.sensors.scan import IdealScan
from qrsim.models.vehicles.contracts import Load

LOAD = Load(np.ones(1), np.ones(1))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("sensor", "first", "step"),
    # What the equations of docs/explanation/models/sensors.md add normals to; more would be drawn for nothing, and
    # other ones be used.
    [
        (Accelerometer, 0, 3),
        (AttitudeEstimator, 0, 3),
        (Barometer, 0, 2),
        (ConcentrationSensor, 0, 1),
        (Gyroscope, 0, 3),
        (OpticalFlow, 0, 5),
        (Rangefinder, 0, 3),
        # Offset, scale and wander or position error; then white noise, or that and a slow error.
        (Airspeed, 3, 1),
        (PressureAltimeter, 3, 2),
        # Turn-on bias of 6 axes, three matrices of 9, 3 processes of 6 axes, a phase, and a reading of 6; then white
        # noise of 6, the 3 processes of one axis and its walk.
        (Imu, 58, 10),
        # Hard iron 3, soft iron 6, errors 9, direction 3, drift 3, and a reading of 3; then that and drift.
        (Magnetometer, 27, 6),
    ],
)
def test_normals_that_are_drawn(sensor: Any, first: int, step: int) -> None:
    assert (sensor().first_normals, sensor().normals) == (first, step)


def test_codes_of_a_reading_are_the_published_ones() -> None:
    """docs/explanation/models/sensors.md has them."""
    flow = [getattr(optical_flow, name) for name in ("MEASURED", "TOO_NEAR", "NOTHING", "TOO_DARK", "TOO_FAST")]
    assert flow == [0.0, 1.0, 2.0, 3.0, 4.0]
    beam = [getattr(rangefinder, name) for name in ("MEASURED", "TOO_NEAR", "NOTHING", "LOST")]
    assert beam == [0.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(("height", "there"), [(990.0, True), (1010.0, False)])
def test_a_beam_ends_at_a_kilometre(height: float, there: bool) -> None:
    distance, status = read(IdealRangefinder(), (0.0, 0.0, -height))
    assert (status, math.isfinite(distance)) == ((0, True) if there else (2, False))
    assert seen(IdealOpticalFlow(), height=height)["status"] == (0 if there else 2)


@pytest.mark.parametrize(("down", "there"), [(99.0, True), (101.0, False)])
def test_an_ideal_scan_ends_at_a_hundred_metres(down: float, there: bool) -> None:
    from test_rangefinder import attitude, solids
    from test_scan import draw

    from qrsim.models.scene.ground import FlatGround

    # Its one ray looks ahead: down, with the nose down.
    place = Vec3(*(jnp.array([axis], jnp.float32) for axis in (0.0, 0.0, -down)))
    nose_down = attitude(pitch=-0.5 * math.pi)
    _, found = IdealScan(rays=1).init(draw(), place, nose_down, solids(), FlatGround(), None)
    assert bool(jnp.isfinite(found.range[0][0])) is there


def test_usual_field_is_that_of_the_site_of_the_recordings() -> None:
    """World Magnetic Model at 51.71 N, 0.21 W, in 2025 [uT]."""
    axes: Any = USUAL_FIELD.axes
    assert axes == (19.4, 0.4, 45.2)


class TestImu:
    def test_the_truth_over_a_period(self) -> None:
        """Rates from (1, 0, 0) to (0, 2, 0) in 0.1 s: half of both, and their cross product times T^2/12."""
        _, found = IdealImu(period=0.1).step(vector(1, 0, 0), None, vector(0, 2, 0), vector(0, 0, -9.0), LOAD)  # type: ignore[arg-type]
        np.testing.assert_allclose(np.ravel(found.delta_angle.stack()), [0.05, 0.1, 2.0 * 0.01 / 12.0], rtol=1e-6)
        np.testing.assert_allclose(np.ravel(found.delta_velocity.stack()), [0.0, 0.0, -0.9], rtol=1e-6)

    def normals(self, count: int, **given: float) -> Drawn:
        """Normals of which only those that are named by their place are not nought."""
        rows: Any = [np.full(1, given.get(f"n{place}", 0.0), np.float32) for place in range(count)]
        return Drawn(tuple(rows))

    def test_normals_of_a_start_by_their_place(self) -> None:
        """The 52nd is a tenth of the phase, the next six are white noise over the root of the period."""
        draw = self.normals(58, n51=0.07, n52=1.0, n57=-2.0)
        state, _ = chip(vibration="rotors").init(draw, vector(0, 0, 0), vector(0, 0, 0), LOAD)
        assert float(state.phase[0]) != 0.0
        weightless = Load(np.zeros(1), np.ones(1))  # type: ignore[arg-type]
        state, _ = chip(vibration="rotors").init(draw, vector(0, 0, 0), vector(0, 0, 0), weightless)
        assert float(state.phase[0]) == pytest.approx(-0.3, abs=1e-6)
        chips = chip(gyroscope_noise=0.3, accelerometer_noise=0.5, period=0.04)
        _, found = chips.init(draw, vector(0, 0, 0), vector(0, 0, 0), LOAD)
        assert float(found.rates_body.x[0]) == pytest.approx(0.3 / 0.2, rel=1e-5)
        assert float(found.specific_force.z[0]) == pytest.approx(-2.0 * 0.5 / 0.2, rel=1e-5)

    def test_bias_of_one_axis_moves_on_by_six_periods(self) -> None:
        """By exp(-6 T/t) for t = 5, 50 and 500 s, each with the root of ln 10/pi of B; the walk by K root(6 T)."""
        chips = chip(
            gyroscope_bias_instability=1.0, gyroscope_random_walk=0.1, accelerometer_random_walk=0.2, period=0.5
        )
        start = self.normals(58, n33=1.0, n34=1.0, n35=1.0)
        state, _ = chips.init(start, vector(0, 0, 0), vector(0, 0, 0), LOAD)
        share = math.sqrt(2.302585093 / math.pi)
        assert float(chips.bias(state)[0].x[0]) == pytest.approx(3.0 * share, rel=1e-5)
        state, _ = chips.step(state, zeros(10), vector(0, 0, 0), vector(0, 0, 0), LOAD)
        kept = 0.548811636 + 0.941764534 + 0.994017964
        assert float(chips.bias(state)[0].x[0]) == pytest.approx(kept * share, rel=1e-5)
        walks = []
        for _ in range(5):
            state, _ = chips.step(state, self.normals(10, n9=1.0), vector(0, 0, 0), vector(0, 0, 0), LOAD)
            walks = [float(axis[0]) for axis in state.walk]
        root = math.sqrt(3.0)
        assert walks == pytest.approx([0.0, 0.1 * root, 0.1 * root, 0.2 * root, 0.2 * root, 0.2 * root], rel=1e-5)

    def test_what_one_g_does_to_a_level_vehicle(self) -> None:
        """The z elements of G and E, times -9.81 m/s^2."""
        chips = chip(gyroscope_g_sensitivity=0.01, accelerometer_scale=0.02)
        # 6 of the turn-on bias, 9 and 9 of E, 9 of G: the last of the second and of the third matrix.
        state, _ = chips.init(self.normals(58, n23=1.0, n32=1.0), vector(0, 0, 0), vector(0, 0, 0), LOAD)
        wrong = chips.biases(state)
        assert float(wrong["rates_body"].z[0]) == pytest.approx(-0.0981, rel=1e-5)
        assert float(wrong["specific_force"].z[0]) == pytest.approx(-0.1962, rel=1e-5)

    def test_steps_of_a_chip_that_samples_more_slowly_than_it_is_read(self) -> None:
        """They are those of a sample, not larger ones; of 4 samples a reading, a quarter."""
        for rate, read_as in ((10.0, 0.1), (80.0, 0.125)):
            given = {"gyroscope_resolution": 0.1, "sample_rate": rate, "period": 0.05}
            _, found = chip(**given).init(zeros(58), vector(0.13, 0, 0), vector(0, 0, 0), LOAD)
            assert float(found.rates_body.x[0]) == pytest.approx(read_as, abs=1e-6)

    def test_coning_with_the_step_before(self) -> None:
        """A sixth of the last step, (0.1, 0, 0), crossed with half of (0.05, 0.1, 0): 1/1200 rad about z."""
        rates = [(1.0, 0.0, 0.0), (0.0, 2.0, 0.0)]
        (found,) = steps(chip(period=0.1), rates, [(0.0, 0.0, 0.0)] * 2)
        np.testing.assert_allclose(found[6:9], [0.05, 0.1, 1.0 / 1200.0], rtol=1e-5)


def test_noise_of_a_flow_in_the_dark_that_counts_all_the_same() -> None:
    """At quality 0 it is that of a good picture, 0.3 rad/s for 0.02 s."""
    dark: Any = {"noise_rate": 0.3, "gyroscope_noise": 0.0, "quality_min": 0.0, "illuminance": 0.0}
    found = seen(OpticalFlow(**dark), height=10.0, normals=(1.0, 0.0, 0.0, 0.0, 0.0))
    assert (found["quality"], found["status"]) == (0.0, 0)
    assert found["flow"][0] == pytest.approx(0.006, rel=1e-5)


def test_an_ideal_airspeed_has_the_dynamic_pressure() -> None:
    """Half of 1.225 kg/m^3 times the square of 20 m/s at sea level: 245 Pa."""
    level = Euler(*(np.zeros(1, np.float32),) * 3)  # type: ignore[arg-type]
    _, found = IdealAirspeed().init(zeros(0), vector(0, 0, 0), level, vector(20, 0, 0), vector(0, 0, 0))
    assert float(found.differential_pressure[0]) == pytest.approx(245.0, rel=1e-4)


def test_below_the_ground_rotors_press_no_harder_than_on_it() -> None:
    sensor = PressureAltimeter(rotor_wash=1.0, ground_effect=2.0, rotor_diameter=0.5)  # type: ignore[arg-type]
    found = [float(sensor._by_rotors(jnp.array(height))) for height in (-1.0, 0.0, 0.25, 1.0)]
    assert found == pytest.approx([3.0, 3.0, 1.5, 1.0])


class TestMagnetometer:
    def compass(self, **given: float) -> Magnetometer:
        quiet = dict.fromkeys(("hard_iron", "soft_iron", "scale", "misalignment", "drift_std", "noise"), 0.0)
        found: Magnetometer = cast(
            Magnetometer(**{**quiet, "resolution": 0.0, "interference": 0.0, **given}), np.float32
        )
        return found

    def test_interference_too_small_to_have_a_direction(self) -> None:
        """It has all of its strength down to a direction of a millionth."""
        draw = Drawn(tuple(np.full(1, 1.1e-6 if place == 18 else 0.0, np.float32) for place in range(27)))  # type: ignore[misc]
        level = Euler(*(np.zeros(1, np.float32),) * 3)  # type: ignore[arg-type]
        state, _ = self.compass(interference=3.0).init(draw, vector(0, 0, 0), level, LOAD)
        assert float(state.current.x[0]) == pytest.approx(3.0, rel=1e-5)

    def test_steps_of_slow_samples(self) -> None:
        """Of half a sample a reading they are whole, 7 uT of a field of 19.4; of 4 samples a quarter."""
        level = Euler(*(np.zeros(1, np.float32),) * 3)  # type: ignore[arg-type]
        for rate, read_as in ((5.0, 21.0), (40.0, 19.25)):
            sensor = self.compass(resolution=7.0, sample_rate=rate, period=0.1)
            _, found = sensor.init(zeros(27), vector(0, 0, 0), level, LOAD)
            assert float(found.field_body.x[0]) == pytest.approx(read_as, abs=1e-5)
