"""The multirotor against trajectories of an independent implementation, at the same step and integrator."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.contracts import Around
from qrsim.models.vehicles.multirotor import AttitudeCommand, MotorCommand
from qrsim.models.vehicles.multirotor.flight import Noises
from qrsim.models.vehicles.multirotor.sets import SETS

STATES = ("north", "east", "down", "u", "v", "w", "qw", "qx", "qy", "qz", "p", "q", "r")


@pytest.fixture
def vehicles(golden: Path) -> Path:
    return golden / "vehicles"


def table(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    names = path.read_text().partition("\n")[0].split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def flown(name: str, start: Any, commands: Any, wind: tuple[float, float, float], dt: float, substep: float, **more: Any):
    """Fly a vehicle of a set through commands (T,), and return its states (T + 1,)."""
    model = cast(replace(SETS[name](), longest_substep=substep, crash="none", **more), np.float64)
    zero = jnp.zeros(1)
    none = Vec3(zero, zero, zero)
    around = Around(lambda p: (zero, Vec3(zero, zero, zero - 1.0)), none, lambda p: none)
    air = Vec3(*(zero + speed for speed in wind))

    def one(state: Any, command: Any) -> Any:
        after, _ = model.step(
            state, command, lambda trig: trig.rotation().to_body(air), Noises(none, none), dt, around
        )
        return after, after

    run = jax.jit(lambda first, given: jax.lax.scan(one, first, given)[1])
    return model, run(start, commands)


def started(name: str, first: dict[str, float]) -> Any:
    """Return a state of the numbers of a row."""
    zero = jnp.zeros(1)

    def one(*names: str) -> list[Any]:
        return [zero + first[each] for each in names]

    state = cast(SETS[name](), np.float64).initial_state(Vec3(zero, zero, zero), Euler(zero, zero, zero), None, None)
    count = len(state.rotor_speed)
    return replace(
        state,
        position_ned=Vec3(*one("north", "east", "down")), quaternion=Quaternion(*one("qw", "qx", "qy", "qz")),
        velocity_body=Vec3(*one("u", "v", "w")), rates_body=Vec3(*one("p", "q", "r")),
        rotor_speed=tuple(one(*(f"omega{i}" for i in range(count)))) if "omega0" in first else (zero,) * count,
    )  # fmt: skip


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


def test_motor_speeds_and_wind(vehicles: Path) -> None:
    """Six rotors with inertia and gyroscopic moments, 10 s in wind."""
    rows = table(vehicles / "hexa_motors.csv")
    with jax.enable_x64(True):
        fractions = np.stack([rows[f"cmd{i}"][:-1, None] / 700.0 for i in range(6)])
        first = {name: values[0] for name, values in rows.items()}
        _, states = flown(
            "hexa4", started("hexa4", first), MotorCommand.of_count(6)(*fractions), (3.0, -2.0, 0.5), 0.02, 0.002
        )
        compare(states, rows, 1e-9)


def test_attitude_commands(vehicles: Path) -> None:
    """Tilt, yaw and thrust through the stabiliser, whose integral is compared too, 8 s in wind."""
    rows = table(vehicles / "quad_attitude.csv")
    with jax.enable_x64(True):
        throttle = np.sqrt(rows["thrust_cmd"] / (4 * 5.57e-6 * 1500.0**2))
        commands = AttitudeCommand(
            *(column[:-1, None] for column in (rows["pitch_cmd"], rows["roll_cmd"], throttle, rows["yaw_rate_cmd"]))
        )
        first = {name: values[0] for name, values in rows.items()}
        _, states = flown("hummingbird", started("hummingbird", first), commands, (2.0, 1.0, 0.0), 0.02, 0.002)
        compare(states, rows, 1e-9)
        for axis, name in zip("xyz", ("i_roll", "i_pitch", "i_yaw"), strict=True):
            found = np.asarray(getattr(states.rate_integral, axis))[:, 0]
            np.testing.assert_allclose(found, rows[name][1:], rtol=0.0, atol=1e-9 * np.max(np.abs(rows[name])))


def test_drop(vehicles: Path) -> None:
    """Falls, bounces, slides and rests, with the bristles of each foot; to a micrometre."""
    rows = table(vehicles / "contact_drop.csv")
    with jax.enable_x64(True):
        off = MotorCommand.of_count(4)(*np.zeros((4, len(rows["t"]) - 1, 1)))
        first = {name: values[0] for name, values in rows.items()}
        _, states = flown("x500", started("x500", first), off, (0.0, 0.0, 0.0), 0.01, 0.001)
        for name, values in zip(("north", "east", "down"), jax.tree.leaves(states.position_ned), strict=True):
            np.testing.assert_allclose(np.asarray(values)[:, 0], rows[name][1:], rtol=0.0, atol=1e-6)
        for i, brush in enumerate(states.brush[:4]):
            np.testing.assert_allclose(np.asarray(brush.north)[:, 0], rows[f"brush{i}_n"][1:], atol=1e-4)
            np.testing.assert_allclose(np.asarray(brush.east)[:, 0], rows[f"brush{i}_e"][1:], atol=1e-4)
        assert not any(np.any(np.asarray(brush.north)) for brush in states.brush[4:])
