"""Solutions against dense least squares, and small parts of receivers by hand.

See docs/howto/choose_a_receiver.md, docs/explanation/models/gnss.md.
"""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.models.gnss.contracts import RangeErrors
from qrsim.models.gnss.fixes import GnssFix
from qrsim.models.gnss.per_satellite import with_satellites
from qrsim.models.gnss.receivers import GnssReceiver, SkyState, solve_position
from qrsim.models.gnss.reporting import fix_of, lagged
from qrsim.models.gnss.schedule import is_on
from qrsim.models.gnss.solving import factor, robust, solve

F32 = np.float32
# Elevation and azimuth [deg] of ten satellites.
PLACES = np.radians([[80.0, 10.0], [30.0, 0.0], [40.0, 80.0], [35.0, 150.0], [50.0, 220.0], [25.0, 300.0],
                     [60.0, 120.0], [15.0, 200.0], [20.0, 45.0], [55.0, 330.0]])  # fmt: skip
RAYS = np.stack(
    [np.cos(PLACES[:, 0]) * np.cos(PLACES[:, 1]), np.cos(PLACES[:, 0]) * np.sin(PLACES[:, 1]), -np.sin(PLACES[:, 0])],
    axis=1,
)
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})


def columns(rays: Any, dtype: Any = np.float64) -> Vec3:
    """Return directions (K, 1)."""
    return Vec3(*np.asarray(rays, dtype).T[:, :, None])


def full(*values: float) -> Vec3:
    return Vec3(*(np.full(1, value, F32) for value in values))  # type: ignore[arg-type]


def one(value: Any) -> Any:
    return np.full(1, value, bool if isinstance(value, bool) else F32)


def dense(weight: Any, errors: Any) -> tuple[Any, Any]:
    """Return position and clock (4,) of errors of ranges, -l d + b, and what is left of them, by least squares."""
    design = np.column_stack([-RAYS, np.ones(len(RAYS))])
    root = np.sqrt(weight)
    found = np.linalg.lstsq(design * root[:, None], errors * root)[0]
    return found, errors - design @ found


def huber(size: Any) -> Any:
    """Return the share of weight by (G22): all below 2 sigma, 2 sigma over it up to 6, a thousandth beyond."""
    return np.where(size < 2.0, 1.0, np.where(size < 6.0, 2.0 / size, 0.001))


class TestSolving:
    def test_a_robust_solution_is_that_of_reweighted_least_squares(self) -> None:
        """Twice again, in double precision; at the end some ranges are within 2 sigma, 2 to 6, 6 to 7, and beyond."""
        weight = np.array([1.0, 2.0, 0.5, 1.5, 1.0, 0.7, 1.2, 0.4, 0.9, 1.1])
        std = np.linspace(0.8, 1.2, 10)
        errors = np.array([0.3, -0.5, 0.2, 0.6, -0.4, 4.5, 0.1, 11.0, -0.2, 20.0])
        own = weight * huber(np.abs(dense(weight, errors)[1]) / std)
        size = np.abs(dense(own, errors)[1]) / std
        expected = weight * huber(size)
        assert np.histogram(size, [0.0, 2.0, 6.0, 7.0, 99.0])[0].tolist() == [7, 1, 1, 1]
        with jax.enable_x64(True):

            @jit
            def solved(rays: Vec3, weight: Any, errors: Any, std: Any) -> Any:
                used = weight > 0.0
                solution = robust(solve(rays, weight, used), rays, weight, used, errors, std)
                return solution.weight, solution.of([errors])[0]

            found, moved = solved(columns(RAYS), weight[:, None], errors[:, None], std[:, None])
        np.testing.assert_allclose(np.ravel(found), expected, rtol=1e-8)
        np.testing.assert_allclose(np.ravel(moved.stack()), dense(expected, errors)[0][:3], rtol=1e-8)

    def test_four_satellites_are_enough_and_nothing_is_ever_without_a_number(self) -> None:
        """One column for each count from none to five."""
        used = np.tri(6, 10, -1, dtype=bool).T
        solution = jit(solve)(columns(RAYS, F32), used.astype(F32), used)
        np.testing.assert_array_equal(solution.count, np.arange(6.0))
        np.testing.assert_array_equal(solution.enough, [False] * 4 + [True] * 2)
        for leaf in jax.tree.leaves(solution):
            assert np.isfinite(leaf).all()

    def test_satellites_in_a_plane_give_no_fix(self) -> None:
        """A matrix without an inverse is left undivided: two north and two south, at sines of 0.6 and 0.8.

        About their mean (0, 0, -0.7) xx is 2 (0.64 + 0.36) = 2, zz 4 * 0.01 = 0.04 and xz 0; their product is left.
        """
        rays = np.array([[0.8, 0.0, -0.6], [-0.8, 0.0, -0.6], [0.6, 0.0, -0.8], [-0.6, 0.0, -0.8]])
        used = np.ones((4, 1), bool)
        solution = jit(solve)(columns(rays, F32), np.ones((4, 1), F32), used)
        assert not bool(solution.enough[0])
        np.testing.assert_allclose(np.ravel(solution.inverse), [0.0, 0.0, 0.0, 0.08, 0.0, 0.0], atol=1e-6)

    def test_a_variance_of_nothing_counts_as_1e_minus_20(self) -> None:
        """So that roots have a slope."""
        zero = columns(np.zeros((3, 3)), F32)
        found = jit(factor)(zero, np.zeros((3, 1), F32))
        np.testing.assert_allclose(np.ravel(found), [1e-10, 0.0, 1e-10, 0.0, 0.0, 1e-10], rtol=1e-5)


