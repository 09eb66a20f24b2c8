"""The jet below a vehicle, and the thrust of a rotor near the ground; numbers by hand."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor.aerodynamics import near_ground
from qrsim.models.vehicles.wake import Wake, jet_velocity

pytestmark = pytest.mark.usefixtures("double_precision")


def below(thrust: float, radius: float, count: int, beside: float, z: float, wind: float = 0.0) -> Vec3:
    one = jnp.ones(1)
    wake = Wake(0.49 * one, count * math.pi * radius**2 * one)
    level = Vec3(0.0 * one, 0.0 * one, one)
    return jet_velocity(
        wake, thrust * one, level, Vec3(wind * one, 0.0 * one, 0.0 * one), Vec3(beside * one, 0.0 * one, z * one)
    )


@pytest.mark.parametrize(("mass", "radius", "count", "speed"), [(2.0643, 0.128, 4, 5.5), (4.0, 0.1905, 6, 7.7)])
def test_speed_five_metres_below(mass: float, radius: float, count: int, speed: float) -> None:
    found = below(mass * 9.81, radius, count, 0.0, 5.0)
    assert float(found.z[0]) == pytest.approx(speed, abs=0.06)
    assert float(found.x[0]) == 0.0


def test_it_spreads_decays_and_begins_at_the_rotors() -> None:
    middle = float(below(20.25, 0.128, 4, 0.0, 5.0).z[0])
    # Half as fast at 0.096 z beside, half as fast at twice the distance.
    assert float(below(20.25, 0.128, 4, 0.48, 5.0).z[0]) == pytest.approx(middle / 2.0, rel=1e-3)
    assert float(below(20.25, 0.128, 4, 0.0, 10.0).z[0]) == pytest.approx(middle / 2.0, rel=1e-9)
    # Nearer than two and a half vehicle sizes, 1.225 m, it is as wide as there.
    near = [float(below(20.25, 0.128, 4, beside, 0.6).z[0]) for beside in (0.0, 0.096 * 1.225)]
    assert near[1] == pytest.approx(near[0] / 2.0, rel=1e-3)
    # No faster than the far wake of hover by momentum theory, 12.7 m/s; nothing above.
    assert float(below(20.25, 0.128, 4, 0.0, 0.5).z[0]) == pytest.approx(12.67, abs=0.02)
    assert float(below(20.25, 0.128, 4, 0.0, -0.5).z[0]) == 0.0


def test_wind_blows_it_aside() -> None:
    """The flow through the rotors is 12.67 m/s down and 8 m/s along: at 5 m below the jet is 3.16 m aside."""
    aside = 5.0 * 8.0 / 12.67
    found = below(20.25, 0.128, 4, aside, 5.0, wind=8.0)
    assert float(found.x[0] / found.z[0]) == pytest.approx(8.0 / 12.67, rel=1e-3)
    assert float(below(20.25, 0.128, 4, 0.0, 5.0, wind=8.0).z[0]) < 0.05 * float(found.z[0])


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
