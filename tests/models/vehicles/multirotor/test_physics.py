"""Laws of mechanics and the ground, on an X500: seven flights side by side, by one program."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
import pytest
from tests.models.vehicles.multirotor.flying import Flown

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.multirotor import AttitudeCommand
from qrsim.models.vehicles.multirotor.sets import SETS

DT, STEPS = 0.02, 400
FREE, TURNED, RESTS, FALLS, TIPS_BACK, TIPS_OVER, SLIDES = range(7)
COUNT, SLIDING = 7, 12.0
TURN = 1.1
MASS, GRAVITY = 2.0643, 9.81
INERTIA = (0.02166667, 0.02166667, 0.04)


@pytest.fixture(scope="module")
def flights() -> Any:
    """States and specific forces, leaves (T + 1, 7) and (T, 7), of the flights above."""
    with jax.enable_x64(True):
        return flown(np.float64)


def flown(dtype: Any) -> Any:
    flight = Flown(SETS["x500"](), DT, dtype=dtype, count=COUNT)
    start = flight.start()
    east, down = np.zeros(COUNT), np.full(COUNT, -20.0)
    east[:] = 10.0 * np.arange(COUNT)
    roll = np.array([0.0, 0.0, 0.0, 0.2, math.radians(35.0), math.radians(65.0), 0.0])
    down[RESTS] = -0.197
    # The lowest foot on the ground: it is 0.15 m aside and 0.2 m below.
    down[TIPS_BACK:] = -(0.15 * np.sin(roll[TIPS_BACK:]) + 0.2 * np.cos(roll[TIPS_BACK:]))
    down[SLIDES] = -0.197
    ahead = np.where(np.arange(COUNT) == SLIDES, SLIDING, 0.0).astype(dtype)
    yaw = np.array([0.0, TURN, 0.3, 0.0, 0.0, 0.0, 0.0])
    wind = np.zeros((3, COUNT))
    wind[:, FREE] = (4.0, -2.0, 0.5)
    wind[:, TURNED] = (*turned(4.0, -2.0), 0.5)
    wind[:, RESTS] = (8.0, 0.0, 0.0)
    flight.wind = Vec3(*(part.astype(dtype) for part in wind))
    angles = Euler(*(part.astype(dtype) for part in (roll, 0.0 * roll, yaw)))
    with jax.enable_x64(dtype == np.float64):
        attitude = jax.tree.map(lambda leaf: np.array(leaf, dtype), Quaternion.of(angles))
    spun = np.where(np.arange(COUNT) < RESTS, 1.0, 0.0).astype(dtype)
    start = replace(
        start,
        quaternion=attitude,
        yaw_setpoint=yaw.astype(dtype),
        velocity_body=replace(start.velocity_body, x=ahead),
        position_ned=Vec3(np.zeros(COUNT, dtype), east.astype(dtype), down.astype(dtype)),
        rotor_speed=tuple(speed * spun for speed in start.rotor_speed),
    )
    hover = np.sqrt(MASS * GRAVITY / (4 * 8.54858e-6 * 1000.0**2)) * spun
    commands = []
    for k in range(STEPS):
        lean = 0.25 * np.sin(2.0 * np.pi * 0.4 * DT * k) * spun
        # Who rests is asked to turn.
        turns = 2.0 * lean + np.where(np.arange(COUNT) == RESTS, 0.5, 0.0)
        columns = (lean, 0.7 * lean, hover * (1.0 + 0.1 * lean), turns)
        commands.append(AttitudeCommand(*(column.astype(dtype) for column in columns)))
    found = flight.fly(start, commands)
    states = [start, *(state for state, _ in found)]
    stack = lambda items: jax.tree.map(lambda *leaves: np.stack(leaves), *items)  # noqa: E731
    return stack(states), stack([force for _, force in found])


def turned(north: Any, east: Any) -> tuple[Any, Any]:
    c, s = math.cos(TURN), math.sin(TURN)
    return c * north - s * east, s * north + c * east


def axes(states: Any) -> np.ndarray[Any, Any]:
    """Return the rotations (T, n, 3, 3) that take body axes to NED."""
    rows = states.quaternion.rotation()
    return np.stack([np.stack([row.x, row.y, row.z], -1) for row in (rows.forward, rows.right, rows.down)], -1)


def stacked(vector: Vec3) -> np.ndarray[Any, Any]:
    return np.stack([vector.x, vector.y, vector.z], -1)


def test_specific_force_is_what_changes_momentum(flights: Any) -> None:
    """Over each step, dv/dt in NED is the mean specific force turned by the attitude in its middle, and gravity."""
    states, force = flights
    turn = axes(states)
    velocity = np.einsum("tnij,tnj->tni", turn, stacked(states.velocity_body))
    middle = 0.5 * (turn[1:] + turn[:-1])
    gained = np.diff(velocity, axis=0) / DT - np.array([0.0, 0.0, GRAVITY])
    expected = np.einsum("tnij,tnj->tni", middle, stacked(force))
    np.testing.assert_allclose(gained[:, FREE], expected[:, FREE], rtol=0.0, atol=0.02)
    assert np.ptp(expected[:, FREE]) > 5.0


def test_a_world_turned_about_down_turns_the_flight(flights: Any) -> None:
    states, _ = flights
    way = stacked(states.position_ned) - stacked(states.position_ned)[:1]
    north, east = turned(way[:, FREE, 0], way[:, FREE, 1])
    found = np.stack([north, east, way[:, FREE, 2]], -1)
    np.testing.assert_allclose(way[:, TURNED], found, rtol=0.0, atol=1e-9)
    assert np.linalg.norm(found[-1]) > 5.0
    np.testing.assert_allclose(states.rates_body.x[:, TURNED], states.rates_body.x[:, FREE], rtol=0.0, atol=1e-9)


def test_rest_stays_at_rest_in_wind(flights: Any) -> None:
    """Once the feet have sunk in by 3 mm and the bristles hold 8 m/s of wind, nothing moves."""
    states, force = flights
    place = stacked(states.position_ned)[:, RESTS]
    np.testing.assert_allclose(place[200:], place[-1:].repeat(len(place) - 200, 0), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(place[-1], (0.0, 20.0, -0.197), atol=2e-3)
    assert states.standing[-1, RESTS] > 5.0
    np.testing.assert_allclose(stacked(force)[-1, RESTS], (0.0, 0.0, -GRAVITY), atol=0.03)


def test_who_has_no_throttle_holds_no_heading(flights: Any) -> None:
    """Asked to turn for 8 s with motors that are off, it looks where it looked, and would go on from there."""
    states, _ = flights
    np.testing.assert_allclose(states.yaw_setpoint[:, RESTS], 0.3, atol=1e-3)
    # In the air it follows the sum of what is asked for.
    asked = np.sum(2.0 * 0.25 * np.sin(2.0 * np.pi * 0.4 * DT * np.arange(STEPS)) * DT)
    assert states.yaw_setpoint[-1, FREE] == pytest.approx(asked, abs=1e-9)


def test_energy_does_not_grow_without_power(flights: Any) -> None:
    """It falls 20 m with still rotors, bounces, and lies; what a spring holds is counted."""
    states, _ = flights
    points = np.array(
        [
            *((0.15 * a, 0.15 * b, 0.2) for a in (1, -1) for b in (1, -1)),
            (0.0, 0.0, -0.1),
            *((0.174 * a, 0.174 * b, -0.06) for a in (1, -1) for b in (1, -1)),
        ]
    )
    lowest = np.einsum("tj,pj->tp", axes(states)[:, FALLS, 2], points) + states.position_ned.z[:, FALLS, None]
    elastic = 0.5 * MASS * GRAVITY / 0.003 / 4.0 * np.sum(np.maximum(lowest, 0.0) ** 2, -1)
    rates = stacked(states.rates_body)[:, FALLS]
    speed = np.sum(stacked(states.velocity_body)[:, FALLS] ** 2, -1)
    energy = 0.5 * MASS * speed + 0.5 * (rates**2) @ INERTIA
    energy += elastic - MASS * GRAVITY * states.position_ned.z[:, FALLS]
    assert np.max(np.diff(energy)) < 1e-3
    assert energy[0] - energy[-1] == pytest.approx(MASS * GRAVITY * 19.8, rel=0.02)
    # v^2 = m g/c (1 - exp(-2 c h/m)) with the drag of the body c, 0.03 N s^2/m^2; in vacuum it would be 19.7 m/s.
    assert math.sqrt(np.max(speed)) == pytest.approx(17.19, abs=0.03)
    assert np.max(states.impact_speed[:, FALLS]) > 17.0


def test_it_falls_back_on_its_feet_or_tips_over(flights: Any) -> None:
    states, _ = flights
    up = axes(states)[-1, :, 2, 2]
    assert up[TIPS_BACK] > 0.999
    assert up[TIPS_OVER] < 0.3
    assert states.standing[-1, TIPS_BACK] > 0.5
    assert states.hub_contact[:, TIPS_BACK].max() == 0.0
    assert states.hub_contact[-1, TIPS_OVER] == 1.0
    # On a rotor or its back it does not sink in.
    assert states.position_ned.z[-1, TIPS_OVER] < -0.05


def test_it_slides_to_a_stop(flights: Any) -> None:
    """Friction 0.6 of the weight and the drag of the body: v' = -0.6 g - c v^2/m, c 0.02 N s^2/m^2, from 12 m/s.

    At more than 3.5 m/s bristles of 5 mm are stiffer than a substep of 4 ms can follow.
    """
    states, _ = flights
    assert all(np.isfinite(leaf[:, SLIDES]).all() for leaf in jax.tree.leaves(states))
    share, slows = math.sqrt(0.02 / MASS * 0.6 * GRAVITY), math.sqrt(0.6 * GRAVITY * MASS / 0.02)
    for seconds in (0.5, 1.0, 1.5):
        expected = slows * math.tan(math.atan(SLIDING / slows) - share * seconds)
        assert states.velocity_body.x[round(seconds / DT), SLIDES] == pytest.approx(expected, abs=0.1)
    assert states.standing[-1, SLIDES] > 5.0
    assert max(np.abs(brush.north[:, SLIDES]).max() for brush in states.brush) < 1.05


def test_who_starts_on_its_feet_stands_with_still_rotors() -> None:
    """Its feet, 0.2 m below it, have sunk in by 3 mm; nobody who is 11 mm above, moves or leans is touched."""
    down, slides, lean, zero = np.array([7.8, 7.805, 7.789, 7.8, 7.8]), np.zeros(5), np.zeros(5), np.zeros(5)
    slides[3], lean[4] = 0.1, 0.1

    @jax.jit
    def started() -> Any:
        vehicle = cast(SETS["x500"](), np.float64)
        still = Vec3(zero, zero, zero)
        start = vehicle.initial_state(Vec3(zero, zero, down), Euler(lean, zero, zero), Vec3(slides, zero, zero), still)
        found = vehicle.stood(start, lambda place: (zero + 8.0, Vec3(zero, zero, zero - 1.0)))
        return found, vehicle.on_ground(found)

    with jax.enable_x64(True):
        found, stands = started()
    np.testing.assert_allclose(found.position_ned.z, [7.803, 7.803, 7.789, 7.8, 7.8], atol=1e-12)
    assert np.asarray(stands).tolist() == [True, True, False, False, False]
    assert (np.asarray(found.rotor_speed[0]) == 0.0).tolist() == [True, True, False, False, False]


@pytest.mark.long
def test_single_precision_is_close(flights: Any) -> None:
    """Within 5 mm after 8 s of lively flight in wind; at rest within 0.1 mm."""
    single, _ = flown(np.float32)
    difference = stacked(single.position_ned) - stacked(flights[0].position_ned)
    assert np.abs(difference[:, FREE]).max() < 5e-3
    assert np.abs(difference[:, RESTS]).max() < 1e-4
