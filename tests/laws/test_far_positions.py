"""A law of whole flights: how a vehicle moves does not depend on where it is, up to 50 km from the origin.

One world has every type of vehicle of the catalogue at every place; a new type is covered by being there.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from component_cases import DT, GROUPS, VEHICLES, example, inputs, parameters_needed
from position_use import only_adds

import qrsim
from qrsim.core.pairs import parts_of, two_sum
from qrsim.core.tree import cast, record, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.engine.settings import _chosen
from qrsim.models.vehicles.fixed_point import FixedPoint
from qrsim.models.vehicles.moving import move
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Quadrotor, QuadrotorState
from qrsim.models.vehicles.recorded_path import PathFile
from qrsim.scenarios.making import make_scenario
from qrsim.simulation.rollout import rollout
from qrsim.simulation.simulation import Simulation

# North, east and down [m]; at 32768 m and 8192 m the spacing of single precision doubles.
PLACES = np.array(
    [
        [0.0, 0.0, -100.0],
        [1000.0, 0.0, -100.0],
        [10000.0, -10000.0, -100.0],
        [49000.0, 49000.0, -100.0],
        [-49000.0, 49000.0, -100.0],
        [32767.0, -32768.5, -100.0],
        [-8192.5, 8191.0, -100.0],
        [100.0, -300.0, -49000.0],
    ]
)
# Those that fly at velocities.
TYPES = [name for name, kind in GROUPS["VEHICLES"].items() if issubclass(kind, Quadrotor)]
# They read the ground below them.
LOOK_WHERE_THEY_ARE = ("multirotor", "rover", "differential_rover")
SLOW = 0.02
BOX = {"type": "box", "x_min": -5e4, "x_max": 5e4, "y_min": -5e4, "y_max": 5e4, "z_min": -5e4}


def far_world(precision: str, types: list[str] = TYPES, sky: dict[str, Any] | None = None, **parts: Any) -> Any:
    """Return a world with a fleet of each type, asked for 0.02 m/s to the north; parts are those of its fleets."""
    fleets = {}
    for i, name in enumerate(types):
        fleets[f"fleet_{i}"] = {
            "vehicle": {"type": name, "process_noise": 0.0, **parameters_needed("VEHICLES", name)},
            "controller": {"type": "velocity", "feed": "truth"},
            "guidance": {"type": "velocity", "velocity_north": SLOW},
            "sensors": {},
            # Every fleet 30 m beside the one before, so that nobody meets.
            "vehicles": [{"position_ned": (place + np.array([0.0, 30.0 * i, 0.0])).tolist()} for place in PLACES],
            **parts,
        }
    return make_scenario(fleets=fleets, area=BOX, duration=200.0, sky=sky or {}).world(precision)


@pytest.fixture(params=["llvm", pytest.param("xla", marks=pytest.mark.long)])
def compiler(request: Any) -> Iterator[str]:
    before = dict(_chosen)
    qrsim.configure(compiler=request.param)
    yield request.param
    _chosen.update(before)


def way(simulation: Simulation, velocity: list[float], seconds: float) -> Any:
    """Return how far each vehicle gets (n, 3) [m] when asked for a velocity, after half a minute to settle."""
    simulation.reset()
    asked = qrsim.VelocitySetpoint.of(np.tile(velocity, (simulation.size, 1)))
    simulation.step(asked, ticks=1500)
    before = simulation.truth.position_ned
    simulation.step(asked, ticks=round(seconds / DT))
    assert simulation.valid.all()
    return simulation.truth.position_ned - before


@cache
def exactly(velocity: tuple[float, ...], seconds: float) -> Any:
    return way(Simulation(far_world("float64")), list(velocity), seconds)


@pytest.mark.long
def test_a_flight_is_the_same_everywhere(compiler: str) -> None:
    """Asked for 0.02 m/s along, across, up and aslant, and for 1.3 m/s across the borders of single precision."""
    # XLA takes a second for each type, and does with all of them what it does with one.
    types = TYPES if compiler == "llvm" else TYPES[:1]
    simulation = Simulation(far_world("float32", types))
    for velocity in ([SLOW, 0.0, 0.0], [-SLOW, SLOW, 0.0], [0.0, 0.0, -SLOW], [1.3, -0.7, 0.1]):
        found = way(simulation, velocity, 60.0)
        np.testing.assert_allclose(found / 60.0, np.tile(velocity, (len(found), 1)), rtol=0.0, atol=0.0005)
        # The same to a ten-thousandth of a spacing of single precision at 49 km, which is 3.9 mm.
        one = found.reshape(len(types), len(PLACES), 3)
        np.testing.assert_allclose(one, np.broadcast_to(one[:, :1], one.shape), rtol=0.0, atol=4e-7)
        if compiler == "llvm":
            np.testing.assert_allclose(found, exactly(tuple(velocity), 60.0), rtol=0.0, atol=2e-4)


@pytest.mark.long
def test_worlds_of_a_rollout_and_their_metrics() -> None:
    ticks = 2000
    flown = rollout(far_world("float32", TYPES[:1]), ticks=ticks, seeds=[1, 2])
    start = PLACES.astype(np.float32)
    np.testing.assert_allclose(
        flown["position_ned"] - start, np.tile([SLOW * ticks * DT, 0.0, 0.0], (2, 8, 1)), atol=0.03
    )
    # A step of 0.4 mm is added to the length of the path, wherever it is flown.
    length = np.linalg.norm(flown["position_ned"] - start, axis=-1)
    np.testing.assert_allclose(flown["distance_m"], length, rtol=0.0, atol=2e-3)
    np.testing.assert_allclose(flown["distance_m"], flown["distance_m"][:1, :1] * np.ones((2, 8)), rtol=0.0, atol=1e-6)


def test_a_state_goes_round_trip_with_both_parts() -> None:
    simulation = Simulation(far_world("float32", TYPES[:1]))
    simulation.reset()
    simulation.step(ticks=777)
    state, saved = simulation.truth.state, simulation.save()
    assert np.any(state[:, :3] != state[:, :3].astype(np.float32))
    simulation.step(ticks=100)
    simulation.set_state(state)
    np.testing.assert_array_equal(simulation.truth.position_ned, state[:, :3])
    simulation.load(saved)
    np.testing.assert_array_equal(simulation.truth.state, state)
    given = state.copy()
    given[:, 0] += 1e-3
    simulation.set_state(given)
    np.testing.assert_allclose(simulation.truth.position_ned[:, 0] - state[:, 0], 1e-3, atol=1e-9)


def test_who_stops_stays_with_both_parts() -> None:
    world = far_world("float32", TYPES[:1])
    simulation = Simulation(replace(world, area=cast(replace(world.area, x_max=49000.4), np.float32)))
    simulation.reset()
    simulation.step(ticks=5000)
    before = simulation.truth.position_ned[3]
    assert simulation.reasons[3].startswith("out_of_area: position_ned.x")
    assert before[0] == pytest.approx(49000.4, abs=5e-3)
    simulation.step(ticks=100)
    np.testing.assert_array_equal(simulation.truth.position_ned[3], before)


@pytest.mark.long
def test_a_receiver_measures_velocity_as_well_far_away() -> None:
    """Where nothing else errs, the difference of two fixes is the velocity: no spacing of 3.9 mm in 0.2 s is in it."""
    receiver = {"type": "gnss_receiver", "range_noise_std": 0.0}
    world = far_world("float32", TYPES[:1], {"errors": {"type": "ou", "std": 0.0}}, sensors={"gnss": receiver})
    simulation = Simulation(world)
    simulation.reset()
    simulation.step(ticks=1500)
    for _ in range(100):
        reading = simulation.step(ticks=10)
        np.testing.assert_allclose(reading.gnss.velocity_ned, simulation.truth.velocity_ned, rtol=0.0, atol=5e-4)
        fixed = simulation.truth.position_ned - simulation.truth.velocity_ned * 0.2
        np.testing.assert_allclose(reading.gnss.position_ned, fixed, rtol=0.0, atol=2.1e-3)


class TestTwoParts:
    def test_the_sum_of_two_numbers_is_exact(self) -> None:
        rng = np.random.default_rng(5)
        a = (rng.uniform(1.0, 49000.0, 1000) * rng.choice([-1, 1], 1000)).astype(np.float32)
        b = rng.uniform(-1.0, 1.0, 1000).astype(np.float32)
        total, rest = two_sum(a, b)  # type: ignore[arg-type]
        np.testing.assert_array_equal(total, a + b)
        exact = a.astype(np.float64) + b
        np.testing.assert_array_equal(total.astype(np.float64) + rest, exact)

    def test_parts_of_a_number(self) -> None:
        high, low = parts_of(np.array([49000.123456789, -0.1, np.nan]), np.float32)
        assert (high.dtype, low.dtype) == (np.float32, np.float32)
        assert high[0] == np.float32(49000.123456789)
        np.testing.assert_allclose(high[:2].astype(np.float64) + low[:2], [49000.123456789, -0.1], rtol=1e-14)
        assert np.isnan(high[2])


@record
class GroundEffect(Quadrotor):
    """A vehicle that looks at its height: it is lifted more the lower it is."""

    def derivative(self, state: Any, command: Any, air_velocity: Any, noise: Any, dt: float) -> Any:
        slope, force = Quadrotor.derivative(self, state, command, air_velocity, noise, dt)
        lift = 0.02 / (1.0 + state.position_ned.z * state.position_ned.z)
        return replace(slope, velocity_body=slope.velocity_body - Vec3(0.0 * lift, 0.0 * lift, lift)), force


@record
class Lander(Quadrotor):
    """A vehicle that does not sink below 1 m."""

    def step(self, state: Any, command: Any, air_velocity: Any, noise: Any, dt: float) -> Any:
        after, force = Quadrotor.step(self, state, command, air_velocity, noise, dt)
        position = after.position_ned
        return replace(after, position_ned=Vec3(position.x, position.y, jnp.minimum(position.z, -1.0))), force


class TestModels:
    @staticmethod
    def arguments(vehicle: Any) -> Any:
        given = inputs(0)
        scene = given["scene"]
        one = np.ones(VEHICLES, np.float32)
        state = QuadrotorState(
            scene["position_ned"], scene["attitude"], scene["velocity_body"], scene["rates_body"], 16.0 * one
        )
        zero = Vec3(0.0 * one, 0.0 * one, 0.0 * one)
        return state, given["command"], lambda trig: zero, ProcessNoise(zero, zero)

    @pytest.mark.parametrize("name", GROUPS["VEHICLES"])
    def test_each_declares_whether_it_only_adds_to_its_position(self, name: str) -> None:
        vehicle = example("VEHICLES", name)
        rules = ("heun", "rk4") if isinstance(vehicle, Quadrotor) else ("",)
        for own in [replace(vehicle, integrator=rule) if rule else vehicle for rule in rules]:
            assert vars(type(own)).get("adds_position", False) == (name not in LOOK_WHERE_THEY_ARE)
            assert only_adds(own) == (name not in LOOK_WHERE_THEY_ARE)

    def test_a_point_that_is_carried_declares_it_too(self, tmp_path: Path) -> None:
        (tmp_path / "way.csv").write_text("time [s],north [m],east [m],down [m]\n0,0,0,0\n9,9,0,0\n", encoding="utf-8")
        carried = FixedPoint(moves_on=PathFile(str(tmp_path / "way.csv"))).prepared(5.0)
        assert vars(type(carried))["adds_position"]
        assert only_adds(cast(carried, np.float32))

    @pytest.mark.parametrize("kind", [GroundEffect, Lander])
    def test_one_that_looks_where_it_is_does_not_inherit_it(self, kind: type) -> None:
        assert not only_adds(cast(kind(), np.float32))
        assert "adds_position" not in vars(kind)

    @pytest.mark.long
    def test_it_flies_slowly_far_away_too(self) -> None:
        """Its height is its own, and its steps are not lost: as in double precision."""
        found = []
        for dtype in (np.float32, np.float64):
            vehicle = cast(GroundEffect(gravity=0.0, kuv=0.0, kw=0.0, cth0=0.0, cth1=0.0, cth2=0.0), dtype)  # type: ignore[arg-type]
            state, command, air, noise = jaxed(self.arguments(vehicle), dtype)
            found.append(drifted(vehicle, state, command, air, noise, dtype))
        np.testing.assert_allclose(found[0], found[1], rtol=0.0, atol=1e-5)
        np.testing.assert_allclose(found[1][:2], [SLOW, 0.0], atol=1e-6)
        assert found[1][2] < -1e-5

    def test_who_lands_stays_on_the_ground(self) -> None:
        vehicle = cast(Lander(), np.float32)
        state, command, air, noise = self.arguments(vehicle)
        one = np.ones(VEHICLES, np.float32)
        low = Vec3(0.0 * one, 0.0 * one, 0.0 * one)
        down = replace(
            state,
            position_ned=Vec3(49000.0 * one, one, -1.0 * one),
            velocity_body=Vec3(0.0 * one, 0.0 * one, one),
            attitude=Euler(0.0 * one, 0.0 * one, 0.0 * one),
            thrust=0.0 * one,
        )
        for _ in range(3):
            down, low, _ = move(vehicle, down, low, command, air, noise, DT)
        np.testing.assert_allclose(np.asarray(down.position_ned.z) + np.asarray(low.z), -1.0, atol=2e-6)


def jaxed(arguments: Any, dtype: Any) -> Any:
    """Return a slow, level state 49 km away and 3 m high, and what goes with it, in a type."""
    _, command, _, noise = arguments
    one = np.ones(VEHICLES, dtype)
    zero = Vec3(0.0 * one, 0.0 * one, 0.0 * one)
    slow = QuadrotorState(
        Vec3(49000.0 * one, -49000.0 * one, -3.0 * one),
        Euler(0.0 * one, 0.0 * one, 0.0 * one),
        Vec3(SLOW * one, 0.0 * one, 0.0 * one),
        zero,
        0.0 * one,
    )
    quiet = cast(replace(command, roll=0.0 * one, pitch=0.0 * one, yaw_rate=0.0 * one, throttle=0.0 * one), dtype)
    return slow, quiet, lambda trig: zero, cast(noise, dtype)


def drifted(vehicle: Any, state: Any, command: Any, air: Any, noise: Any, dtype: Any) -> Any:
    """Return how far (3,) the first vehicle has got in a second."""
    one = dtype == np.float32
    with jax.enable_x64(not one):
        low = Vec3(*(np.zeros(VEHICLES, dtype) for _ in range(3))) if one else None

        @jax.jit
        def run(state: Any, low: Any) -> Any:
            def body(_: Any, carry: Any) -> Any:
                after, rest, _ = move(vehicle, *carry, command, air, noise, DT)
                return after, rest

            return jax.lax.fori_loop(0, 50, body, (state, low))

        after, rest = run(state, low)
        place = np.stack([np.asarray(axis, np.float64)[0] for axis in jax.tree.leaves(after.position_ned)])
        if one:
            place += np.stack([np.asarray(axis, np.float64)[0] for axis in jax.tree.leaves(rest)])
    return place - [49000.0, -49000.0, -3.0]
