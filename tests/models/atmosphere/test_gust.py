"""Discrete gusts against the formula of MIL-F-8785C."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.gust import DiscreteGust, NoGust

# From the south, so that along, across and down are north, east and down.
GUST = DiscreteGust(start_time=10.5, length=30.0, speed=12.0, wind_from_rad=math.pi, along=4.0, across=-3.0, down=2.0)  # type: ignore[arg-type]
AMPLITUDES = np.array([4.0, -3.0, 2.0])


@jax.jit
def evaluate(gust: Any, place: Vec3, seconds: Any, fraction: Any) -> Any:
    return gust.velocity_ned(place, seconds, fraction).stack()


def at(gust: Any, time: float, position: Any = ((0.0, 0.0, 0.0),), precision: str = "float32") -> np.ndarray[Any, Any]:
    """Gust (n, 3) at a time and positions (n, 3)."""
    with jax.enable_x64(precision == "float64"):
        place = Vec3.of(jnp.asarray(np.array(position), precision))
        whole = math.floor(time)
        time_of = jnp.int32(whole), jnp.asarray(time - whole, precision)
        return np.asarray(evaluate(cast(gust, precision), place, *time_of), np.float64)


def formula(distance: float, length: float) -> float:
    """MIL-F-8785C: nothing, then half of 1 - cos, then everything."""
    return 0.5 * (1.0 - math.cos(math.pi * min(max(distance / length, 0.0), 1.0)))


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-12), ("float32", 5e-6)])
def test_ramp_is_the_standard_formula(precision: str, tolerance: float) -> None:
    for time in (0.0, 10.5, 10.52, 11.0, 11.75, 12.9, 13.0, 13.02, 60.0, 9e6):
        expected = AMPLITUDES * formula(12.0 * (time - 10.5), 30.0)
        np.testing.assert_allclose(at(GUST, time, precision=precision)[0], expected, atol=tolerance)


def test_pulse_falls_again_over_another_length() -> None:
    pulse = replace(GUST, shape="pulse")
    for time, share in ((10.5, 0.0), (11.75, 0.5), (13.0, 1.0), (14.25, 0.5), (15.5, 0.0), (100.0, 0.0)):
        np.testing.assert_allclose(at(pulse, time)[0], AMPLITUDES * share, atol=5e-6)


def test_duration_is_length_over_speed() -> None:
    slower = replace(GUST, length=15.0, speed=6.0)
    np.testing.assert_allclose(at(slower, 12.1), at(GUST, 12.1), atol=1e-6)


def test_travelling_front_meets_vehicles_one_after_the_other() -> None:
    front = replace(GUST, front="travelling", wind_from_rad=math.radians(225.0))
    # Along the wind, from south-west to north-east; crosswind it makes no difference.
    along = np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0)
    places = [along * 24.0, along * 24.0 + [5.0, -5.0, -80.0], along * -24.0, along * 60.0]
    found = at(front, 13.5, places, "float64")
    for place, wind in zip((24.0, 24.0, -24.0, 60.0), found, strict=True):
        # In wind axes: along, and to its right.
        share = formula(12.0 * 3.0 - place, 30.0)
        np.testing.assert_allclose([wind @ along, wind[2]], share * AMPLITUDES[[0, 2]], atol=1e-12)
        np.testing.assert_allclose(wind @ [-along[1], along[0], 0.0], share * AMPLITUDES[1], atol=1e-12)
    # A uniform one is the same everywhere.
    np.testing.assert_array_equal(at(GUST, 12.0, places), np.tile(at(GUST, 12.0), (4, 1)))


def test_gust_late_in_a_long_run_is_as_smooth_as_an_early_one() -> None:
    """At a million seconds a float32 time would move in steps of 0.06 s."""
    late = replace(GUST, start_time=1e6 + 0.5)
    times = np.arange(0.0, 3.0, 0.02)
    early = np.array([at(GUST, 10.0 + time)[0] for time in times])
    np.testing.assert_allclose([at(late, 1e6 + time)[0] for time in times], early, atol=1e-5)


@pytest.mark.long
def test_no_gust_and_gradients() -> None:
    place = Vec3.of(jnp.ones((3, 3), jnp.float32))
    still = NoGust().velocity_ned(place, jnp.int32(3), jnp.float32(0.5))
    np.testing.assert_array_equal(still.stack(), np.zeros((3, 3)))

    def strength(gust: DiscreteGust) -> Any:
        return jnp.sum(gust.velocity_ned(place, jnp.int32(11), jnp.float32(0.3)).stack())

    slopes = jax.grad(strength)(cast(GUST, np.float32))
    assert all(bool(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(slopes))
    assert float(slopes.along) > 0.0 > float(slopes.start_time)


def test_a_travelling_gust_without_speed_or_bearing_goes_with_what_carries_the_turbulence() -> None:
    """The same as with the speed and the bearing of that velocity given: 4 m/s to the north-east."""
    place, time = Vec3.of(jnp.array([[30.0, 40.0, -20.0], [-3.0, 8.0, -5.0]])), (jnp.int32(20), jnp.float32(0.25))
    carried = Vec3(jnp.float32(4.0 * math.cos(0.5)), jnp.float32(4.0 * math.sin(0.5)), jnp.float32(0.0))
    given = cast(replace(GUST, front="travelling", speed=4.0, wind_from_rad=0.5 - math.pi), np.float32)
    expected = given.velocity_ned(place, *time).stack()
    assert float(jnp.abs(expected).max()) > 0.5
    assert given.reads == ()
    for missing in ({"speed": None}, {"wind_from_rad": None}, {"speed": None, "wind_from_rad": None}):
        gust = replace(given, **missing)
        assert gust.reads == ("convection_ned",)
        found = gust.velocity_ned(place, *time, convection_ned=carried).stack()
        np.testing.assert_allclose(found, expected, atol=2e-5)