class TestReceiver:
    def test_four_satellites_are_enough(self) -> None:
        used = np.tri(6, 10, -1, dtype=bool).T
        rays = Vec3(*(np.repeat(axis[:, None], 6, axis=1).astype(F32) for axis in RAYS.T))  # type: ignore[arg-type]
        fix = jit(solve_position)(rays, np.zeros((10, 6), F32), used)
        np.testing.assert_array_equal(np.isfinite(fix.hdop), [False] * 4 + [True] * 2)

    def test_the_hand_list_and_how_many_of_it_are_kept(self) -> None:
        """10 to 13 by the quarter that a normal is in, those with the largest other normals first: here the last."""
        ids = np.arange(1, 33, dtype=np.uint32)
        edges = np.array([-0.7, -0.65, 0.65, 0.7], F32)

        def normal_rows(rows: int, first: int = 0) -> Any:
            return jnp.concatenate([jnp.repeat(jnp.arange(32.0)[:, None], 4, axis=1), jnp.asarray(edges)[None]])[:rows]

        @jit
        def kept() -> Any:
            draw: Any = SimpleNamespace(normal_rows=normal_rows)
            sky = SkyState(full(0, 0, 0), jnp.zeros(32), ids=jnp.asarray(ids))
            return GnssReceiver(satellites="hand_list")._choose_listed(draw, sky)

        listed = np.array([3, 5, 6, 7, 13, 16, 18, 19, 20, 22, 24, 29, 31])
        found = np.asarray(kept())
        for column, count in enumerate((10, 11, 12, 13)):
            np.testing.assert_array_equal(ids[found[:, column]], listed[13 - count :])


class Plain(RangeErrors):
    """Range errors for tests that say nothing of their size."""

    def init(self, draw: Any) -> Any:
        """Return none."""

    def step(self, state: Any, draw: Any, dt: float) -> Any:
        """Return none."""

    def value(self, state: Any) -> Any:
        """Return none."""


def test_errors_that_say_nothing_of_their_size_are_taken_for_a_metre() -> None:
    np.testing.assert_array_equal(Plain().scales(np.zeros(3, np.int32)).signal, [1.0, 1.0, 1.0])  # type: ignore[arg-type]


def test_an_event_begins_and_ends_within_half_of_the_shortest_step() -> None:
    """0.05 ms before the times of one that lasts 2 s."""
    for time, on in ((-5.5e-5, False), (-4.5e-5, True), (1.999945, True), (1.999955, False)):
        assert bool(jit(is_on)(F32(0.5 - time), F32(2.5 - time), np.int32(0), F32(0.5))) is on


