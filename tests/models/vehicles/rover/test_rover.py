"""Rovers: trajectories of an independent implementation, turning circles, slopes, and what a wheel cannot do."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tests.models.vehicles.rover.driving import drive

from qrsim.core.vectors import rotation
from qrsim.models.vehicles.rover import DifferentialRover, Rover, SteeringCommand, WheelCommand


def test_the_golden_trajectory(golden: Path) -> None:
    """Steering and speed that swing for 20 s, at the step and integrator of the reference."""
    path = golden / "vehicles" / "rover.csv"
    names = path.read_text().partition("\n")[0].split(",")
    rows = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
    command = SteeringCommand(rows["steering_cmd"][:-1, None], rows["speed_cmd"][:-1, None])  # type: ignore[arg-type]
    states, _ = drive(Rover(), command, 0.05, substeps=10)
    found = {
        "north": states.position_ned.x,
        "east": states.position_ned.y,
        "heading": states.attitude.yaw,
        "v": states.speed,
        "vy": states.slip_speed,
        "r": states.yaw_rate,
        "delta": states.steering,
    }
    rows["heading"] = (rows["heading"] + math.pi) % (2.0 * math.pi) - math.pi
    for name, values in found.items():
        scale = np.max(np.abs(rows[name]))
        np.testing.assert_allclose(values[:, 0], rows[name][1:], rtol=0.0, atol=1e-9 * scale, err_msg=name)


# Speed, steering, radius of the circle and acceleration to the side, of a 1:10 car on a grip of 0.7 (6.867 m/s^2).
CIRCLES = np.array([[1.5, 0.2, 1.641, 1.4], [3.0, 0.2, 1.669, 5.4], [6.0, 0.2, 5.454, 6.66], [0.4, 0.3, 1.079, 0.15]])


@pytest.mark.parametrize("dt", [0.02, pytest.param(0.005, marks=pytest.mark.long)])
def test_turning_circles(dt: float) -> None:
    """From where tyres do not slip, hypot(L/tan(0.3), lr) = 1.079, to where they slide."""
    speed, steering, radius, side = CIRCLES.T
    whole = np.ones((round(12.0 / dt), 1))
    states, force = drive(Rover(), SteeringCommand(whole * steering, whole * speed), dt)
    found = np.hypot(states.speed[-1], states.slip_speed[-1]) / states.yaw_rate[-1]
    np.testing.assert_allclose(found, radius, rtol=0.01)
    assert found[3] == pytest.approx(math.hypot(0.33 / math.tan(0.3), 0.165), rel=1e-3)
    np.testing.assert_allclose(force.y[-1], side, rtol=0.02)


@pytest.mark.long
def test_specific_force_is_how_the_velocity_changes_less_gravity() -> None:
    """Momentum: f = dv/dt + w x v - g, also on a slope, over steps so short that means are instants."""
    n = 400
    steering = 0.3 * np.sin(np.linspace(0.0, 6.0, n))[:, None]
    normal = (0.1, -0.2, -math.sqrt(0.95))
    states, force = drive(Rover(), SteeringCommand(steering, np.full((n, 1), 2.5)), 1e-3, normal=normal, yaw=0.7)  # type: ignore[arg-type]
    turned = rotation(states.attitude)
    v, vy, r = (np.asarray(values)[:, 0] for values in (states.speed, states.slip_speed, states.yaw_rate))

    def slope(values: np.ndarray) -> np.ndarray:
        return (values[2:] - values[:-2]) / 2e-3

    middle = slice(1, -1)
    at = (np.asarray(force.x)[1:, 0] + np.asarray(force.x)[:-1, 0]) / 2.0
    np.testing.assert_allclose(
        at[1:], slope(v) - (r * vy)[middle] - 9.81 * np.asarray(turned.forward.z)[middle, 0], atol=2e-3
    )
    at = (np.asarray(force.y)[1:, 0] + np.asarray(force.y)[:-1, 0]) / 2.0
    np.testing.assert_allclose(
        at[1:], slope(vy) + (v * r)[middle] - 9.81 * np.asarray(turned.right.z)[middle, 0], atol=2e-2
    )
    np.testing.assert_allclose(force.z, -9.81 * turned.down.z, atol=1e-3)


@pytest.mark.long
def test_the_ground_tilts_it_and_carries_it() -> None:
    """Uphill north by 0.2: pitch atan(0.2) heading north, roll the other way heading east; it climbs as it drives."""
    length = math.hypot(0.2, 1.0)
    normal = (-0.2 / length, 0.0, -1.0 / length)
    whole = np.ones((300, 1))
    for model, command in (
        (Rover(), SteeringCommand(0.0 * whole, whole)),
        (DifferentialRover(), WheelCommand(whole, whole)),
    ):
        north, _ = drive(model, command, 0.02, normal=normal)
        assert north.attitude.pitch[-1, 0] == pytest.approx(math.atan(0.2))
        assert north.attitude.roll[-1, 0] == pytest.approx(0.0, abs=1e-12)
        # The way along the slope is as long as its speed says: 6 s less the lag of 0.4 s.
        assert math.hypot(north.position_ned.x[-1, 0], north.position_ned.z[-1, 0]) == pytest.approx(5.6, abs=0.01)
        assert north.position_ned.z[-1, 0] == pytest.approx(-0.2 * north.position_ned.x[-1, 0])
        east, _ = drive(model, command, 0.02, normal=normal, yaw=0.5 * math.pi)
        # The left side is uphill: it leans to the right.
        assert east.attitude.roll[-1, 0] == pytest.approx(math.atan(0.2))
        assert east.attitude.pitch[-1, 0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.long
def test_wheels_of_two_sides() -> None:
    """r = (left - right) / track x (1 - slip) = 1 / 0.4 x 0.7 rad/s, on a radius of 1.5 / 1.75 m; backwards too."""
    whole = np.ones((500, 1))
    states, force = drive(DifferentialRover(), WheelCommand(2.0 * whole, whole), 0.02)  # type: ignore[arg-type]
    turn = (states.attitude.yaw[-1, 0] - states.attitude.yaw[-2, 0]) / 0.02
    assert turn == pytest.approx(1.75, rel=1e-6)
    assert np.ptp(states.position_ned.x[-200:]) / 2.0 == pytest.approx(1.5 / 1.75, rel=0.01)
    assert force.y[-1, 0] == pytest.approx(1.5 * 1.75, rel=1e-6)
    # Faster than its tyres hold: 3 m/s at 0.7 g allows 6.867 / 2.5 rad/s, less than 0.7 / 0.4 x ...
    fast = DifferentialRover(slip=0.0, track=0.2)  # type: ignore[arg-type]
    states, force = drive(fast, WheelCommand(3.0 * whole, 2.0 * whole), 0.02)  # type: ignore[arg-type]
    assert force.y[-1, 0] == pytest.approx(0.7 * 9.81, rel=1e-6)
    states, _ = drive(DifferentialRover(), WheelCommand(-9.0 * whole, -9.0 * whole), 0.02)  # type: ignore[arg-type]
    assert states.left[-1, 0] == pytest.approx(-3.0, abs=1e-6)


def test_presets_differ() -> None:
    assert (Rover(preset="r1").mass, Rover(preset="r1").speed_max) == (10.0, 3.0)
    assert Rover(preset="r1", mass=12.0).mass == 12.0  # type: ignore[arg-type]


@pytest.mark.long
def test_single_precision_keeps_to_double() -> None:
    """After 20 s of weaving they are within a millimetre."""
    n = 1000
    steering = 0.4 * np.sin(np.linspace(0.0, 15.0, n))[:, None]
    command = SteeringCommand(steering, np.full((n, 1), 3.0))  # type: ignore[arg-type]
    double, single = (drive(Rover(), command, 0.02, dtype=kind)[0].position_ned for kind in (np.float64, np.float32))
    np.testing.assert_allclose(single.x, double.x, atol=1e-3)
    np.testing.assert_allclose(single.y, double.y, atol=1e-3)
