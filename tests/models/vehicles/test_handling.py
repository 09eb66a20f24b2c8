"""What a controller of tilt and throttle is told of a vehicle: numbers of the published constants, and flights."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.models.vehicles.contracts import Handling
from qrsim.models.vehicles.expression_quadrotor import ExpressionQuadrotor
from qrsim.models.vehicles.quadrotor import Command, Quadrotor
from qrsim.models.vehicles.separate_quadrotor import SeparateQuadrotor
from qrsim.simulation.openloop import hover_state, simulate_open_loop


def of(vehicle: Quadrotor) -> Handling:
    found = vehicle.handling()
    assert found is not None
    return found


def test_the_pelican_answers_as_published() -> None:
    found = of(Quadrotor())
    assert float(found.mass) == pytest.approx(1.68)
    assert float(found.thrust_max) == pytest.approx(32.85, abs=0.005)
    assert float(found.tilt_gain) == pytest.approx(0.745, abs=5e-4)
    assert float(found.yaw_rate_gain) == pytest.approx(0.436, abs=5e-4)
    assert float(found.tilt_max) == pytest.approx(0.9)
    assert found.pitch_gain is None
    # The weight of 1.68 kg, at the root of the published polynomial.
    assert float(found.throttle(jnp.asarray(16.4808))) == pytest.approx(0.59004353932, abs=1e-6)


@pytest.mark.parametrize(
    "vehicle",
    [
        Quadrotor(process_noise=0.0),
        SeparateQuadrotor(process_noise=0.0, kq0=-4.0e-04),
        ExpressionQuadrotor(
            process_noise=0.0,
            thrust_law="2 + 10*throttle + 25*throttle**2 + 3*throttle**3",
            tilt_law="180*(0.8*command - angle) - 24*rate",
            yaw_law="3*command - 6*rate",
        ),
    ],
    ids=["pelican", "separate", "expression"],
)
@pytest.mark.long
def test_a_flight_settles_where_the_handling_says(vehicle: Quadrotor) -> None:
    told = of(vehicle)
    throttle = float(told.throttle(jnp.asarray(18.0)))
    commands = np.tile([-0.1, 0.2, throttle, 0.02, 12.0], (400, 1))
    flown = simulate_open_loop(vehicle, commands, hover_state(vehicle))[-1]
    pitch_gain = told.tilt_gain if told.pitch_gain is None else told.pitch_gain
    assert flown[12] == pytest.approx(18.0, abs=0.25)
    assert flown[11] / 0.02 == pytest.approx(float(told.yaw_rate_gain), rel=1e-2)
    assert flown[3] / 0.2 == pytest.approx(float(told.tilt_gain), rel=1e-2)
    assert flown[4] / -0.1 == pytest.approx(float(pitch_gain), rel=1e-2)


def test_pitch_has_a_gain_of_its_own_where_the_vehicle_has() -> None:
    found = of(SeparateQuadrotor(kq0=-4.0e-04))
    assert found.pitch_gain is not None
    # 4.0e-4 rad/raw over the radians of a raw step, 0.025 degrees.
    assert float(found.pitch_gain) == pytest.approx(0.91673, abs=1e-4)
    assert float(found.tilt_gain) == pytest.approx(0.745, abs=5e-4)


@pytest.mark.parametrize(
    "law",
    [
        {"thrust_law": "20 - 5*throttle"},
        {"thrust_law": "1 / (throttle - 0.5)"},
        {"tilt_law": "-100*angle - 20*rate"},
        {"tilt_law": "command + 0*angle + 0*rate"},
        {"yaw_law": "-command - 5*rate"},
    ],
)
def test_a_law_that_does_not_follow_its_command_has_no_handling(law: dict[str, str]) -> None:
    assert ExpressionQuadrotor(**law).handling() is None


def test_a_straight_curve_has_an_inverse_and_ends_at_full_throttle() -> None:
    curve = (jnp.asarray(1.0), jnp.asarray(20.0), jnp.asarray(0.0))
    told = Handling(*(jnp.asarray(1.0),) * 3, curve, *(jnp.asarray(1.0),) * 3)
    assert np.asarray(told.throttle(jnp.array([0.0, 11.0, 30.0]))) == pytest.approx([0.0, 0.5, 1.0], abs=1e-6)


def test_the_command_of_a_tilt_is_the_vehicles_own() -> None:
    one = jnp.ones(2)
    command = Quadrotor().tilt_command(-0.1 * one, 0.2 * one, 0.5 * one, 0.3 * one)
    assert isinstance(command, Command)
    assert np.asarray(command.pitch) == pytest.approx([-0.1, -0.1])
    assert np.asarray(command.roll) == pytest.approx([0.2, 0.2])
    assert np.asarray(command.throttle) == pytest.approx([0.5, 0.5])
    assert np.asarray(command.yaw_rate) == pytest.approx([0.3, 0.3])
    assert np.asarray(command.battery) == pytest.approx([12.0, 12.0])
