"""Numbers of the turbulence field: its von Karman form, what is left out of it, and what a world draws for it."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from tests.models.atmosphere import field_reference as field

from qrsim.core.noise import Draw, Drawn, Key, threefry2x32
from qrsim.core.vectors import Vec3
from qrsim.engine.settings import quick_jit
from qrsim.models.atmosphere.field import DrydenField, FieldWaves, ResidualState
from qrsim.models.atmosphere.field_modes import modes

Floats = np.ndarray[Any, Any]
FOOT = 0.3048
# The smallest set: 8 octaves from 0.5/(1750 ft) on end at this wavenumber [rad/m].
CHAINS, OCTAVES = 8, 8
HIGHEST = 0.5 / 533.4 * 2.0**8
SMALL = {"chains": CHAINS, "octaves": OCTAVES}
# docs/explanation/models/air.md, (A23): 16/(3 pi) and 32/(9 pi).
LENGTH_ALONG, LENGTH_ACROSS = 1.697653, 1.131768


@quick_jit
def gust(turbulence: DrydenField, state: Any, place: Any, drawn: FieldWaves) -> Any:
    """Return gusts (n, 3) at places (n, 3) NED at time 0, heights -down."""
    where = Vec3(*place.T)
    found = turbulence.gust_ned(state, -where.z, where, jnp.int32(0), jnp.zeros((), place.dtype), drawn)
    return found.stack()


def waves_as_they_are() -> FieldWaves:
    """Return the set of waves neither turned nor dilated, with phases spread evenly, standing still."""
    count = 2 * CHAINS
    phase = (np.arange(count) * (2**32 // count) + 12345).astype(np.uint32)
    rows = [Vec3(*(jnp.float32(x) for x in row)) for row in np.eye(3)]
    return FieldWaves(
        jnp.asarray(phase),
        jnp.zeros(count, jnp.uint32),
        jnp.zeros(count, jnp.float32),
        (rows[0], rows[1], rows[2]),
        jnp.float32(1.0),
        jnp.float32(1.0),
    )


@pytest.mark.long
def test_von_karman_field_is_its_waves_and_the_residual_what_they_leave_out() -> None:
    """Vehicles in fours at 10 ft, 15 m and 2500 ft: no residual, and one of north, east and down.

    The first of each is the sum of the waves in double precision, with L = 2500 ft at the last height. The others
    differ from it by sigma and the root of min(1, 16/(3 pi K L)), (A23), which is 1 for the vertical gust at 10 ft.
    """
    turbulence = field.component(spectrum="von_karman", residual="filter", **SMALL)
    heights = np.repeat([10.0 * FOOT, 15.0, 2500.0 * FOOT], 4)
    place = np.column_stack([np.repeat([0.0, 200.0, -100.0], 4), np.full(12, 30.0), -heights])
    residual = np.tile(np.vstack([np.zeros(3), np.eye(3)]), (3, 1)).astype(np.float32)
    drawn = waves_as_they_are()
    found = np.asarray(gust(turbulence, ResidualState(Vec3(*residual.T)), place.astype(np.float32), drawn), float)
    expected, _ = field.reference(turbulence, drawn, place[::4])
    assert np.abs(expected).min() > 0.02
    np.testing.assert_allclose(found[::4], expected, rtol=0.0, atol=2e-4)
    # (A7) to (A9) at 10 and 49.21 ft, with u20 = 8 m/s; at 2500 ft 7.09 ft/s lies between 6.9 and 7.4 of figure 7.
    for group, (length_h, length_w, sigma_h, sigma_w) in enumerate(
        [
            (10.0 / 0.18523**1.2 * FOOT, 10.0 * FOOT, 0.8 / 0.18523**0.4, 0.8),
            (49.2126 / 0.217502**1.2 * FOOT, 15.0, 0.8 / 0.217502**0.4, 0.8),
            (762.0, 762.0, 7.0875 * FOOT, 7.0875 * FOOT),
        ]
    ):
        shares = [min(LENGTH_ALONG / (HIGHEST * length), 1.0) for length in (length_h, length_h, length_w)]
        sizes = np.array([sigma_h, sigma_h, sigma_w]) * np.sqrt(shares)
        differences = found[4 * group + 1 : 4 * group + 4] - found[4 * group]
        np.testing.assert_allclose(differences, np.diag(sizes), rtol=2e-4, atol=2e-6)
    # The limit is reached where K L is less than 16/(3 pi).
    assert HIGHEST * 10.0 * FOOT < LENGTH_ALONG / 1.2


def step_of(turbulence: DrydenField, gusts: Any, normals: Any, velocities: Any) -> Any:
    """Return the residual (n, 3) after 0.2 s in still air, from residuals, normals and velocities (n, 3)."""
    height, still = jnp.full(len(gusts), 15.0), Vec3(*jnp.zeros((3, len(gusts))))
    state = ResidualState(Vec3(*gusts.T))
    after: Any = turbulence.step(state, Drawn(tuple(normals.T)), height, Vec3(*velocities.T), still, 0.2)
    return after.gust.stack()


stepped = quick_jit(step_of)


@quick_jit
def slope_of(turbulence: DrydenField, gusts: Any, normals: Any, velocities: Any) -> Any:
    """Return the slope (n, 3) of the sum of what ``stepped`` returns in the velocities."""
    return jax.grad(lambda given: jnp.sum(step_of(turbulence, gusts, normals, given)))(velocities)


def kept_on(way: float) -> Floats:
    """Return what a residual keeps along a way [m], across it and down: exp(-K way/length), (A23)."""
    return np.exp(-way * HIGHEST / np.array([LENGTH_ALONG, LENGTH_ACROSS, LENGTH_ACROSS]))


def test_a_residual_forgets_along_its_way_and_across_it() -> None:
    """At 4 m/s north, and as much noise as keeps the variance."""
    turbulence = field.component(residual="filter", **SMALL)
    assert turbulence.normals == 3
    assert field.component(**SMALL).normals == 0
    first = np.array([[1.0] * 3, [0.0] * 3, [1.0] * 3, [0.0] * 3], np.float32)
    found = stepped(turbulence, first, 1.0 - first, np.tile(np.array([4.0, 0.0, 0.0], np.float32), (4, 1)))
    kept = kept_on(0.8)
    np.testing.assert_allclose(found, [kept, np.sqrt(1.0 - kept**2)] * 2, rtol=1e-5)


def test_the_way_of_a_vehicle_slower_than_a_millimetre_a_second_is_north() -> None:
    """The way is 0.1 m at least, (A10): at rest and at 0.95 mm/s east it is north, at 1.05 mm/s it is east."""
    turbulence = field.component(residual="filter", **SMALL)
    first = np.array([[1.0] * 3, [0.0] * 3, [1.0] * 3, [1.0] * 3], np.float32)
    velocities = np.array([[0.0] * 3, [0.0] * 3, [0.0, 0.95e-3, 0.0], [0.0, 1.05e-3, 0.0]], np.float32)
    found = stepped(turbulence, first, 1.0 - first, velocities)
    kept = kept_on(0.1)
    np.testing.assert_allclose(found, [kept, np.sqrt(1.0 - kept**2), kept, kept[[1, 0, 2]]], rtol=1e-5)
    assert np.isfinite(slope_of(turbulence, first, 1.0 - first, velocities)).all()


@quick_jit
def drawn_of(turbulence: DrydenField, stream: Any) -> FieldWaves:
    """Return what a world draws with a stream at tick 0."""
    return turbulence.draw_field(Draw(stream, jnp.int32(0), jnp.zeros((), jnp.float32)))


def normals_of(words: tuple[Any, Any]) -> tuple[Floats, Floats]:
    """Return two normals of two words, by Box and Muller: a uniform number of 31 bits, and an angle from -pi to pi."""
    radius = np.sqrt(-2.0 * np.log(((words[0] >> 1) + 0.5) * 2.0**-31))
    angle = words[1].astype(np.int32) * (math.pi * 2.0**-31)
    return radius * np.cos(angle), radius * np.sin(angle)


def test_each_draw_of_a_world_has_numbers_of_its_own() -> None:
    """Of the words of a world's stream, 0 are phases, 1 speeds, 2 and 3 a quaternion, 4 the dilation, 5 the mirror.

    None serves two purposes, or a field would be dilated as it is turned; and which is which is kept, so that a seed
    has the same field again.
    """
    turbulence = field.component(convection_ned=[0.0, 0.0], sweep=2.0, **SMALL)
    ids = np.arange(2 * CHAINS, dtype=np.uint32)
    k = modes(CHAINS, OCTAVES).first.ravel()
    mirrored = set()
    for world in range(6):
        stream: Any = Key.root(31, world).stream("/turbulence", ids)  # type: ignore[arg-type]
        found = drawn_of(turbulence, stream)
        low = np.arange(6, dtype=np.uint32)[:, None] + stream.low
        words: Any = threefry2x32((stream.high, low), (np.zeros((6, 1), np.uint32), ids))  # type: ignore[arg-type]
        cosines, sines = normals_of(words)
        np.testing.assert_array_equal(found.phase, words[0][0])
        dilation = 2.0 ** (int(words[0][4, 0] >> 9) * 2.0**-23 / CHAINS)
        assert float(found.dilation) == pytest.approx(dilation, rel=1e-6)
        speeds = 2.0 * math.pi * np.asarray(found.frequency, np.float64) / (k * dilation)
        np.testing.assert_allclose(speeds, 2.0 * cosines[1], rtol=0.0, atol=1e-5)
        sign = -1.0 if int(words[0][5, 0]) >= 2**31 else 1.0
        assert float(found.handedness) == sign
        w, x, y, z = cosines[2, 0], cosines[3, 0], sines[2, 0], sines[3, 0]
        rows = np.array([[float(part) for part in (row.x, row.y, row.z)] for row in found.turned])
        expected = sign * scipy.spatial.transform.Rotation.from_quat([x, y, z, w]).as_matrix()
        np.testing.assert_allclose(rows, expected, rtol=0.0, atol=2e-6)
        mirrored.add(sign)
    assert mirrored == {1.0, -1.0}
