"""The jet below a vehicle, and the thrust of a rotor near the ground; numbers by hand."""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor.aerodynamics import near_ground
from qrsim.models.vehicles.wake import Wake, edge, first_jet_speed, jet_axis, jet_share, jet_speed, length, widest

pytestmark = pytest.mark.usefixtures("double_precision")


ONE: Any = np.ones(1)
# Rotor radius [m], rotors, distance between the farthest [m] and mass [kg]: an X500 and a Pelican.
X500, PELICAN = (0.128, 4, 0.49, 2.0643), (0.127, 4, 0.42, 1.68)


def wake_of(radius: float, count: int, size: float) -> Wake:
    return Wake(size * ONE, count * math.pi * radius**2 * ONE)


def speed(law: Any, vehicle: Any, thrust: float, z: float, beside: Any = 0.0) -> Any:
    return np.asarray(law(wake_of(*vehicle[:3]), thrust * ONE, z * ONE, np.atleast_1d(np.square(beside))))


@pytest.mark.parametrize("vehicle", [X500, PELICAN, (0.1905, 6, 0.96, 4.0)])
@pytest.mark.parametrize("radii", [0.5, 2.0, 5.0, 10.0, 16.0, 60.0])
def test_its_momentum_is_the_thrust_at_every_distance(vehicle: Any, radii: float) -> None:
    """The integral of rho w^2 over a plane, by the trapezoidal rule in rings."""
    thrust = vehicle[3] * 9.81
    r = np.linspace(0.0, 12.0, 120_001)
    w = speed(jet_speed, vehicle, thrust, radii * vehicle[0], r)
    assert 1.225 * np.trapezoid(w * w * 2.0 * math.pi * r, r) == pytest.approx(thrust, rel=2e-3)


def test_it_begins_at_twice_the_induced_velocity_and_spreads_as_a_jet() -> None:
    """By hand: sqrt(2 T/(rho A)) = 12.67 m/s; half as fast 0.788 sqrt(A/pi) = 0.202 m beside, until 0.096 z is more."""
    at = functools.partial(speed, jet_speed, X500, 20.25)
    assert at(0.1)[0] == at(2.0)[0] == pytest.approx(12.67, abs=0.01)
    assert at(0.5, 0.2018)[0] == pytest.approx(12.67 / 2.0, abs=0.01)
    # Half as fast at 0.096 z beside, half as fast at twice the distance; nothing above.
    assert at(5.0)[0] == pytest.approx(5.326, abs=0.005)
    assert at(5.0, 0.48)[0] == pytest.approx(5.326 / 2.0, abs=0.005)
    assert at(10.0)[0] == pytest.approx(5.326 / 2.0, abs=0.005)
    assert at(-0.1)[0] == 0.0


def test_it_ends_where_it_is_slower_than_a_tenth_of_a_metre_per_second() -> None:
    """By hand: (1 + 0.414 (r/0.48)^2)^2 = 53.26 at 1.872 m beside, 5 m below; 2.557 m^2/s over 0.1 m/s and 0.096."""
    wake, thrust = wake_of(*X500[:3]), jnp.asarray(20.25 * ONE)
    z = np.linspace(0.0, 300.0, 30_001)
    edges = np.asarray(edge(wake, thrust, jnp.asarray(z)))
    assert edges[500] == pytest.approx(1.872, abs=0.002)
    assert speed(jet_speed, X500, 20.25, 5.0, 1.872)[0] == pytest.approx(0.1, abs=2e-4)
    assert edges.max() == pytest.approx(12.90, abs=0.01)
    assert widest(thrust)[0] == pytest.approx(edges.max(), rel=1e-6)
    assert z[edges > 0.0].max() == pytest.approx(266.3, abs=0.1)
    assert length(thrust)[0] == pytest.approx(266.3, abs=0.1)


@pytest.mark.parametrize(
    ("descent", "share"), [(-3.0, 1.0), (0.0, 1.0), (3.1, 1.0), (4.752, 0.5), (6.4, 0.0), (20.0, 0.0)]
)
def test_in_the_vortex_ring_state_nothing_goes_away_as_a_jet(descent: float, share: float) -> None:
    """It begins at half of the induced velocity of a hover, 6.336 m/s here, and is there at the whole of it."""
    zero, down = 0.0 * ONE, Vec3(0.0 * ONE, 0.0 * ONE, ONE)
    found = jet_share(wake_of(*X500[:3]), 20.25 * ONE, down, Vec3(5.0 * ONE, zero, -descent * ONE))
    assert float(found[0]) == pytest.approx(share, abs=1e-3)


def test_the_first_law_stays() -> None:
    """Half as fast 0.096 x 1.225 m beside, two and a half sizes; a third of the momentum there, 1.07 farther below."""
    at = functools.partial(speed, first_jet_speed, X500, 20.25)
    assert at(5.0)[0] == pytest.approx(5.5, abs=0.06)
    assert at(0.6, 0.096 * 1.225)[0] == pytest.approx(12.67 / 2.0, abs=0.02)
    assert at(-0.5)[0] == 0.0
    r = np.linspace(0.0, 12.0, 120_001)
    for z, share in ((0.6, 0.343), (3.0, 1.068)):
        w = at(z, r)
        assert 1.225 * np.trapezoid(w * w * 2.0 * math.pi * r, r) / 20.25 == pytest.approx(share, abs=0.005)


def test_wind_blows_it_aside() -> None:
    """The flow through the rotors is 12.67 m/s down and 8 m/s along: the axis is 0.631 m aside at 1 m below."""
    zero = 0.0 * ONE
    axis = jet_axis(wake_of(*X500[:3]), 20.25 * ONE, Vec3(zero, zero, ONE), Vec3(8.0 * ONE, zero, zero))
    assert float(axis.x[0] / axis.z[0]) == pytest.approx(8.0 / 12.67, rel=1e-3)
    assert float(axis.dot(axis)[0]) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(("height", "ratio"), [(0.25, 4 / 3), (0.5, 4 / 3), (1.0, 1.067), (2.0, 1.016), (4.0, 1.004)])
def test_ground_effect(height: float, ratio: float) -> None:
    """Height in radii; below half a radius as at half a radius."""
    one = jnp.ones(1)
    per_disc = 1.0 / (2.0 * 1.225 * math.pi * 0.128**2)
    found = near_ground(5.0 * one, 0.0 * one, 0.128 * height * one, jnp.asarray(0.128), per_disc)
    np.testing.assert_allclose(found / 5.0, ratio, atol=5e-4)


def test_ground_effect_fades_with_airspeed() -> None:
    """At an airspeed of the induced velocity, T/(2 rho A) = v_i^2 = 39.6 m^2/s^2, it is half: 1/(1 - 1/32)."""
    one = jnp.ones(1)
    per_disc = 1.0 / (2.0 * 1.225 * math.pi * 0.128**2)
    found = near_ground(5.0 * one, 5.0 * per_disc * one, 0.128 * one, jnp.asarray(0.128), per_disc)
    np.testing.assert_allclose(found / 5.0, 1.0 / (1.0 - 1.0 / 32.0), rtol=1e-9)
