"""The multirotor against trajectories of an independent implementation, at the same step and integrator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from tests.models.vehicles.multirotor.flying import Flown

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor import AttitudeCommand, MotorCommand
from qrsim.models.vehicles.multirotor.sets import SETS

STATES = ("north", "east", "down", "u", "v", "w", "qw", "qx", "qy", "qz", "p", "q", "r")


@pytest.fixture
def vehicles(golden: Path) -> Path:
    return golden / "vehicles"


def table(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    names = path.read_text().partition("\n")[0].split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def flown(name: str, rows: Any, commands: list[Any], wind: Any, dt: float, substep: float) -> Any:
    """Fly a vehicle of a set from the first row through commands, and return its states, leaves (T, 1)."""
    # The air is the same at all heights there, and the torque of the hexarotor is larger.
    vehicle = replace(SETS[name](), longest_substep=substep, thin_air="ignored")
    vehicle = replace(vehicle, torque_ratio=0.022) if name == "hexa4" else vehicle
    flight = Flown(vehicle, dt, wind)
    states = flight.fly(started(flight, {name: values[0] for name, values in rows.items()}), commands)
    return jax.tree.map(lambda *leaves: np.stack(leaves), *[state for state, _ in states])


def started(flight: Flown, first: dict[str, float]) -> Any:
    """Return a state of the numbers of a row."""

    def one(*names: str) -> list[Any]:
        return [np.array([first[each]]) for each in names]

    state = flight.start()
    zero, count = np.zeros(1), len(state.rotor_speed)
    return replace(
        state,
        position_ned=Vec3(*one("north", "east", "down")),
        quaternion=Quaternion(*one("qw", "qx", "qy", "qz")),
        velocity_body=Vec3(*one("u", "v", "w")),
        rates_body=Vec3(*one("p", "q", "r")),
        rotor_speed=tuple(one(*(f"omega{i}" for i in range(count)))) if "omega0" in first else (zero,) * count,
    )


def compare(states: Any, rows: dict[str, np.ndarray[Any, Any]], relative: float) -> None:
    found = {
        **dict(zip(STATES[:3], jax.tree.leaves(states.position_ned), strict=True)),
        **dict(zip(STATES[3:6], jax.tree.leaves(states.velocity_body), strict=True)),
        **dict(zip(STATES[6:10], jax.tree.leaves(states.quaternion), strict=True)),
        **dict(zip(STATES[10:], jax.tree.leaves(states.rates_body), strict=True)),
        **{f"omega{i}": speed for i, speed in enumerate(states.rotor_speed)},
    }
    for name, values in found.items():
        want = rows[name][1:]
        scale = np.max(np.abs(rows[name]))
        np.testing.assert_allclose(np.asarray(values)[:, 0], want, rtol=0.0, atol=relative * scale, err_msg=name)


@pytest.mark.long
def test_motor_speeds_and_wind(vehicles: Path) -> None:
    """Six rotors with inertia and gyroscopic moments, 10 s in wind."""
    rows = table(vehicles / "hexa_motors.csv")
    fractions = np.stack([rows[f"cmd{i}"][:-1] / 700.0 for i in range(6)])
    commands = [MotorCommand.of(each[None]) for each in fractions.T]
    compare(flown("hexa4", rows, commands, (3.0, -2.0, 0.5), 0.02, 0.002), rows, 1e-9)


def test_attitude_commands(vehicles: Path) -> None:
    """Tilt, yaw and thrust through the stabiliser, whose integral is compared too, 8 s in wind."""
    rows = table(vehicles / "quad_attitude.csv")
    throttle = np.sqrt(rows["thrust_cmd"] / (4 * 5.57e-6 * 1500.0**2))
    columns = np.stack((rows["pitch_cmd"], rows["roll_cmd"], throttle, rows["yaw_rate_cmd"]))[:, :-1]
    commands = [AttitudeCommand(*each[:, None]) for each in columns.T]
    states = flown("hummingbird", rows, commands, (2.0, 1.0, 0.0), 0.02, 0.002)
    compare(states, rows, 1e-9)
    for axis, name in zip("xyz", ("i_roll", "i_pitch", "i_yaw"), strict=True):
        found = getattr(states.rate_integral, axis)[:, 0]
        np.testing.assert_allclose(found, rows[name][1:], rtol=0.0, atol=1e-9 * np.max(np.abs(rows[name])))


@pytest.mark.long
def test_drop(vehicles: Path) -> None:
    """Falls, bounces, slides and rests, with the bristles of each foot; to a micrometre."""
    rows = table(vehicles / "contact_drop.csv")
    off = [MotorCommand.of(np.zeros((1, 4)))] * (len(rows["t"]) - 1)
    states = flown("x500", rows, off, (0.0, 0.0, 0.0), 0.01, 0.001)
    for name, values in zip(("north", "east", "down"), jax.tree.leaves(states.position_ned), strict=True):
        np.testing.assert_allclose(values[:, 0], rows[name][1:], rtol=0.0, atol=1e-6)
    for i, brush in enumerate(states.brush):
        # Rotors and top stay off the ground.
        north, east = (rows[f"brush{i}_{axis}"][1:] if i < 4 else 0.0 for axis in "ne")
        np.testing.assert_allclose(brush.north[:, 0], north, rtol=0.0, atol=1e-4)
        np.testing.assert_allclose(brush.east[:, 0], east, rtol=0.0, atol=1e-4)
