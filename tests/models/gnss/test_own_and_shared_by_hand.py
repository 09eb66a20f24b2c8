"""Whose randomness is whose, and how fast it changes: base station, error budget, errors of a receiver's own.

A seed means the same flight as ever, so the numbers of streams and pairs are given here as they are used.
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
from qrsim.models.gnss.apart import apart_init
from qrsim.models.gnss.base_station import BaseSeen, BaseState, BaseStation, distance
from qrsim.models.gnss.budget import ErrorBudget, one_for_all
from qrsim.models.gnss.errors import GaussMarkov2State
from qrsim.models.gnss.own_errors import step_multipath

# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})
# Any: parameters are declared as arrays.
STATION: Any = BaseStation


class Asked:
    """A draw of ones and zeros in turn, or of zeros alone, that keeps what it was asked for."""

    def __init__(self, scale: float = 1.0, whose: int = -1, asked: list[tuple[int, int, int]] | None = None) -> None:
        self.scale, self.whose = scale, whose
        self.asked: list[tuple[int, int, int]] = [] if asked is None else asked

    def alone(self, number: int) -> Asked:
        """Return the draw of one number."""
        return Asked(self.scale, number, self.asked)

    def normal_rows(self, rows: int, first: int = 0) -> Any:
        """Return rows of 1, 0, 1, 0 and so on."""
        self.asked.append((self.whose, rows, first))
        return jnp.asarray(self.scale * (1.0 - np.arange(rows) % 2)[:, None], jnp.float32)

    def normals(self, count: int) -> Any:
        """Return 1, 0, 1 and so on."""
        return tuple(self.normal_rows(count))


def station(**changes: Any) -> Any:
    return STATION(position_ned=np.zeros(3, np.float32), silent=np.zeros((0, 2), np.float32), **changes)


@pytest.fixture(scope="module")
def based() -> tuple[Any, Any, Any, Any]:
    """Return a base at its start, two processes 60 s later without noise, its carrier 15 s later, and what was drawn.

    The first process has an error of 1 and no drive, the second a drive of 1 and no error.
    """
    asked: tuple[Any, ...] = (Asked(), Asked(0.0), Asked(0.0))

    @jit
    def run(state: Any) -> Any:
        base = station()
        return base.init(asked[0]), base.step(state, asked[1], 60.0), base.carried(state, asked[2], 15.0)

    one, two = np.ones(1, np.float32), np.array([1.0, 0.0], np.float32)
    start: Any = GaussMarkov2State(two, two[::-1].copy())  # type: ignore[arg-type]
    unit: Any = Vec3(one, one, one)  # type: ignore[arg-type]
    return *run(BaseState(start, (start,), unit, unit)), [sorted(draw.asked) for draw in asked]


class TestBaseStation:
    def test_it_begins_with_numbers_of_its_own(self, based: Any) -> None:
        """Stationary: sqrt(b/(a + b)) of the first normal, here 1. 100 s and 20 s: 5/6; 3600 s and 600 s: 6/7."""
        state, _, _, asked = based
        base = 4294967294
        assert asked[0] == [(-1, 2, 64), (base, 3, 0), (base, 3, 32), (base, 12, 8)]
        assert asked[1] == [(-1, 2, 64), (base, 12, 8)]
        np.testing.assert_allclose(state.code.error, math.sqrt(5.0 / 6.0), rtol=1e-6)
        for tilt in state.tilt:
            np.testing.assert_allclose(tilt.error, math.sqrt(6.0 / 7.0), rtol=1e-6)

    def test_its_errors_fade_as_their_times_say(self, based: Any) -> None:
        """100 s and 20 s of multipath, 3600 s and 600 s of what is left of the weather.

        Drive feeds error by sqrt(a (a + b)) (exp(-a t) - exp(-b t))/(b - a).
        """
        later = based[1]
        for state, first, second in ((later.code, 100.0, 20.0), (later.tilt[0], 3600.0, 600.0)):
            a, b = 1.0 / first, 1.0 / second
            slow, fast = math.exp(-60.0 * a), math.exp(-60.0 * b)
            coupled = math.sqrt(a * (a + b)) * (slow - fast) / (b - a)
            np.testing.assert_allclose(state.error, [slow, coupled], rtol=1e-5)
            np.testing.assert_allclose(state.drive, [0.0, fast], rtol=1e-5)

    def test_carrier_phase_forgets_in_thirty_seconds(self, based: Any) -> None:
        _, _, later, asked = based
        np.testing.assert_allclose(later.carrier.stack(), math.exp(-0.5), rtol=1e-6)
        assert asked[2] == [(4294967294, 3, 0)]

    def test_corrections_are_as_old_as_their_interval_at_most(self) -> None:
        """Up to half a millisecond before the next ones are sent: 0.55 ms before, but not 0.45 ms before."""
        nothing: Any = None
        seen: Any = BaseSeen(*(nothing,) * 11)

        @jit
        def age(seconds: Any, fraction: Any) -> Any:
            return station(interval=1.0).heard(seen, nothing, seconds, fraction).age

        times = [(0, 0.25), (0, 0.99945), (0, 0.99955), (7, 0.0)]
        found = [float(age(np.int32(seconds), np.float32(fraction))) for seconds, fraction in times]
        np.testing.assert_allclose(found, [0.25, 0.99945, 0.0, 0.0], atol=1e-6)

    def test_the_length_of_no_way_is_a_rounding_of_one(self) -> None:
        """2^-26, the root of 2^-52, which has a slope."""
        zero: Any = np.zeros(1)
        assert float(distance(Vec3(zero, zero, zero))[0]) == pytest.approx(2.0**-26, rel=1e-6)
        assert float(distance(Vec3(zero + 2.0, zero - 3.0, zero + 6.0))[0]) == pytest.approx(7.0, rel=1e-6)


class TestBudget:
    def test_one_number_stands_for_all(self) -> None:
        draw: Any = Asked()
        found: Any = one_for_all(draw)
        assert found.whose == 4294967295

    def test_satellites_have_the_deviation_of_their_system(self) -> None:
        """Numbered GERC: GPS, Galileo, GLONASS, BeiDou."""
        budget: Any = ErrorBudget(gps=1.0, galileo=2.0, glonass=3.0, beidou=4.0)  # type: ignore[arg-type]
        scales = budget.scales(np.array([0, 1, 2, 3]))
        np.testing.assert_array_equal(scales.signal, [1.0, 2.0, 3.0, 4.0])


class TestApart:
    def test_each_error_has_pairs_of_its_own(self) -> None:
        """Of satellites their numbers from 2^25 and from 2^26 on; of all together four from 16 on."""
        drawn: list[Any] = []

        def normal_pairs(pairs: Any) -> Any:
            drawn.append([int(pair) for pair in pairs])
            return np.zeros((2, 1)), np.zeros((2, 1))

        def normal_rows(rows: int, first: int) -> Any:
            drawn.append((rows, first))
            return np.arange(float(rows))[:, None]

        process = SimpleNamespace(init=lambda normals: normals.rows[0])
        budget: Any = SimpleNamespace(processes=lambda: ((process,) * 4, (process,) * 4))
        draw: Any = SimpleNamespace(normal_pairs=normal_pairs, normal_rows=normal_rows)
        slots: Any = SimpleNamespace(ids=np.array([5, 70000], np.uint32))
        state = apart_init(budget, draw, slots)
        assert drawn == [[33554437, 33624432], [67108869, 67178864], (8, 16)]
        assert [float(part[0]) for part in (state.vertical, state.gradient_north)] == [0.0, 2.0]  # type: ignore[index]
        assert [float(part[0]) for part in (state.gradient_east, state.troposphere)] == [4.0, 6.0]  # type: ignore[index]


def test_multipath_fades_at_rest_and_by_the_way_flown() -> None:
    """(G16): 1/tau = 1/tau_0 + v/L. 3 m/s and 5 m: 0.12 in 0.2 s, besides 0.2/8 and 0.2/200; pairs from 2^24 on."""
    drawn: list[Any] = []

    def uniform_pairs(pairs: Any) -> Any:
        drawn.append(pairs)
        return np.full((2, 1), 0.5, np.float32), np.full((2, 1), -2.0, np.float32)

    receiver = SimpleNamespace(period=0.2, multipath_length=5.0, multipath_time=8.0, multipath_slow_time=200.0)
    before = np.ones((2, 1), np.float32)
    state: Any = SimpleNamespace(fast=before, slow=3.0 * before)
    draw: Any = SimpleNamespace(uniform_pairs=uniform_pairs)
    slots: Any = SimpleNamespace(ids=np.array([5, 70000], np.uint32))
    speed = Vec3(*(np.full(1, v, np.float32) for v in (2.0, -2.0, 1.0)))  # type: ignore[arg-type]
    same: Any = np.array([True, False])
    fast, slow, pairs = jit(lambda v: (*step_multipath(receiver, state, draw, slots, same, v), drawn[0]))(speed)
    np.testing.assert_array_equal(pairs, [16777221, 16847216])
    # A satellite that is new begins with the number as it is.
    quick, lasting = math.exp(-0.145), math.exp(-0.121)
    np.testing.assert_allclose(fast[:, 0], [quick + 0.5 * math.sqrt(1.0 - quick**2), 0.5], rtol=1e-5)
    np.testing.assert_allclose(slow[:, 0], [3.0 * lasting - 2.0 * math.sqrt(1.0 - lasting**2), -2.0], rtol=1e-5)
