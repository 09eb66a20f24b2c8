"""Commands of some vehicles: each flies as if all were given the same, the others as if nobody were."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.errors import UsageError
from qrsim.models.vehicles.multirotor.commands import AttitudeCommand, MotorCommand
from qrsim.simulation.block_parts import _finite
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Some

pytestmark = pytest.mark.long

PLACES = [[0.0, 10.0 * i, -20.0] for i in range(3)]
WIND = {"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 270}
TILTED = [0.0, 0.1, 0.59, 0.0, 12.0]
AWAY = qrsim.WaypointSetpoint.of([5.0, 0.0, -22.0], 0.3)
EVERYBODY_AWAY = qrsim.WaypointSetpoint.of([[5.0, 0.0, -22.0]] * 3, 0.3)


@pytest.fixture(scope="module")
def world() -> Any:
    """Gusts and receivers of each, and nothing that takes long to compile."""
    sensors = {"gnss": "gnss_receiver"}
    flying: Any = {"type": "offboard", "feed": "truth"}
    return qrsim.make_world(PLACES, wind=WIND, turbulence="dryden_first_order", sensors=sensors, controller=flying)


def after(world: Any, command: Any, ticks: int = 60) -> Any:
    """The whole state of each vehicle (3, 13) some ticks later, and what the log says of the set-points (3, 3)."""
    sim = Simulation(world, seed=3)
    sim.reset()
    sim.step(command, ticks=ticks)
    setpoint = sim.state.fleets[0].setpoint.position_ned
    return sim.truth.state, np.stack([setpoint.x, setpoint.y, setpoint.z], axis=-1)


@pytest.fixture(scope="module")
def guided(world: Any) -> Any:
    return after(world, None)


def test_who_is_commanded_flies_so_and_nobody_else(world: Any, guided: Any) -> None:
    state, _ = after(world, {"vehicles_1": TILTED})
    np.testing.assert_array_equal(state[1], after(world, [TILTED] * 3)[0][1])
    np.testing.assert_array_equal(state[[0, 2]], guided[0][[0, 2]])
    assert np.abs(state[1, :3] - guided[0][1, :3]).max() > 0.3


def test_who_flies_a_command_of_its_own_knows_where_it_is_too(world: Any) -> None:
    """The controllers are fed with the truth here, which is that of the tick before."""
    sim = Simulation(world, seed=3)
    sim.reset()
    sim.step({"vehicles_1": TILTED}, ticks=60)
    before = sim.truth.position_ned
    sim.step({"vehicles_1": TILTED})
    believed = sim.state.fleets[0].estimate.position_ned
    np.testing.assert_allclose(np.stack([believed.x, believed.y, believed.z], axis=-1), before, atol=1e-4)


def test_kinds_differ_from_vehicle_to_vehicle(world: Any, guided: Any) -> None:
    state, setpoint = after(world, {"vehicles_2": AWAY, "vehicles_0": np.array([TILTED]), "vehicles_1": None})
    for vehicle, everybody in [(0, after(world, [TILTED] * 3)), (1, guided), (2, after(world, EVERYBODY_AWAY))]:
        np.testing.assert_array_equal(state[vehicle], everybody[0][vehicle])
        np.testing.assert_array_equal(setpoint[vehicle], everybody[1][vehicle])
    np.testing.assert_array_equal(setpoint[2], np.float32([5.0, 0.0, -22.0]))


@pytest.mark.nightly
def test_a_multirotor_is_flown_by_its_motors_beside_one_by_tilt(multirotors: Any) -> None:
    motors, tilt = MotorCommand.of(np.full((1, 4), 0.55)), AttitudeCommand(*np.array([[0.0], [0.1], [0.4], [0.0]]))
    everybody_tilts = AttitudeCommand(*np.tile([[0.0], [0.1], [0.4], [0.0]], 3))
    sim = Simulation(multirotors, seed=3)
    sim.reset()
    sim.step({"vehicles_0": motors, "vehicles_2": tilt}, ticks=30)
    expected = [
        after(multirotors, each, 30)[0] for each in (MotorCommand.of(np.full((3, 4), 0.55)), None, everybody_tilts)
    ]
    for vehicle in range(3):
        np.testing.assert_allclose(sim.truth.state[vehicle], expected[vehicle][vehicle], atol=1e-4)
    assert np.ptp(sim.truth.state[:, 12]) > 0.1
    shown = sim.truth.command[:, 2]
    assert np.isnan(shown[0])
    assert shown[2] == np.float32(0.4)


@pytest.fixture(scope="module")
def multirotors() -> Any:
    return qrsim.make_world(
        vehicles=PLACES, wind=WIND, vehicle={"type": "multirotor", "model": "x500"}, controller="cascade"
    )


def test_a_policy_may_command_some(world: Any) -> None:
    def one(reading: Any) -> Any:
        east = 0.01 * reading.gnss.position_ned[2, 1]
        return {"vehicles_1": jnp.stack([0.0 * east, east, 0.59 + 0.0 * east, 0.0 * east, 12.0 + 0.0 * east])}

    plain, compiled = (qrsim.rollout(world, policy, ticks=40, worlds=2) for policy in (one, jax.jit(one)))
    np.testing.assert_allclose(plain["position_ned"], compiled["position_ned"], atol=1e-5)
    guided = qrsim.rollout(world, ticks=40, worlds=2)
    moved = np.abs(plain["position_ned"] - guided["position_ned"]).max(axis=(0, 2))
    assert moved[1] > 0.05
    np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-5)


def test_what_stands_in_the_rows_of_others_is_nobodys_fault(world: Any) -> None:
    """Of three, the first is asked for NaN and the others for nothing: it alone is wrong."""
    asked = AttitudeCommand(*np.array([[np.nan, np.nan, np.nan]] * 4, np.float32))
    some = Some(((np.array([True, False, False]), asked),))
    np.testing.assert_array_equal(_finite(world, (some,)), [False, True, True])
    np.testing.assert_array_equal(_finite(world, (asked,)), [False] * 3)
    np.testing.assert_array_equal(_finite(world, (None,)), [True] * 3)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ({"vehicle_1": TILTED}, "no fleet and no vehicle is called 'vehicle_1'; did you mean 'vehicles_1'?"),
        (
            {"vehicles_1": TILTED, "vehicles": [TILTED] * 3},
            "'vehicles_1' is of fleet 'vehicles', which is given a command too",
        ),
        ({"vehicles_1": TILTED[:4]}, r"expected shape \(1, 5\) \(vehicles; pitch, roll.*found shape \(1, 4\)"),
        ({"vehicles_1": [0.0, 0.1, 9.0, 0.0, 12.0]}, r"throttle of vehicle 0 \('vehicles_1'\) is 9; allowed: 0 to 1"),
        ({"vehicles_1": {"vehicles_1": TILTED}}, "expected one of a vehicle of fleet 'vehicles'"),
        ({"vehicles_2": EVERYBODY_AWAY}, r"expected shape \(1,\), found shape \(3,\)"),
        ({"vehicles_2": MotorCommand.of(np.full((1, 4), 0.5))}, "a MotorCommand4 is not for the vehicles of"),
    ],
)
def test_what_is_wrong_is_said(world: Any, command: Any, said: str) -> None:
    sim = Simulation(world)
    sim.reset()
    with pytest.raises(UsageError, match=said):
        sim.step(command)
