"""The magnetometer: Earth's field against published values, its errors against the equations, its drift at rest."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
import scipy
from evidence import magnetometer as study

import qrsim
from qrsim import make_scenario
from qrsim.core.noise import Drawn
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import ScenarioError, UsageError
from qrsim.models.sensors.earth_field import declination, earth_field_ned, inclination
from qrsim.models.sensors.fitting import Fitting, mounted
from qrsim.models.sensors.magnetometer import IdealMagnetometer, Magnetometer, Steel
from qrsim.models.sensors.magnetometer_presets import PRESETS
from qrsim.models.site import Site
from qrsim.models.vehicles.contracts import Load
from qrsim.scenarios.derived import derived_of

Array = np.ndarray[Any, Any]
# Nothing but what a test adds.
ERRORS = ("noise", "drift_std", "scale", "misalignment", "hard_iron", "soft_iron", "interference")
CLEAN = dict.fromkeys((*ERRORS, "range", "resolution"), 0.0)
FIELD = (20.0, -3.0, 44.0)
TRUTH = {"type": "waypoint", "feed": "truth"}


def chip(**given: Any) -> Magnetometer:
    found: Magnetometer = cast(Magnetometer(**{**CLEAN, "earth_field_ned": Vec3(*FIELD), **given}), np.float32)  # type: ignore[arg-type]
    return found


def vector(*values: Any) -> Any:
    return Vec3(*(np.atleast_1d(np.asarray(value, np.float32)) for value in values))  # type: ignore[arg-type]


def euler(*angles: float) -> Any:
    return Euler(*(np.array([angle], np.float32) for angle in angles))  # type: ignore[arg-type]


def measured(sensor: Magnetometer, normals: Any = 0.0, thrust: float = 1.0, attitude: Any = None) -> Array:
    """A first reading (3,), with normals that are all the same or given one by one."""
    drawn = Drawn(tuple(np.broadcast_to(np.float32(normals), sensor.first_normals)[:, None]))  # type: ignore[arg-type]
    load = Load(np.array([2.0 * thrust]), np.array([2.0]))  # type: ignore[arg-type]
    attitude = euler(0.0, 0.0, 0.0) if attitude is None else attitude
    _, reading = sensor.init(drawn, vector(0.0, 0.0, 0.0), attitude, load)
    return np.asarray(reading.field_body.stack())[0]


class TestEarth:
    # Decimal year, height [km], latitude, longitude [deg], X, Y, Z [nT]: NOAA's test values of each model.
    PUBLISHED = (
        (2010.0, 0, 80, 0, 6649.5, -714.6, 54346.2),
        (2012.5, 100, -80, 240, 5535.5, 14765.4, -50625.9),
        (2015.0, 0, 80, 0, 6636.6, -451.9, 54408.9),
        (2017.5, 100, 0, 120, 37584.4, 235.7, -10600.5),
        (2020.0, 0, 80, 0, 6570.4, -146.3, 54606.0),
        (2020.0, 0, 0, 120, 39624.3, 109.9, -10932.5),
        (2022.5, 100, -80, 240, 5815.0, 14803.0, -49755.3),
        (2025.0, 0, 80, 0, 6521.6, 145.9, 54791.5),
        (2025.0, 0, 0, 120, 39677.8, -109.6, -10580.2),
        (2025.0, 0, -80, 240, 6117.5, 15751.9, -52022.5),
        (2025.0, 100, 80, 0, 6216.0, 92.4, 52598.8),
    )

    @pytest.mark.parametrize("row", PUBLISHED)
    def test_published_test_values_of_the_world_magnetic_model(self, row: tuple[float, ...]) -> None:
        year, height, latitude, longitude, *field = row
        begin, end = (datetime(int(year) + more, 1, 1, tzinfo=UTC) for more in (0, 1))
        when = begin + (year - int(year)) * (end - begin)
        found = earth_field_ned(Site.from_degrees(latitude, longitude, 1000.0 * height), when)
        np.testing.assert_allclose(found, np.array(field) / 1000.0, atol=1.01e-4)

    def test_angles(self) -> None:
        """2020.0, 80 S 120 W: declination 69.36 and inclination -72.20 degrees."""
        found = earth_field_ned(Site.from_degrees(-80.0, -120.0), datetime(2020, 1, 1, tzinfo=UTC))
        assert math.degrees(declination(found)) == pytest.approx(69.36, abs=0.005)
        assert math.degrees(inclination(found)) == pytest.approx(-72.20, abs=0.005)

    def test_a_world_has_the_field_of_its_site_and_date(self) -> None:
        scenario = make_scenario(
            [[0.0, 0.0, -10.0]],
            site={"latitude_deg": 80.0, "longitude_deg": 0.0, "height": 100.0},
            start_time=datetime(2025, 1, 1, tzinfo=UTC),
            controller=TRUTH,
            sensors={"compass": {"type": "magnetometer"}, "true": {"type": "ideal_magnetometer"}},
        )
        expected = [6.5216, 0.1459, 54.7915]
        np.testing.assert_allclose(scenario.earth_field_ned, expected, atol=4e-3)
        for sensor in scenario.world().fleets[0].sensors:
            assert isinstance(sensor, Magnetometer | IdealMagnetometer)
            found = [float(axis) for axis in sensor.earth_field_ned.axes]
            np.testing.assert_allclose(found, expected, atol=4e-3)

    def test_what_it_means_for_a_compass_is_shown(self) -> None:
        parts = {"start_time": datetime(2020, 1, 1, tzinfo=UTC), "controller": TRUTH}
        place = {"latitude_deg": -80.0, "longitude_deg": -120.0}
        scenario = make_scenario(
            [[0.0, 0.0, -10.0]], site=place, sensors={"compass": {"type": "magnetometer"}}, **parts
        )
        shown = derived_of(scenario)["vehicles"]
        assert shown["earth_field_uT"] == pytest.approx(55.12, abs=0.01)
        assert shown["declination_deg"] == pytest.approx(69.36, abs=0.005)
        assert shown["inclination_deg"] == pytest.approx(-72.20, abs=0.005)
        assert "declination_deg" not in derived_of(make_scenario([[0.0, 0.0, -10.0]], **parts))["vehicles"]

    @pytest.mark.parametrize("when", ["2009-12-31T23:59:59Z", "2030-01-01T00:00:00Z"])
    def test_a_date_without_a_model_is_an_error(self, when: str) -> None:
        start = datetime.fromisoformat(when)
        make_scenario([[0.0, 0.0, -10.0]], start_time=start, controller=TRUTH)
        with pytest.raises(ScenarioError) as caught:
            make_scenario(
                [[0.0, 0.0, -10.0]], start_time=start, sensors={"compass": {"type": "magnetometer"}}, controller=TRUTH
            )
        assert caught.value.problems == [
            f"start_time: {start:%Y-%m-%d} is outside the World Magnetic Model, which fleets.vehicles.sensors.compass "
            "needs; allowed: 2010-01-01 to 2029-12-31"
        ]
        with pytest.raises(UsageError, match="2010-01-01 to 2029-12-31"):
            earth_field_ned(Site(), start)
        # The last moments inside.
        assert earth_field_ned(Site(), datetime(2029, 12, 31, 23, tzinfo=UTC)).shape == (3,)


class TestCompass:
    @pytest.mark.parametrize("angles", [(0.0, 0.0, 2.0), (0.4, -0.3, -1.0), (-1.2, 0.9, 3.1), (3.0, 0.2, 0.5)])
    def test_heading_of_a_tilted_compass(self, angles: tuple[float, float, float]) -> None:
        roll, pitch, yaw = angles
        field = scipy.spatial.transform.Rotation.from_euler("ZYX", [yaw, pitch, roll]).inv().apply(FIELD)
        body = vector(*field)
        east_of_north = math.atan2(FIELD[1], FIELD[0])
        found = float(qrsim.compass_heading(body, roll, pitch, east_of_north)[0])
        assert found == pytest.approx(yaw, abs=1e-6)
        magnetic = float(qrsim.compass_heading(body, roll, pitch)[0])
        assert math.remainder(magnetic - (yaw - east_of_north), 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)


class TestErrors:
    def test_a_clean_chip_says_the_field_in_body_axes(self) -> None:
        found = measured(chip(), attitude=euler(0.3, -0.2, 1.0))
        expected = scipy.spatial.transform.Rotation.from_euler("ZYX", [1.0, -0.2, 0.3]).inv().apply(FIELD)
        np.testing.assert_allclose(found, expected, atol=2e-5)

    def test_errors_act_as_the_equation_says(self) -> None:
        sensor = chip(noise=0.2, period=0.25)
        drawn = Drawn((np.zeros(1),) * sensor.first_normals)  # type: ignore[arg-type]
        weight = Load(np.array([3.0]), np.array([2.0]))  # type: ignore[arg-type]
        place, level = vector(0.0, 0.0, 0.0), euler(0.0, 0.0, 0.0)
        state, _ = sensor.init(drawn, place, level, weight)
        matrix = np.array([[0.01, 0.02, -0.03], [0.04, -0.05, 0.06], [0.07, 0.08, 0.09]])
        state = replace(
            state,
            error=tuple(vector(*row) for row in matrix),
            offset=vector(1.0, 2.0, 3.0),
            current=vector(-2.0, 0.0, 4.0),
            drift=vector(0.1, 0.2, 0.3),
        )
        normals = Drawn(tuple(np.array([[1.0], [-1.0], [2.0], [0.0], [0.0], [0.0]])))  # type: ignore[arg-type]
        _, reading = replace(sensor, drift_time_constant=np.float64(1e12)).step(state, normals, place, level, weight)  # type: ignore[arg-type]
        # White noise of 0.2/sqrt(0.25 s) = 0.4.
        expected = (np.eye(3) + matrix) @ FIELD + [1.0, 2.0, 3.0] + 1.5 * np.array([-2.0, 0.0, 4.0])
        expected += np.array([0.1, 0.2, 0.3]) + 0.4 * np.array([1.0, -1.0, 2.0])
        np.testing.assert_allclose(np.asarray(reading.field_body.stack())[0], expected, atol=1e-5)

    def test_currents_are_proportional_to_thrust(self) -> None:
        """A drawn direction of a given size, and more along a known one; nothing without thrust."""
        sensor = chip(interference=3.0, interference_z=0.5)
        drawn = np.zeros(sensor.first_normals, np.float32)
        drawn[18:21] = [0.0, -2.0, 0.0]
        for thrust in (0.0, 1.0, 1.7):
            found = measured(sensor, drawn, thrust) - FIELD
            np.testing.assert_allclose(found, [0.0, -3.0 * thrust, 0.5 * thrust], atol=1e-5)

    def test_what_is_drawn_once_has_its_spread(self) -> None:
        count = 20_000
        sensor = chip(hard_iron=2.0, soft_iron=0.03, scale=0.04, misalignment=0.01, drift_std=0.7, interference=3.0)
        drawn = np.random.default_rng(7).standard_normal((sensor.first_normals, count), np.float32)
        zero = np.zeros(count, np.float32)
        load = Load(zero + 1.0, zero + 1.0)  # type: ignore[arg-type]
        still, level = Vec3(zero, zero, zero), Euler(zero, zero, zero)  # type: ignore[arg-type]
        state, _ = sensor.init(Drawn(tuple(drawn)), still, level, load)  # type: ignore[arg-type]
        np.testing.assert_allclose([np.std(axis) for axis in state.offset.axes], 2.0, rtol=0.03)
        np.testing.assert_allclose([np.std(axis) for axis in state.drift.axes], 0.7, rtol=0.03)
        spread = np.array([[np.std(axis) for axis in row.axes] for row in state.error])
        np.testing.assert_allclose(
            spread, math.hypot(0.03, 0.01) + (0.05 - math.hypot(0.03, 0.01)) * np.eye(3), rtol=0.03
        )
        # Soft iron is symmetric: what the elements across the diagonal share is 0.9 of their variance.
        together = np.corrcoef(state.error[0].y, state.error[1].x)[0, 1]
        assert together == pytest.approx(0.9, abs=0.01)
        size = np.sqrt(sum(np.square(axis) for axis in state.current.axes))
        np.testing.assert_allclose(size, 3.0, rtol=1e-5)
        np.testing.assert_allclose([np.mean(np.square(axis)) for axis in state.current.axes], 3.0, rtol=0.03)

    def test_range_and_resolution(self) -> None:
        """Steps of 0.3 of samples at 20 Hz, of which a reading is the mean of two."""
        sensor = chip(range=30.0, resolution=0.3, sample_rate=20.0)
        np.testing.assert_allclose(measured(sensor), [19.95, -3.0, 30.0], atol=1e-5)

    def test_a_chip_keeps_its_errors_where_its_vehicle_is_placed_anew(self) -> None:
        sensor = chip(hard_iron=2.0)
        load, level = Load(np.ones(1), np.ones(1)), euler(0.0, 0.0, 0.0)  # type: ignore[arg-type]
        ones = Drawn((np.ones(1),) * sensor.first_normals)  # type: ignore[arg-type]
        state, _ = sensor.init(ones, vector(0.0, 0.0, 0.0), level, load)
        zeros = Drawn((np.zeros(1),) * sensor.first_normals)  # type: ignore[arg-type]
        _, reading = sensor.restart(state, zeros, np.zeros(1), vector(5.0, 0.0, 0.0), level, load)  # type: ignore[arg-type]
        np.testing.assert_allclose(np.asarray(reading.field_body.stack())[0] - FIELD, 2.0, atol=1e-5)

    def test_a_turned_chip_has_axes_of_its_own(self) -> None:
        body, turn = (0.3, -0.2, 1.0), (0.1, -0.4, 2.0)
        scene = {"attitude": euler(*body), "position_ned": vector(0.0, 0.0, 0.0), "rates_body": vector(0.0, 0.0, 0.0)}
        fitting = Fitting(attitude=Euler(*turn))  # type: ignore[arg-type]
        found = mounted(fitting, scene, ("position_ned", "attitude"), None, 0.02)
        turned = scipy.spatial.transform.Rotation.from_euler
        expected = turned("ZYX", body[::-1]) * turned("ZYX", turn[::-1])
        reading = measured(chip(), attitude=found["attitude"])
        np.testing.assert_allclose(reading, expected.inv().apply(FIELD), atol=5e-5)


class TestSteel:
    def test_a_sphere_is_a_dipole(self) -> None:
        """Along the field 2 B (a/r)^3 more, across it B (a/r)^3 less; 3 B in all at its poles; nothing far away."""
        steel = Steel(vector(10.0, -5.0, -2.0), np.array([1.5]))  # type: ignore[arg-type]
        along = np.array(FIELD) / np.linalg.norm(FIELD)
        across = np.cross(along, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        centre = np.array([10.0, -5.0, -2.0])
        for r in (1.5, 3.0, 6.0):
            share = (1.5 / r) ** 3
            for direction, factor in ((along, 2.0), (-along, 2.0), (across, -1.0)):
                found = steel.field_ned(Vec3(*FIELD), vector(*(centre + r * direction)))  # type: ignore[arg-type]
                np.testing.assert_allclose(found.stack()[0], factor * share * np.array(FIELD), atol=1e-4)
        far = steel.field_ned(Vec3(*FIELD), vector(200.0, 0.0, 0.0))  # type: ignore[arg-type]
        assert np.abs(far.stack()).max() < 1e-4

    def test_obstacles_turn_the_compass(self) -> None:
        """Two bodies of steel add up; a box, a cylinder and a prism have their middle where they should."""
        obstacles: list[dict[str, Any]] = [
            {"type": "box", "x_min": 18.0, "x_max": 22.0, "y_min": -3.0, "y_max": 1.0, "z_min": -10.0,
             "steel_radius": 2.0},
            {"type": "cylinder", "x": -20.0, "y": 4.0, "radius": 0.5, "z_min": -30.0, "steel_radius": 1.0},
            {"type": "prism", "corners_ned": [[30.0, 30.0], [34.0, 30.0], [34.0, 36.0], [30.0, 36.0]], "z_min": -8.0,
             "steel_radius": 1.5},
            {"type": "cylinder", "x": 40.0, "y": -40.0, "radius": 0.5, "z_min": -30.0},
        ]  # fmt: skip
        sensors = {"compass": {"type": "ideal_magnetometer"}}
        world = make_scenario([[0.0, 0.0, -10.0]], sensors=sensors, controller=TRUTH, obstacles=obstacles).world()
        sensor: Any = world.fleets[0].sensors[0]
        centres = np.array(list(sensor.steel.centre_ned.axes)).T
        np.testing.assert_allclose(centres, [[20.0, -1.0, -5.0], [-20.0, 4.0, -15.0], [32.0, 33.0, -4.0]])
        np.testing.assert_allclose(sensor.steel.radius, [2.0, 1.0, 1.5])
        earth = sensor.earth_field_ned
        place = vector(15.0, -1.0, -5.0)
        one = Steel(vector(20.0, -1.0, -5.0), np.array([2.0]))  # type: ignore[arg-type]
        alone = one.field_ned(earth, place).stack()[0]
        np.testing.assert_allclose(sensor.steel.field_ned(earth, place).stack()[0], alone, atol=0.1)
        assert np.abs(alone).max() > 1.0

    def test_without_steel_there_is_none(self) -> None:
        sensors = {"compass": {"type": "magnetometer"}}
        (fleet,) = make_scenario([[0.0, 0.0, -10.0]], sensors=sensors, controller=TRUTH).world().fleets
        assert fleet.sensors[0].steel is None  # type: ignore[attr-defined]

    def test_a_negative_radius_is_refused(self) -> None:
        mast = {"type": "cylinder", "x": 9.0, "y": 4.0, "radius": 0.5, "z_min": -30.0, "steel_radius": -1.0}
        with pytest.raises(ScenarioError, match=r"steel_radius: -1\.0 is out of range"):
            make_scenario([[0.0, 0.0, -10.0]], obstacles=[mast], controller=TRUTH)


# rms of a sample [uT], samples a second [Hz], step and range [uT], of data sheets; std of scale and of angles [%], and
# of the slow error [uT], assumed; docs/howto/sensors_heading_and_height.md.
SHEETS = {
    "hmc5883l": (0.2, 75.0, 0.0917, 130.0, 2.0, 0.2, 0.2),
    "ist8310": (0.3, 100.0, 0.3, 1600.0, 2.0, 0.5, 0.3),
    "lis3mdl": (0.32, 80.0, 0.0146, 400.0, 2.0, 0.5, 0.2),
    "rm3100": (0.015, 147.0, 0.0133, 800.0, 0.5, 0.2, 0.02),
}


@pytest.mark.parametrize("name", SHEETS)
def test_presets_are_those_of_the_data_sheets(name: str) -> None:
    rms, rate, step, largest, scale, angle, drift = SHEETS[name]
    found = PRESETS[name]
    assert set(SHEETS) == set(PRESETS)
    assert found["noise"] * math.sqrt(rate) == pytest.approx(rms)
    assert found["resolution"] == pytest.approx(step, rel=0.005)
    assert (found["range"], found["sample_rate"], found["drift_std"]) == (largest, rate, drift)
    assert (100.0 * found["scale"], 100.0 * found["misalignment"]) == pytest.approx((scale, angle))
    assert found["drift_time_constant"] == 600.0


class TestAllan:
    @pytest.mark.long
    def test_readings_at_rest_have_it(self) -> None:
        """Sixteen chips for an hour; 99.9 % over all windows: N^2/t, and the closed form of the drift."""
        sensor = cast(Magnetometer(noise=0.05, drift_std=0.3, drift_time_constant=60.0, period=0.2), np.float32)  # type: ignore[arg-type]
        row = study.compared(sensor, 18_000, 16, 1.0 - 0.001 / 12.0)
        assert row["inside"] == 1.0
        for window, expected in zip(row["windows_s"], row["expected"], strict=True):
            # By hand: white noise, and the Ornstein-Uhlenbeck process by its autocovariance.
            s = window / 60.0
            drift = 0.09 * (2.0 * s - 3.0 + 4.0 * math.exp(-s) - math.exp(-2.0 * s)) / s**2
            assert expected == pytest.approx(math.sqrt(0.0025 / window + drift), rel=0.02)

    @pytest.mark.long
    def test_the_study(self) -> None:
        found = study.run(full=False)
        row = found["at_rest"]["rm3100"]
        assert row["worst_ratio"] < 1.7
        assert row["fitted_over_true"]["noise"] == pytest.approx(1.0, abs=0.05)
        assert 0.3 < found["heading"]["rm3100"]["rms_deg"] < 10.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"preset": "rm310"}, "did you mean 'rm3100'"),
        ({"noise": -1.0}, "compass.noise: -1.0 is out of range"),
        ({"hard_irn": 1.0}, "no such parameter of 'magnetometer'; did you mean 'hard_iron'"),
    ],
)
def test_errors(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make_scenario([[0.0, 0.0, -10.0]], sensors={"compass": {"type": "magnetometer", **given}}, controller=TRUTH)


@pytest.mark.long
@pytest.mark.usefixtures("optimised")
def test_both_compilers_fly_it_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    import warnings

    flown = []
    mast = {"type": "cylinder", "x": 9.0, "y": 4.0, "radius": 0.5, "z_min": -30.0, "steel_radius": 1.0}
    for compiler in ("llvm", "xla"):
        monkeypatch.setenv("QRSIM_COMPILER", compiler)
        sensors = {"compass": {"type": "magnetometer"}, "true": {"type": "ideal_magnetometer"}}
        world = make_scenario([[0.0, 0.0, -10.0]], sensors=sensors, controller=TRUTH, obstacles=[mast]).world()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            simulation = qrsim.Simulation(world, seed=3)
            simulation.reset()
            reading = simulation.step(ticks=100)
        assert simulation.compiled_by[0] == compiler
        flown.append((reading.compass.field_body, reading.true.field_body))
    for a, b in zip(*flown, strict=True):
        np.testing.assert_allclose(a, b, atol=0.03)
    assert np.abs(flown[0][0] - flown[0][1]).max() > 0.05
