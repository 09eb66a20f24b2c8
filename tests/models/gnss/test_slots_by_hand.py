"""The sky with slots from knot to knot, and how many slots it has; by hand from docs/explanation/models/gnss.md."""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.contracts import RangeErrors
from qrsim.models.gnss.slots import SlottedSky, slots_needed
from qrsim.models.site import Site

IDS = np.array([11, 12, 13], np.uint32)
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})


class Rising:
    """Orbits for tests: two satellites high above, which move north, and one below the horizon."""

    def positions_ned(self, seconds: Any, fraction: Any) -> Vec3:
        """Return positions (3,) [m] at a time."""
        north = 1e6 * (seconds.astype(jnp.float32) + fraction)
        return Vec3(north + jnp.array([0.0, 1e7, 0.0]), jnp.zeros(3), jnp.array([-2e7, -2e7, 1e7]))


class Numbered(RangeErrors):
    """Range errors for tests: each step adds the number of the tick whose noise it has."""

    needs_sight: ClassVar[bool] = True

    def init(self, draw: Draw) -> Any:
        """Return no errors."""
        return jnp.zeros(3)

    def step(self, state: Any, draw: Draw, dt: float) -> Any:
        """Return errors that say at which tick they were drawn."""
        return state + draw.tick.astype(jnp.float32)

    def value(self, state: Any) -> Any:
        """Return the errors."""
        return state


class Storm:
    """An interference for tests: errors of a knot are the time that they are asked for."""

    def stormy(self, errors: Any, seconds: Any, fraction: Any) -> Any:
        """Return the time [s] in the place of all but the ionosphere."""
        return replace(errors, signal=jnp.zeros(3) + seconds.astype(jnp.float32) + fraction)

    def at(self, places: Any, seconds: Any, fraction: Any) -> None:
        """Return that nothing interferes at an epoch."""
        return


def sky_of(period: float = 0.5, time_step: float = 0.25, **how: Any) -> SlottedSky:
    parts: Any = (Rising(), Numbered(), IDS, np.array([0, 1, 2], np.int32), period, time_step, 3, 0.1)
    return SlottedSky(*parts, **how)


def at(tick: Any) -> Draw:
    return Draw(Key.root(1).stream("/sky", jnp.asarray(IDS)), jnp.int32(tick), jnp.zeros((), jnp.float32))


@pytest.mark.parametrize(
    ("period", "time_step", "ticks"),
    # 5 s of epochs of 0.2 s; an epoch at each tick; an epoch of more than 10 s; steps longer than an epoch.
    [(0.2, 0.02, 250), (0.2, 0.2, 25), (12.0, 1.0, 12), (0.2, 0.5, 25)],
)
def test_ticks_of_a_knot(period: float, time_step: float, ticks: int) -> None:
    assert sky_of(period, time_step).knot_ticks == ticks


def test_the_first_knot_has_what_is_in_view_and_the_noise_of_tick_one() -> None:
    """Of two satellites in three slots."""
    state = jit(lambda: sky_of().init(at(0)))()
    assert state.slots.places.tolist() == [0, 1, -1]
    assert state.slots.ids.tolist() == [11, 12, 4294967295]
    np.testing.assert_array_equal(state.slots.before.signal[:2], [0.0, 0.0])
    np.testing.assert_array_equal(state.slots.after.signal[:2], [1.0, 1.0])


def test_epochs_are_on_a_line_between_knots() -> None:
    """At tick 2 of 20, 0.5 s, a tenth of the way: errors of 0 m and 1 m at the knots are 0.1 m, and 0.2 m/s."""

    @jit
    def epoch() -> Any:
        sky = sky_of()
        return sky.step(sky.init(at(0)), at(2), jnp.int32(0), jnp.float32(0.5))

    state = epoch()
    assert float(state.slots.part) == pytest.approx(0.1)
    np.testing.assert_allclose(state.range_error, [0.1] * 3, rtol=1e-6)
    np.testing.assert_allclose(state.range_rate_error, [0.2] * 3, rtol=1e-6)
    np.testing.assert_allclose(state.satellites_ned.x, [5e5, 1.05e7, 5e5], rtol=1e-6)