class TestReporting:
    @pytest.mark.parametrize(("fixes", "gain"), [(0.0, 1.0), (1.0, 1.0), (4.0, 0.25), (1e6, 0.0951626)])
    def test_a_filter_begins_with_means(self, fixes: float, gain: float) -> None:
        """(G18): max(1/k, 1 - exp(-T/tau)) with T of 0.2 s and tau of 2 s; a filter that has not begun takes all."""
        receiver = SimpleNamespace(corrections="none", period=0.2, loop_time=2.0, smoothing_time=2.0)

        @jit
        def after(fixes: Any) -> Any:
            state: Any = SimpleNamespace(inner=full(0, 0, 0), outer=full(0, 0, 0))
            return lagged(receiver, state, full(1, 2, 3), full(0, 0, 0), fixes)

        inner, outer = after(one(fixes))
        np.testing.assert_allclose(np.ravel(inner.stack()), gain * np.array([1.0, 2.0, 3.0]), rtol=1e-5)
        np.testing.assert_allclose(np.ravel(outer.stack()), gain**2 * np.array([1.0, 2.0, 3.0]), rtol=1e-5)

    def test_accuracies_grow_while_it_coasts(self) -> None:
        """By 2 m/s^2 of velocity, and by that velocity of position: over 0.2 s from 0.1 m/s on."""
        number = one(0.0)
        held = GnssFix(
            full(0, 0, 0), full(1, 2, 3), number, one(1.0), one(2.0), one(3.0), one(4.0), one(5.0), one(0.1), number
        )

        @jit
        def coasting() -> GnssFix:
            now: Any = SimpleNamespace(
                enough=one(False),
                count=number,
                hdop=number,
                vdop=number,
                speed=number,
                seen=number,
                blocked=None,
                mirrored=None,
            )
            quality: Any = SimpleNamespace(fix_type=number, horizontal=number, vertical=number, age=None)
            receiver, place = SimpleNamespace(period=0.2), full(0, 0, 0)
            return fix_of(receiver, now, quality, place, place, held, one(True), None)

        fix = coasting()
        found = [fix.fix_type[0], fix.speed_accuracy[0], fix.horizontal_accuracy[0], fix.vertical_accuracy[0]]
        np.testing.assert_allclose(found, [3.0, 0.5, 4.1, 5.1], rtol=1e-5)


@pytest.fixture(scope="module")
def readings() -> Any:
    """Return readings of a receiver that is jammed, and of one that is misled as well."""
    elevation = np.radians([30.0, 60.0, 45.0, 20.0, 5.0, 40.0])
    azimuth = np.radians([0.0, -90.0, 90.0, 180.0, 10.0, 30.0])
    level = np.cos(elevation)
    rays = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)]).astype(F32)
    receiver = SimpleNamespace(systems="GERC", elevation_mask_rad=math.radians(10.0), cn0_zenith=50.0)
    hides = np.array([False, True, True, False, False, False])[:, None]
    tracked = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0], F32)[:, None]
    number = one(0.0)
    empty = GnssFix(full(0, 0, 0), full(0, 0, 0), *(number,) * 8)

    @partial(jit, static_argnums=0)
    def read(misled: bool) -> GnssFix:
        slots: Any = SimpleNamespace(
            ids=jnp.array([11, 12, 13, 14, 15, 0xFFFFFFFF], jnp.uint32),
            system=jnp.zeros(6, jnp.int32),
            sight=SimpleNamespace(line_of_sight=Vec3(*jnp.asarray(rays)), elevation=jnp.float32(elevation)),
            interference=SimpleNamespace(silent=jnp.zeros(6, bool)),
        )
        effect: Any = SimpleNamespace(jam=one(100.0), misled=one(True) if misled else None)
        now: Any = SimpleNamespace(age=jnp.asarray(tracked))
        skyline = SimpleNamespace(look=lambda position, sight: (jnp.asarray(hides), None))
        place, slow = full(0, 0, -50), jnp.zeros((6, 1))
        return with_satellites(receiver, empty, now, slots, effect, place, None, skyline, slow)

    return read(False), read(True)


class TestSatellites:
    """Tracked in line of sight and by a reflection, hidden, jammed, below the mask, and a free slot."""

    def test_states_are_those_of_the_page(self, readings: Any) -> None:
        """0 not tracked, 1 in line of sight, 2 by a reflection alone, 3 hidden, 4 lost to jammers.

        See docs/howto/choose_a_receiver.md.
        """
        assert [float(state[0]) for state in readings[0].satellite_state] == [1.0, 2.0, 3.0, 4.0, 0.0, 0.0]

    def test_numbers_and_places(self, readings: Any) -> None:
        """A free slot has number -1; azimuths are from north to east, from 0 to a turn."""
        assert [float(number[0]) for number in readings[0].satellite] == [11.0, 12.0, 13.0, 14.0, 15.0, -1.0]
        azimuth = np.degrees([float(value[0]) for value in readings[0].azimuth])
        np.testing.assert_allclose(azimuth, [0.0, 270.0, 90.0, 180.0, 10.0, 0.0], atol=1e-4)

    def test_a_spoofer_sends_all_satellites_nearly_alike(self, readings: Any) -> None:
        """45 dB-Hz at the horizon and 46 at the zenith: 45.5 at 30 deg, 45 + sin 60 deg."""
        found = [float(value[0]) for value in readings[1].cn0]
        np.testing.assert_allclose(found, [45.5, 45.866025, 0.0, 0.0, 0.0, 0.0], rtol=1e-6)
