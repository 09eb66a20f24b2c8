"""A pack of cells under an X500 in hover, and at its limits; numbers by hand from its equations."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import ScenarioError
from qrsim.models.vehicles.contracts import Load
from qrsim.models.vehicles.lithium_cells import CellsState, LithiumCells
from qrsim.models.vehicles.multirotor.sets import SETS
from qrsim.runs.streams import loads

PACK = cast(LithiumCells(), np.float64)


pytestmark = pytest.mark.usefixtures("double_precision")


def hover() -> Load:
    zero = jnp.zeros(1)
    still = Vec3(zero, zero, zero)
    vehicle = cast(SETS["x500"](), np.float64)
    return vehicle.load(vehicle.initial_state(still, Euler(zero, zero, zero), still, still))


def at(charge: float) -> CellsState:
    return CellsState(*(jnp.array([value]) for value in (charge, 0.0, 0.0)))


def test_power_in_hover() -> None:
    load = hover()
    np.testing.assert_allclose(load.power, 337.0, atol=0.5)
    np.testing.assert_allclose(load.thrust, 2.0643 * 9.81, rtol=1e-12)


@pytest.mark.parametrize(("charge", "voltage", "current"), [(1.0, 16.1, 21.0), (0.25, 14.6, 23.0)])
def test_voltage_and_current(charge: float, voltage: float, current: float) -> None:
    found = float(PACK.voltage(at(charge), hover())[0])
    assert found == pytest.approx(voltage, abs=0.05)
    assert float(PACK.step(at(charge), hover(), 1.0).current[0]) == pytest.approx(current, abs=0.5)


def test_open_circuit_voltage_of_an_almost_empty_pack() -> None:
    """Of a cell -1.031 + 3.685 V at 0, and -1.031 exp(-0.7) + 3.685 + 0.2156/50 - 0.1178/50^2 + 0.3201/50^3 at 0.02."""
    np.testing.assert_allclose(PACK.open_circuit(jnp.array([0.0, 0.02])) / 4.0, [2.654, 3.177288], atol=1e-6)


def test_a_full_pack_is_at_two_hundredths_after_thirteen_minutes() -> None:
    drain = jax.jit(lambda state: PACK.step(state, hover(), 1.0))
    state, seconds = PACK.init(jnp.zeros(1)), 0
    while float(state.charge[0]) > 0.02:
        state, seconds = drain(state), seconds + 1
    assert seconds / 60.0 == pytest.approx(13.0, abs=0.05)


def test_what_it_cannot_give_is_a_brown_out() -> None:
    # A full pack of 16.3 V behind 16 milliohm gives at most V^2 / 4 r = 4.2 kW.
    most = (4.0 * (3.685 + 0.2156 - 0.1178 + 0.3201)) ** 2 / (4.0 * 0.016)
    for power, broken in ((0.99 * most, False), (1.01 * most, True)):
        load = Load(jnp.array([20.0]), jnp.array([20.0]), jnp.array([power]))
        ((_, value, found),) = PACK.own_checks(PACK.step(at(1.0), load, 0.02))
        assert bool(found[0]) is broken
        assert float(value[0]) == pytest.approx(power if broken else 0.0)


def test_a_vehicle_without_a_power_is_refused() -> None:
    fleet = {"battery": {"type": "lithium_cells"}, "controller": {"type": "waypoint", "feed": "truth"}}
    fleet["vehicles"] = [{"position_ned": [0.0, 0.0, -20.0]}]
    with pytest.raises(ScenarioError, match=r"'lithium_cells' is drained by electrical power.*'pelican' has not"):
        qrsim.load_scenario({"name": "x", "fleets": {"a": fleet}})


def test_a_log_has_thrust_power_and_voltage() -> None:
    """The weight of an X500 in hover, and what it takes from a full pack; a column for each of two times."""
    zero = np.zeros((2, 1))
    still = Vec3(zero, zero, zero)
    vehicle = cast(SETS["x500"](), np.float64)
    fleet: Any = SimpleNamespace(vehicle=vehicle, battery=PACK)
    charge = CellsState(zero + 1.0, zero, zero)
    hovers = vehicle.initial_state(still, Euler(zero, zero, zero), still, still)
    state: Any = SimpleNamespace(vehicle=hovers, battery=charge, violation=SimpleNamespace(code=zero))
    found = {name: (leaf, unit) for name, leaf, unit, _ in loads(fleet, state, {"power"})}
    assert list(found) == ["thrust", "battery.voltage"]
    np.testing.assert_allclose(found["thrust"][0], [[20.2508]] * 2, atol=1e-3)
    np.testing.assert_allclose(found["battery.voltage"][0], [[16.1]] * 2, atol=0.05)
