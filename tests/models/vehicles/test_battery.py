"""Voltage and charge by hand."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.models.vehicles.battery import Charge, GivenVoltage, LithiumPolymer, NoCharge
from qrsim.models.vehicles.contracts import Load

PACK = cast(LithiumPolymer(), np.float64)
WEIGHT = np.float64(1.68 * 9.81)


def test_hover_empties_it_in_its_endurance() -> None:
    with jax.enable_x64(True):
        thrust = jnp.full(3, WEIGHT)
        state = PACK.init(thrust)
        for _ in range(480):
            state = PACK.step(state, Load(thrust, WEIGHT), 1.0)
        np.testing.assert_allclose(state.charge, 0.5, rtol=1e-9)


def test_current_grows_with_thrust_to_the_power_three_halves() -> None:
    with jax.enable_x64(True):
        thrust = jnp.array([1.0, 4.0]) * WEIGHT
        drained = 1.0 - PACK.step(PACK.init(thrust), Load(thrust, WEIGHT), 1.0).charge
        assert drained[1] / drained[0] == pytest.approx(8.0, rel=1e-9)


def test_voltage_falls_with_charge_and_sags_under_load() -> None:
    with jax.enable_x64(True):
        thrust = jnp.full(3, WEIGHT)
        hover_current = 6.25 * 3600.0 / 960.0
        found = PACK.voltage(Charge(jnp.array([1.0, 0.5, 0.0])), Load(thrust, WEIGHT))
        expected = np.maximum(np.array([12.0, 10.8, 9.6]) - 0.02 * hover_current, 9.0)
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_charge_stops_at_zero() -> None:
    thrust = jnp.full(1, 16.0)
    state = cast(LithiumPolymer(), np.float32).step(Charge(jnp.full(1, 1e-4)), Load(thrust, jnp.float32(16.0)), 10.0)
    assert state.charge[0] == 0.0


def test_a_given_voltage_is_no_battery_s() -> None:
    assert GivenVoltage().voltage(NoCharge(), Load(jnp.ones(2), jnp.float32(1.0))) is None
