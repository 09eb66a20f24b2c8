"""Every sensor can be mounted elsewhere and report late, by one mechanism; where none is, nothing is added."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from component_cases import GROUPS

from qrsim import Simulation
from qrsim.core.noise import Drawn, Key
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import ScenarioError
from qrsim.models.sensors.barometer import BarometerReading
from qrsim.models.sensors.fitting import Fitting, Transit, mounted
from qrsim.scenarios.making import make_scenario
from qrsim.scenarios.scenario import Scenario
from qrsim.world import tick as ticks

Array = np.ndarray[Any, Any]
SENSORS = list(GROUPS["SENSORS"])
DT, ARM, TURNED = 0.02, [0.3, -0.2, 0.1], [0.1, -0.4, 2.0]
STARTS = [[0.0, 0.0, -20.0], [20.0, 0.0, -20.0], [40.0, 0.0, -20.0]]
SEED = 20261122


def scenario(sensors: dict[str, Any], **parts: Any) -> Scenario:
    routes = [{"position_ned": p, "waypoints_ned": [[p[0] - 10.0, 15.0, -25.0]], "yaw_rad": 0.5} for p in STARTS]
    return make_scenario(routes, controller={"type": "waypoint", "feed": "truth"}, sensors=sensors, **parts)


class TestEverySensor:
    @pytest.mark.parametrize("name", SENSORS)
    def test_takes_delay_jitter_and_mounting(self, name: str) -> None:
        period = GROUPS["SENSORS"][name].period
        given = {"delay": 2, "jitter": period, "mount_position_body": ARM, "mount_attitude_deg": [0.0, 0.0, 90.0]}
        (fleet,) = scenario({"one": {"type": name, **given}}).world().fleets
        fitting = fleet.fitting(0)
        assert fitting is not None
        assert (fitting.delay, fitting.jitter) == (2.0, period)
        assert fleet.sensors[0].delay == 0
        assert fitting.position_body is not None
        assert [float(v) for v in jax.tree.leaves(fitting.position_body)] == pytest.approx(ARM)
        assert fitting.attitude is not None
        assert float(fitting.attitude.yaw) == pytest.approx(np.pi / 2)

    def test_a_place_is_one_for_all_vehicles_however_many(self) -> None:
        for count in (1, 2, 3):
            sensors = {"one": {"type": "barometer", "mount_position_body": ARM, "white_std": [0.1] * count}}
            (fleet,) = (
                make_scenario(STARTS[:count], sensors=sensors, controller={"type": "waypoint", "feed": "truth"})
                .world()
                .fleets
            )
            assert fleet.fittings[0] is not None

    @pytest.mark.parametrize("name", SENSORS)
    def test_is_what_it_was_without_them(self, name: str) -> None:
        (fleet,) = scenario({"one": {"type": name, "mount_position_body": [0.0, 0.0, 0.0]}}).world().fleets
        assert fleet.fittings == ()
        assert fleet.stream_names == ("turbulence", "process", "one")

    @pytest.mark.long
    def test_keeps_the_structure_of_the_state(self) -> None:
        """All at once, mounted, late and irregular: reset and step are traced, and agree in shapes and types."""
        given = {"delay": 1, "jitter": 0.01, "mount_position_body": ARM, "mount_attitude_rad": TURNED}
        world = scenario({name: {"type": name, **given} for name in SENSORS}).world()
        key = Key.root(jnp.array([1, 0], jnp.uint32))
        start = jax.eval_shape(ticks.reset, world, key)
        after = jax.eval_shape(lambda w, s: ticks.step(w, s, jnp.int32(3), (None,)), world, start)
        assert jax.tree.structure(start) == jax.tree.structure(after)
        for before, now in zip(jax.tree.leaves(start), jax.tree.leaves(after), strict=True):
            assert (before.shape, before.dtype) == (now.shape, now.dtype)

    @pytest.mark.long
    def test_says_late_what_it_would_have_said_at_once(self) -> None:
        """The same flight with and without a delay of two periods: the same readings, two periods later."""
        flown = []
        for delay in (0, 2):
            sensors = {name: {"type": name, "period": 0.2, "delay": delay} for name in SENSORS}
            simulation = Simulation(scenario(sensors).world(), seed=SEED)
            simulation.reset()
            seen = []
            for _ in range(12):
                simulation.step(ticks=10)
                seen.append(simulation.state.fleets[0].readings)
            flown.append(seen)
        for now, late in zip(flown[0][:-2], flown[1][2:], strict=True):
            for name, a, b in zip(SENSORS, now, late, strict=True):
                for here, there in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
                    np.testing.assert_allclose(here, there, rtol=1e-5, atol=1e-5, err_msg=name)


@pytest.fixture(scope="module")
def flight() -> dict[str, Array]:
    """Truth and readings (ticks, n, ...) of one flight, from tick 0 on."""
    sensors = {
        "plain": {"type": "ideal_barometer"},
        "late": {"type": "ideal_barometer", "delay": 3},
        "slow": {"type": "ideal_gnss", "delay": 0.5, "mount_position_body": ARM},
        "shaky": {"type": "ideal_attitude", "period": 0.04, "delay": 4, "jitter": 0.06},
        "gyroscope": {"type": "ideal_gyroscope", "mount_attitude_rad": TURNED},
        "accelerometer": {"type": "ideal_accelerometer", "mount_position_body": ARM},
        "lost": {"type": "ideal_barometer", "delay": 1},
    }
    faults = [{"sensor": "lost", "kind": "lost", "start": 0.5, "end": 0.6}]
    simulation = Simulation(scenario(sensors, faults=faults).world("float64"), seed=SEED)
    seen: dict[str, list[Any]] = {}
    for tick in range(150):
        reading, truth = simulation.step() if tick else simulation.reset(), simulation.truth
        now = {
            name: getattr(truth, name)
            for name in ("position_ned", "velocity_ned", "attitude", "rates_body", "specific_force")
        }
        now |= {name: getattr(reading, name).height for name in ("plain", "late", "lost")}
        now |= {"slow": reading.slow.position_ned, "slow_velocity": reading.slow.velocity_ned}
        now |= {"shaky": reading.shaky.attitude, "turned": reading.gyroscope.rates_body}
        now |= {"lever": reading.accelerometer.specific_force}
        for name in ("late", "slow", "shaky", "plain"):
            now |= {
                f"{name}_time": getattr(reading, name).time_of_reading,
                f"{name}_fresh": getattr(reading, name).fresh,
            }
        for name, value in now.items():
            seen.setdefault(name, []).append(np.array(value))
    return {name: np.stack(values) for name, values in seen.items()}


class TestDelivery:
    def test_readings_arrive_in_order_and_are_held(self) -> None:
        """Sent at ticks 1, 2 and 3 for 3, 1 and 2 ticks by the first vehicle, at once by the second."""
        first = BarometerReading(np.zeros(2), np.zeros(2))  # type: ignore[arg-type]
        transit = Transit.starting(first, 4, jnp.int32(0), np.zeros(2))  # type: ignore[arg-type]
        seen = []
        for tick, late in enumerate([None, [3, 0], [1, 0], [2, 0], None, None, None]):
            if late is not None:
                reading = BarometerReading(np.full(2, 10.0 * tick), np.zeros(2))  # type: ignore[arg-type]
                transit = transit.sent(reading, jnp.int32(tick), jnp.array(late, jnp.int32))
            told = (transit.delivered(tick).height, transit.time_of_reading(tick), transit.fresh(tick))  # type: ignore[arg-type, attr-defined]
            seen.append(np.stack([np.asarray(value, float) for value in told]))
        height, time, fresh = np.moveaxis(np.array(seen), 1, 0)
        np.testing.assert_array_equal(height[:, 0], [0, 0, 0, 0, 20, 30, 30])
        np.testing.assert_array_equal(height[:, 1], [0, 10, 20, 30, 30, 30, 30])
        np.testing.assert_array_equal(time, height / 10.0)
        np.testing.assert_array_equal(fresh[:, 0], [1, 0, 0, 0, 1, 1, 0])
        np.testing.assert_array_equal(fresh[:, 1], [1, 1, 1, 1, 0, 0, 0])

    @pytest.mark.long
    def test_a_whole_delay(self, flight: dict[str, Array]) -> None:
        np.testing.assert_array_equal(flight["late"][3:], flight["plain"][:-3])
        np.testing.assert_array_equal(flight["late"][:3], flight["plain"][[0, 0, 0]])
        times = DT * np.maximum(np.arange(150) - 3, 0)
        np.testing.assert_allclose(flight["late_time"], np.broadcast_to(times[:, None], (150, 3)), atol=1e-12)
        np.testing.assert_allclose(flight["plain_time"][:, 0], DT * np.arange(150), atol=1e-12)
        assert flight["plain_fresh"].all()

    @pytest.mark.long
    def test_a_part_of_a_period(self, flight: dict[str, Array]) -> None:
        """Fixes of every tenth tick are there five ticks later, and held."""
        fresh = np.flatnonzero(flight["slow_fresh"][:, 1])
        np.testing.assert_array_equal(fresh, [0, *range(15, 150, 10)])
        times = np.round(flight["slow_time"][:, 1] / DT).astype(int)
        np.testing.assert_array_equal(times, [10 * max(0, (tick - 5) // 10) for tick in range(150)])

    @pytest.mark.long
    def test_an_irregular_one_is_true_at_the_time_it_says(self, flight: dict[str, Array]) -> None:
        times = np.round(flight["shaky_time"] / DT).astype(int)
        for vehicle in range(3):
            np.testing.assert_array_equal(flight["shaky"][:, vehicle], flight["attitude"][times[:, vehicle], vehicle])
            assert np.all(np.diff(times[:, vehicle]) >= 0)
            arrived = np.flatnonzero(np.diff(times[:, vehicle]) > 0) + 1
            np.testing.assert_array_equal(arrived, np.flatnonzero(flight["shaky_fresh"][:, vehicle])[1:])
        assert np.any(times[:, 0] != times[:, 1])
        late = np.arange(150)[20:, None] - times[20:]
        assert 6 < late.mean() < 12
        assert late.max() > 12

    @pytest.mark.long
    def test_a_fault_acts_on_what_is_delivered(self, flight: dict[str, Array]) -> None:
        lost = np.flatnonzero(np.isnan(flight["lost"][:, 0]))
        np.testing.assert_array_equal(lost, np.arange(25, 30))
        np.testing.assert_array_equal(flight["lost"][30:], flight["plain"][29:-1])

    @pytest.mark.parametrize("jitter", [0.01, 0.05, 0.1])
    def test_delays_have_a_gamma_distribution(self, jitter: float) -> None:
        """Mean 0.1 s and the spread, in steps of a microsecond; 40 000 draws, 99.9 % of each statistic."""
        draw = Drawn((np.random.default_rng(SEED).standard_normal(40_000),))  # type: ignore[arg-type]
        late = 1e-6 * np.asarray(Fitting(delay=5.0, jitter=jitter).ticks(DT, 1e-6, draw, (40_000,)), np.float64)
        assert abs(late.mean() - 0.1) < 3.3 * jitter / 200.0
        assert late.std() == pytest.approx(jitter, rel=0.025)
        shape = (0.1 / jitter) ** 2
        # Wilson and Hilferty's approximation is good to 0.01 in probability for shapes from 1 on.
        assert scipy.stats.kstest(late, scipy.stats.gamma(shape, scale=0.1 / shape).cdf).statistic < 0.01 + 1.95 / 200.0
        assert late.min() >= 0.0
        assert late.max() <= 0.1 + 6.0 * jitter + 1e-6


class TestMounting:
    @pytest.mark.long
    def test_an_antenna_is_where_it_is_mounted(self, flight: dict[str, Array]) -> None:
        """At fresh fixes, with rotation matrices of SciPy's convention written out in NumPy."""
        fresh = np.arange(15, 150, 10)
        for vehicle in range(3):
            for tick in fresh:
                to_ned = matrix(flight["attitude"][tick - 5, vehicle])
                where = flight["position_ned"][tick - 5, vehicle] + to_ned @ ARM
                np.testing.assert_allclose(flight["slow"][tick, vehicle], where, atol=1e-9)
                swing = to_ned @ np.cross(flight["rates_body"][tick - 5, vehicle], ARM)
                speed = flight["velocity_ned"][tick - 5, vehicle] + swing
                np.testing.assert_allclose(flight["slow_velocity"][tick, vehicle], speed, atol=1e-9)

    def test_an_accelerometer_off_the_centre_feels_the_acceleration_of_its_place(
        self, flight: dict[str, Array]
    ) -> None:
        """The change of the place's own velocity over a step, less that of the centre, in body axes."""
        swing = np.array(
            [
                [matrix(a) @ np.cross(w, ARM) for a, w in zip(*row, strict=True)]
                for row in zip(flight["attitude"], flight["rates_body"], strict=True)
            ]
        )
        for tick in range(1, 150):
            for vehicle in range(3):
                middle = 0.5 * (flight["attitude"][tick - 1, vehicle] + flight["attitude"][tick, vehicle])
                extra = matrix(middle).T @ (swing[tick, vehicle] - swing[tick - 1, vehicle]) / DT
                found = flight["lever"][tick, vehicle] - flight["specific_force"][tick, vehicle]
                np.testing.assert_allclose(found, extra, atol=2e-3 + 0.02 * np.abs(extra).max())
        assert np.abs(flight["lever"] - flight["specific_force"]).max() > 0.1

    @pytest.mark.long
    def test_a_turned_gyroscope_has_axes_of_its_own(self, flight: dict[str, Array]) -> None:
        own = matrix(np.array(TURNED)).T
        np.testing.assert_allclose(flight["turned"], flight["rates_body"] @ own.T, atol=1e-9)
        assert np.abs(flight["rates_body"]).max() > 0.1

    def test_the_attitude_of_turned_axes(self) -> None:
        angles = np.array([0.3, -0.5, 1.2])
        turned = Euler(*(np.asarray(v) for v in TURNED))  # type: ignore[arg-type]
        attitude = Euler(*(np.array([v]) for v in angles))  # type: ignore[arg-type]
        scene = {"attitude": attitude, "rates_body": Vec3(*(np.zeros(1) for _ in range(3)))}  # type: ignore[arg-type]
        found = jax.jit(lambda s: mounted(Fitting(attitude=turned), s, ("attitude",), None, DT))(scene)["attitude"]
        back = matrix(np.array([float(leaf[0]) for leaf in jax.tree.leaves(found)]))
        np.testing.assert_allclose(back, matrix(angles) @ matrix(np.array(TURNED)), atol=1e-6)


def matrix(angles: Array) -> Array:
    """Return the matrix that takes vectors of axes at ZYX Euler angles to those they are turned against."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    found: Array = about_z @ about_y @ about_x
    return found


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"delay": 60}, "barometer.delay: 60 is out of range; allowed: 0 to 50"),
        ({"delay": 0.5}, "0.5 periods of 0.02 s are 0.01 s, not a multiple of the time step 0.02 s"),
        ({"delay": 2, "jitter": 0.05}, "barometer.jitter: 0.05 s is above the delay, 0.04 s"),
        ({"jitter": 0.05}, "barometer.jitter: 0.05 s is above the delay, 0 s"),
        ({"delay": 49, "jitter": 0.02}, "would arrive after 1.1 s; allowed: up to 1 s, 50 periods"),
        ({"delai": 2}, "did you mean 'delay'"),
        ({"mount_position_body": [1.0, 2.0]}, "expected 3 numbers, found 2"),
        ({"mount_attitude_deg": [0.0, 0.0, 900.0]}, "mount_attitude_deg.2: 900 is out of range"),
    ],
)
def test_errors(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        scenario({"barometer": {"type": "barometer", **given}})
