"""Thermals against numbers that were computed by hand from the equations of Allen, AIAA 2006-1510."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.atmosphere.thermals import SHAPES, Thermals
from qrsim.models.atmosphere.wind import Calm, LogShear

NOWHERE = np.zeros((0, 2))
SQUARE = (-1000.0, 1000.0, -1000.0, 1000.0)
LONE = Thermals(np.zeros((1, 2)), w_star=2.56, z_i=1400.0)  # type: ignore[arg-type]
# Height, distance from the axis, and upward velocity in a square of 2 km with one thermal, and without sink.
BY_HAND = [
    (350.0, 0.0, 2.7255210, 2.7255210),
    (350.0, 30.0, 2.3721063, 2.3729559),
    (350.0, 80.0, 0.2659418, 0.2718547),
    (350.0, 300.0, -0.0065681, 0.0),
    (980.0, 0.0, 1.1880644, 1.1880644),
    (980.0, 60.0, 0.6775575, 0.6785293),
    (980.0, 150.0, -0.1364561, -0.1339347),
    (1300.0, 0.0, -0.1212594, -0.1212594),
    (1300.0, 40.0, -0.1033791, -0.1033791),
    (1300.0, 150.0, 0.0, 0.0),
    (20.0, 5.0, 1.4486009, 1.4486009),
    (1400.0, 0.0, 0.0, 0.0),
    (5000.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0),
    (-3.0, 0.0, 0.0, 0.0),
]

# The same in a mixed layer of 7900 m, whose r1/r2 go through all rows of constants: height, distance, with sink.
OF_ALL_ROWS = [
    (1.6, 14.0, 0.3070358),
    (1.6, 43.0, 0.0463530),
    (16.0, 31.0, 0.6727181),
    (16.0, 92.0, 0.0995849),
    (158.0, 65.0, 1.2905990),
    (158.0, 196.0, 0.1804271),
    (474.0, 93.0, 1.6125969),
    (474.0, 280.0, 0.2111841),
    (1185.0, 124.0, 1.7395666),
    (1185.0, 371.0, 0.2158779),
    (2370.0, 150.0, 1.5874726),
    (2370.0, 449.0, 0.2474135),
    (4740.0, 173.0, 0.9256954),
    (4740.0, 520.0, 0.3617131),
    (6715.0, 180.0, 0.1936103),
    (6715.0, 541.0, 0.0924810),
    (6715.0, 721.0, -0.0518605),
    # Just into a row: r1/r2 is 0.20, 0.31, 0.42, 0.53, 0.64 and 0.75.
    (2.45, 33.0, 0.2179067),
    (56.0, 93.0, 0.6641519),
    (255.0, 153.0, 1.1569968),
    (721.0, 213.0, 1.5682530),
    (1670.0, 273.0, 1.6852322),
    (3770.0, 333.0, 1.2302499),
]


def built(thermals: Thermals, precision: str = "float64") -> Any:
    return cast(thermals.built(SQUARE, ()), precision)


@jax.jit
def evaluate(thermals: Any, place: Vec3, height: Any, second: Any, wind: Any, drawn: Any) -> Any:
    still = Vec3.zeros(height.shape, height.dtype)
    return thermals.velocity_ned(place, height, still, second, jnp.zeros((), height.dtype), wind=wind, drawn=drawn)


def air(thermals: Any, north: Any, height: Any, wind: Any = None, second: int = 0) -> Any:
    """Upward velocity (n,) at places north (n,) on the axis of the area."""
    north, height = (jnp.asarray(values, thermals.z_i.dtype) for values in (north, height))
    found = evaluate(thermals, Vec3(north, 0.0 * north, -height), height, jnp.int32(second), wind or Calm(), None)
    assert not np.any(found.x)
    assert not np.any(found.y)
    return -np.asarray(found.z)


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-7), ("float32", 2e-5)])
def test_the_vertical_velocity_is_that_of_the_paper(precision: str, tolerance: float) -> None:
    height, distance, with_sink, without = np.transpose(BY_HAND)
    with jax.enable_x64(precision == "float64"):
        np.testing.assert_allclose(air(built(LONE, precision), distance, height), with_sink, atol=tolerance)
        free = built(replace(LONE, sink=False), precision)
        np.testing.assert_allclose(air(free, -distance, height), without, atol=tolerance)


def test_broader_ones_have_the_constants_of_their_row() -> None:
    height, distance, expected = np.transpose(OF_ALL_ROWS)
    with jax.enable_x64(True):
        deep = built(replace(LONE, z_i=7900.0))
        np.testing.assert_allclose(air(deep, distance, height), expected, atol=1e-7)


def test_small_ones_are_20_m_wide() -> None:
    with jax.enable_x64(True):
        low = replace(built(replace(LONE, sink=False)), z_i=np.float64(100.0))
        # r2 = 10 m, r1/r2 = 0.151: k = 1.5352, 2.5826, -0.0113, -0.1950; w = 2.56 0.01^(1/3) 0.989 3/1.173801.
        peak = 2.56 * 0.01 ** (1.0 / 3.0) * 0.989 * 3.0 / (1.0 + 0.151 + 0.151**2)
        bell = 1.0 / (1.0 + (1.5352 * (0.5 - 0.0113)) ** 2.5826) - 0.5 * 0.1950
        np.testing.assert_allclose(air(low, [5.0], [1.0]), peak * bell, rtol=1e-12)


def test_the_air_that_rises_sinks_around_it() -> None:
    """Over the area as much sinks as rises, but for what the paper's fits leave: 12 % of it."""
    steps = np.linspace(-995.0, 995.0, 200)
    north, east = (axis.ravel() for axis in np.meshgrid(steps, steps))
    with jax.enable_x64(True):
        thermals = built(replace(LONE, places_ned=np.array([[0.0, 0.0], [500.0, -600.0], [-700.0, 300.0]])))
        for height in (100.0, 400.0, 700.0):
            place, level = Vec3(*map(jnp.asarray, (north, east, 0.0 * east - height))), jnp.full_like(north, height)
            up = -np.asarray(evaluate(thermals, place, level, jnp.int32(0), Calm(), None).z)
            assert up[up > 0.0].sum() > 0.0
            assert abs(up.sum()) < 0.12 * up[up > 0.0].sum()


