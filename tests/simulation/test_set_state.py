"""Vehicles put somewhere: what their sensors, estimates and loops make of it, and what goes on undisturbed."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import qrsim
from qrsim.control import WaypointSetpoint
from qrsim.simulation.one_world import OneWorld
from qrsim.simulation.placing import checked_rows
from qrsim.simulation.simulation import Simulation

# A tenth of a second after the last fix, in the middle of its period.
BEFORE = 505
HEIGHT = 40.0


@pytest.fixture(scope="module")
def outdoors() -> Simulation:
    """Five vehicles with every kind of noise, which have flown for ten seconds."""
    simulation = qrsim.load("patrol_published", seed=3)
    simulation.reset()
    simulation.step(ticks=BEFORE)
    return simulation


def elsewhere(simulation: Simulation) -> np.ndarray:
    """Return states (n, 6) at rest, at half the distance from the middle, and another height."""
    rows = np.zeros((simulation.size, 6))
    rows[:, :2] = 0.5 * simulation.truth.position_ned[:, :2]
    rows[:, 2] = -HEIGHT
    return rows


@pytest.mark.long
def test_every_sensor_says_the_new_place_at_once_and_later(outdoors):
    """Errors of GNSS are some metres (satellites share them), of its velocity and the height rate below 1 m/s."""
    start, rows = outdoors.save(), elsewhere(outdoors)
    offset = outdoors.reading.gnss.position_ned - outdoors.truth.position_ned
    moved = np.linalg.norm(rows[:, :3] - outdoors.truth.position_ned, axis=1)
    assert moved.min() > 10.0
    reading = outdoors.set_state(rows)
    np.testing.assert_array_equal(reading.gnss.velocity_ned, 0.0)
    np.testing.assert_array_equal(reading.barometer.height_rate, 0.0)
    hold = WaypointSetpoint.of(rows[:, :3] + offset, 0.0)
    for _ in range(50):
        error = reading.gnss.position_ned - outdoors.truth.position_ned
        assert np.abs(error - offset).max() < 3.0
        assert np.abs(reading.gnss.velocity_ned - outdoors.truth.velocity_ned).max() < 1.5
        assert np.abs(reading.barometer.height_rate).max() < 2.0
        assert np.abs(reading.barometer.height + outdoors.truth.position_ned[:, 2]).max() < 3.0
        assert np.abs(reading.attitude.attitude - outdoors.truth.attitude).max() < 0.1
        assert np.linalg.norm(reading.accelerometer.specific_force, axis=1).max() < 20.0
        reading = outdoors.step(hold)
    outdoors.load(start)


def test_a_velocity_in_the_middle_of_a_period_of_gnss_is_measured_whole(outdoors):
    """The next fix is half a period later, and its velocity is over a whole one."""
    start = outdoors.save()
    rows = np.zeros((5, 12))
    rows[:, :6] = elsewhere(outdoors)
    rows[:, 6] = 6.0
    reading = outdoors.set_state(rows)
    np.testing.assert_array_equal(reading.gnss.velocity_ned[:, 0], 6.0)
    for _ in range(20):
        reading = outdoors.step(WaypointSetpoint.of(rows[:, :3] + [50.0, 0.0, 0.0], 0.0))
        assert np.abs(reading.gnss.velocity_ned[:, 0] - 6.0).max() < 2.0
    outdoors.load(start)


def test_loops_and_gusts_start_anew_and_the_battery_and_the_route_go_on(outdoors):
    start, fleet, before = outdoors.save(), outdoors.world.fleets[0], outdoors.state.fleets[0]
    rows = elsewhere(outdoors)
    outdoors.set_state(rows)
    after = outdoors.state.fleets[0]
    for fresh, found in zip(
        jax.tree.leaves(fleet.controller.init(after.estimate)), jax.tree.leaves(after.controller), strict=True
    ):
        np.testing.assert_array_equal(found, fresh)
    believed = np.stack(list(vars(after.estimate.position_ned).values()), axis=1)
    np.testing.assert_allclose(believed, rows[:, :3], rtol=1e-6)
    for kept in ("battery", "guidance", "setpoint"):
        jax.tree.map(np.testing.assert_array_equal, getattr(after, kept), getattr(before, kept))
    for old, new in zip(jax.tree.leaves(before.turbulence), jax.tree.leaves(after.turbulence), strict=True):
        assert (new != old).any()
    assert np.abs(after.specific_force.z + 9.81).max() < 3.0
    outdoors.load(start)


def test_the_others_go_on_to_the_bit_and_the_draws_are_those_of_the_tick(outdoors):
    start, before = outdoors.save(), outdoors.state
    rows = elsewhere(outdoors)
    rows[[0, 2, 3, 4]] = np.nan
    reading = outdoors.set_state(rows)
    after = outdoors.state
    others = [0, 2, 3, 4]
    for old, new in zip(jax.tree.leaves(before.fleets), jax.tree.leaves(after.fleets), strict=True):
        if old.ndim and old.shape[-1] == 5:
            np.testing.assert_array_equal(new[..., others], old[..., others])
    assert not np.array_equal(after.fleets[0].readings[0].position_ned.x, before.fleets[0].readings[0].position_ned.x)
    again = outdoors.set_state(rows)
    np.testing.assert_array_equal(again.gnss.position_ned, reading.gnss.position_ned)
    outdoors.step()
    later = outdoors.set_state(rows)
    assert (later.barometer.height != reading.barometer.height)[1]
    outdoors.load(start)


@pytest.mark.long
def test_machine_code_and_xla_place_alike(outdoors, monkeypatch):
    layout, state = outdoors.packed
    rows, chosen = checked_rows(elsewhere(outdoors), outdoors.vehicle_names, outdoors.dtype)
    given = rows, chosen, np.zeros_like(chosen)
    before = [np.array(part) for part in state]
    native = layout.unpack(outdoors._ticks.place(layout, state, outdoors.tick, given))
    monkeypatch.setenv("QRSIM_COMPILER", "xla")
    other = layout.unpack(OneWorld(outdoors.world).place(layout, state, outdoors.tick, given))
    for part, kept in zip(state, before, strict=True):
        np.testing.assert_array_equal(part, kept, "the state itself is left alone")
    for found, expected in zip(jax.tree.leaves(native.fleets), jax.tree.leaves(other.fleets), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3)