@pytest.mark.parametrize(
    ("period", "time_step", "parts"),
    # Of ticks 2, 3 and 5, at epochs alone: of two ticks each, of one each, and where a tick is longer than an epoch.
    [(0.5, 0.25, [0.1, 0.0, 0.0]), (0.5, 0.5, [0.2, 0.3, 0.5]), (0.25, 0.75, [0.1, 0.15, 0.25])],
)
def test_the_part_of_the_way_is_told_at_epochs(period: float, time_step: float, parts: list[float]) -> None:
    @jit
    def ticks() -> Any:
        sky = sky_of(period, time_step, each_epoch=False)
        first = sky.init(at(0))
        return [sky.step_by_parts(first, at(tick), jnp.int32(tick)).slots.part for tick in (2, 3, 5)]

    assert sky_of(each_epoch=False).steps_by_parts
    np.testing.assert_allclose(ticks(), parts, rtol=1e-6)


def test_a_storm_is_asked_for_at_both_knots() -> None:
    """At 0 s and at 5 s."""
    state = jit(lambda: sky_of(interference=Storm()).init(at(0)))()
    np.testing.assert_allclose(state.slots.before.signal[:2], [0.0, 0.0])
    np.testing.assert_allclose(state.slots.after.signal[:2], [5.0, 5.0])


class Seen:
    """An ephemeris for tests: so many of its satellites are above the site at each of some times [s], else one."""

    def __init__(self, seen: dict[float, int], last: float, satellites: int = 60) -> None:
        self.span_gps_seconds = (0.0, last)
        self._seen, self._satellites = seen, satellites

    def positions_ecef(self, times: Any) -> Any:
        """Return positions (T, S, 3) [m]."""
        count = np.array([self._seen.get(round(float(time), 3), 1) for time in times])
        up = np.arange(self._satellites)[None] < count[:, None]
        ned = np.zeros((len(times), self._satellites, 3))
        ned[..., 2] = np.where(up, -2e7, 2e7)
        return Site().origin_ecef() + ned @ Site().ned_from_ecef_rotation()


@pytest.mark.parametrize(
    ("seen", "last", "duration", "slots"),
    [
        # One more than are seen at once, at the most of the times that are looked at, which are two minutes apart.
        ({0.0: 7}, math.inf, 600.0, 8),
        ({120.0: 7}, math.inf, 600.0, 8),
        ({86280.0: 7}, math.inf, 600.0, 8),
        ({86400.0: 7}, math.inf, 600.0, 8),
        # What is seen a day later, or in between, does not count.
        ({86520.0: 7, 144.0: 9, 60.0: 9}, math.inf, 600.0, 2),
        # Of recorded orbits, the run; of a long one, a day.
        ({600.0: 7, 720.0: 9}, 1e6, 600.0, 8),
        ({86400.0: 7, 86520.0: 9}, 1e6, 2e5, 8),
        # Two slots where none is seen at all, and no more than 48.
        ({}, math.inf, 600.0, 2),
        ({0.0: 47}, math.inf, 600.0, 48),
        ({0.0: 55}, math.inf, 600.0, 48),
    ],
)
def test_slots_that_are_needed(seen: dict[float, int], last: float, duration: float, slots: int) -> None:
    assert slots_needed(Seen(seen, last), Site(), 0.0, duration, 0.1) == slots


def test_slots_where_nothing_is_ever_seen() -> None:
    """One and a spare one, as if one satellite were."""
    empty = SimpleNamespace(span_gps_seconds=(0.0, 1e6), positions_ecef=Seen({600.0: 0, 0.0: 0}, 1e6).positions_ecef)
    assert slots_needed(empty, Site(), 600.0, 0.0, 0.1) == 2