@pytest.mark.parametrize("shape", SHAPES)
def test_each_bell_has_about_the_volume_of_its_trapezoid(shape: tuple[float, ...]) -> None:
    """Which columns of the paper's listing are k1 to k4, and where k3 stands, is told by this."""
    k1, k2, k3, k4 = shape
    ratio = 0.14 + 0.11 * SHAPES.index(shape)
    x = (np.arange(40000) + 0.5) / 10000.0
    bell = np.maximum(1.0 / (1.0 + (k1 * np.abs(x + k3)) ** k2) + k4 * x, 0.0)
    assert 2.0 * np.sum(bell * x) / 10000.0 == pytest.approx((1.0 + ratio + ratio**2) / 3.0, rel=0.08)


def test_they_drift_with_the_wind_and_come_in_again() -> None:
    """100 s with 10 m/s to the north are 1 km; 2 km are once over the area."""
    wind = cast(LogShear(10.0, np.pi), np.float64)  # type: ignore[arg-type]
    with jax.enable_x64(True):
        # ln(328.084/0.15)/ln(20/0.15) times 10 m/s at 100 m.
        speed = 10.0 * np.log(100.0 / 0.04572) / np.log(6.096 / 0.04572)
        thermals = built(LONE)
        gone = speed * 20.0
        found = air(thermals, [gone, gone + 30.0, 0.0], [350.0] * 3, wind, 20)
        np.testing.assert_allclose(found, [2.7255210, 2.3721063, -0.0065681], atol=1e-6)
        gone = (speed * 3600.0 + 1000.0) % 2000.0 - 1000.0
        np.testing.assert_allclose(air(thermals, [gone], [350.0], wind, 3600), [2.7255210], atol=1e-6)
        held = built(replace(LONE, drifts=False))
        np.testing.assert_allclose(air(held, [0.0], [350.0], wind, 3600), [2.7255210], atol=1e-6)
        slower = built(replace(LONE, drift_height=6.096))
        np.testing.assert_allclose(air(slower, [200.0], [350.0], wind, 20), [2.7255210], atol=1e-6)


def test_their_number_is_by_the_spacing_of_lenschow_and_stephens() -> None:
    """0.6 X Y/(z_i r2) with r2 = 0.102 0.4^(1/3) 0.9 z_i: of 2 km x 2 km and 500 m 141.9, of 1200 m 24.6."""
    assert built(Thermals(NOWHERE, z_i=500.0)).number == 142  # type: ignore[arg-type]
    found = built(Thermals(NOWHERE))  # type: ignore[arg-type]
    assert (found.number, found.drawn_ids) == (25, 25)
    assert built(Thermals(NOWHERE, count=7)).drawn_ids == 7  # type: ignore[arg-type]
    assert (built(LONE).number, built(LONE).drawn_ids) == (1, 0)


def test_places_are_drawn_all_over_the_area() -> None:
    thermals = cast(Thermals(NOWHERE, z_i=200.0).built((100.0, 1100.0, -900.0, -400.0), ()), np.float32)  # type: ignore[arg-type]
    assert thermals.number == 111
    draw = Draw(Key.root(3).stream("/x", jnp.arange(111, dtype=jnp.uint32)), jnp.int32(0), jnp.zeros((), jnp.float32))
    drawn = thermals.draw(draw)
    north, east = np.asarray(drawn.x), np.asarray(drawn.y)
    assert (north.min() > 100.0) & (north.max() < 1100.0) & (east.min() > -900.0) & (east.max() < -400.0)
    parts = [np.asarray(row[0]) / np.sqrt(12.0) + 0.5 for row in draw.uniform_pairs(jnp.zeros(1, jnp.uint32))]
    np.testing.assert_allclose([north, east], [100.0 + 1000.0 * parts[0], -900.0 + 500.0 * parts[1]], rtol=1e-5)
    # Of 111 uniform numbers: the mean within 3.3 of its standard deviations.
    assert abs(north.mean() - 600.0) < 3.3 * 1000.0 / np.sqrt(12.0 * 111.0)
    assert abs(east.mean() + 650.0) < 3.3 * 500.0 / np.sqrt(12.0 * 111.0)
    assert abs(np.corrcoef(north, east)[0, 1]) < 0.31


@pytest.mark.parametrize(
    ("thermals", "bounds", "words"),
    [
        (Thermals(NOWHERE), None, "thermals need a world.area with bounds, box or polygon"),  # type: ignore[arg-type]
        (LONE, (0.0, 900.0, 0.0, 200.0), "z_i: thermals of z_i = 1400 m are 214 m across, and world.area 200 m; "
         "allowed: z_i up to 1307 m, or a larger area"),
        (Thermals(NOWHERE), (0.0, 200.0, 0.0, 200.0), "count: by their spacing none is in world.area, 200 m x 200 m, "  # type: ignore[arg-type]
         "at z_i = 1200 m; give count or places_ned, or a larger area"),
        (Thermals(NOWHERE, count=4), (0.0, 300.0, 0.0, 300.0), "count: 4 thermals of z_i = 1200 m in world.area, "  # type: ignore[arg-type]
         "300 m x 300 m; allowed: at most 3"),
        (Thermals(NOWHERE, z_i=100.0), SQUARE, "count: 3548 thermals of z_i = 100 m in world.area, 2000 m x 2000 m; "  # type: ignore[arg-type]
         "allowed: at most 1000"),
    ],
)  # fmt: skip
def test_thermals_that_an_area_cannot_hold_are_refused(thermals: Thermals, bounds: Any, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        thermals.built(bounds, ())
    assert str(caught.value) == words


@pytest.mark.long
def test_gradients_are_finite_everywhere() -> None:
    """On the axis, at the edge, on the ground and at z_i too."""
    thermals = built(LONE, "float32")
    north = jnp.asarray([0.0, 20.0, 84.3, 168.7, 900.0] * 4, jnp.float32)
    height = jnp.repeat(jnp.asarray([0.0, 350.0, 1272.0, 1400.0], jnp.float32), 5)

    def total(thermals: Any, north: Any, height: Any) -> Any:
        place, still = Vec3(north, 0.0 * north, -height), Vec3(0.0 * north, 0.0 * north, 0.0 * north)
        time = jnp.int32(3), jnp.float32(0.5)
        return jnp.sum(thermals.velocity_ned(place, height, still, *time, wind=Calm(), drawn=None).z)

    slopes = jax.jit(jax.grad(total, (0, 1, 2)))(thermals, north, height)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(slopes))
    assert float(slopes[0].w_star) < 0.0
