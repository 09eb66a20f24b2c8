"""The sensor gnss epoch by epoch, under satellites that stand still: (G16) to (G18) by hand."""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.base_station import BaseSeen
from qrsim.models.gnss.presets import PRESETS
from qrsim.models.gnss.sensor import Gnss
from qrsim.models.gnss.sight import CommonErrors, Scales, Sight
from qrsim.models.gnss.slots import Slots

F32 = np.float32
# Elevation and azimuth [deg]; the last one is hidden by the ground, where there is some.
PLACES = np.radians([[80.0, 10.0], [30.0, 0.0], [40.0, 80.0], [35.0, 150.0], [50.0, 220.0], [25.0, 300.0]])
RAYS = np.stack(
    [np.cos(PLACES[:, 0]) * np.cos(PLACES[:, 1]), np.cos(PLACES[:, 0]) * np.sin(PLACES[:, 1]), -np.sin(PLACES[:, 0])]
)
COUNT = len(PLACES)
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})


class Still:
    """A draw without noise, but for the first values of multipath."""

    def __init__(self, fast: float) -> None:
        self._fast = fast

    def normals(self, count: int) -> tuple[Any, ...]:
        """Return no noise of range rates and of positions."""
        return tuple(jnp.zeros(1) for _ in range(count))

    def normal_rows(self, rows: int, first: int = 0) -> Any:
        """Return zeros, for the offsets of four systems and a base's carrier phase."""
        assert (rows, first) in ((8, 8), (3, 48)), "a seed means the same flight as ever"
        return jnp.zeros((rows, 1))

    def normal_pairs(self, pairs: Any) -> tuple[Any, Any]:
        """Return the first values of both halves of multipath."""
        return jnp.full((COUNT, 1), self._fast), jnp.zeros((COUNT, 1))

    def uniform_pairs(self, pairs: Any) -> tuple[Any, Any]:
        """Return nothing that drives them."""
        return jnp.zeros((COUNT, 1)), jnp.zeros((COUNT, 1))


def vec(*values: float) -> Vec3:
    return Vec3(*(np.full(1, value, F32) for value in values))  # type: ignore[arg-type]


def receiver(**changes: Any) -> Gnss:
    how = {**PRESETS["gps_2011"], "period": 0.2, "delay": 0, "multipath": 0.0, "doppler_noise": 0.0, **changes}
    return cast(Gnss(preset="gps_2011", **how), F32)


def slots_of(moved: Any = (0.0, 0.0, 0.0), base: bool = False, **changes: Any) -> Slots:
    """Return slots whose errors move a fix by so many metres from one knot to the next, 5 s later."""
    zero, one = np.zeros(COUNT, F32), np.ones(COUNT, F32)
    signal = (-(np.asarray(moved) @ RAYS)).astype(F32)
    none, pair = np.zeros((), F32), (np.zeros((), F32), np.zeros((), F32))
    heard: Any = None
    if base:
        nowhere = Vec3(none, none, none)  # type: ignore[arg-type]
        rest: Any = (zero, zero, none, none, np.array(True), np.full((), 1e6, F32))
        heard = BaseSeen(nowhere, vec(0, 0, 0), vec(0, 0, 0), vec(0, 0, 0), vec(0, 0, 0), *rest)
    values: dict[str, Any] = {
        "ids": np.arange(COUNT, dtype=np.uint32),
        "system": np.zeros(COUNT, np.int32),
        "places": np.arange(COUNT, dtype=np.int32),
        "sight": Sight(Vec3(*RAYS.astype(F32)), PLACES[:, 0].astype(F32), one, one, zero, zero),  # type: ignore[arg-type]
        "before": CommonErrors(*(zero,) * 6),
        "after": CommonErrors(signal, *(zero,) * 5),  # type: ignore[arg-type]
        "scales": Scales(one, none, pair, pair, pair, pair),  # type: ignore[arg-type]
        "dropped": np.int32(0),
        "knot": np.int32(0),
        "part": np.zeros((), F32),
        "base": heard,
    }
    return Slots(**{**values, **changes})


HILL = SimpleNamespace(
    hides=True, horizon_sine=lambda position, rays: jnp.where(jnp.arange(COUNT) == COUNT - 1, 2.0, -2.0)[:, None]
)
HERE, REST = vec(0, 0, -50), vec(0, 0, 0)


@partial(jit, static_argnames="hill")
def _begun(sensor: Gnss, slots: Slots, fast: Any, hill: bool) -> Any:
    sky: Any = SimpleNamespace(slots=slots, range_error=None)
    draw: Any = Still(fast)
    return sensor.init(draw, HERE, REST, sky, None, HILL if hill else None)


def begun(sensor: Gnss, slots: Slots, fast: float = 0.0, hill: bool = False) -> Any:
    """Return state and reading at the start."""
    return _begun(sensor, slots, F32(fast), hill)


@partial(jit, static_argnames="hill")
def _stepped(sensor: Gnss, state: Any, slots: Slots, place: Vec3, hill: bool) -> Any:
    sky: Any = SimpleNamespace(slots=slots, range_error=None)
    draw: Any = Still(0.0)
    return sensor.step(state, draw, place, REST, sky, None, HILL if hill else None)


def stepped(sensor: Gnss, state: Any, slots: Slots, place: Vec3 = HERE, hill: bool = False) -> Any:
    """Return state and reading a period later."""
    return _stepped(sensor, state, slots, place, hill)


def value(array: Any) -> float:
    return float(np.ravel(array)[0])


PLAIN = {"velocity": "differenced"}


class TestStart:
    def test_it_has_long_been_running(self) -> None:
        """A filter counts as settled after 2^20 fixes, and satellites have been seen for 1e6 s; no fix is held back."""
        state, reading = begun(receiver(**PLAIN), slots_of())
        assert value(state.fixes) == 1048576.0
        np.testing.assert_array_equal(state.geometry.age, np.full((COUNT, 1), 1e6, F32))
        assert len(state.history) == 1
        assert value(reading.satellites) == COUNT
        np.testing.assert_allclose(np.ravel(reading.position_ned.stack()), [0.0, 0.0, -50.0], atol=1e-5)

    def test_multipath_is_what_both_lags_leave_of_it(self) -> None:
        """Against one that never changes: the root of f of (G19), for 8 s behind lags of 3 s and 6 s."""
        moved = []
        for time in (8.0, 1e12):
            sensor = receiver(multipath=1.0, multipath_time=time, **PLAIN)
            moved.append(np.ravel(begun(sensor, slots_of(), fast=1.0)[0].outer.stack()))
        a, b, c = 1.0 / 8.0, 1.0 / 3.0, 1.0 / 6.0
        f = b * c * (a + b + c) / ((a + b) * (a + c) * (b + c))
        assert np.abs(moved[1][2]) > 0.03
        np.testing.assert_allclose(moved[0], math.sqrt(f) * moved[1], rtol=1e-4, atol=1e-6)


class TestDifferenced:
    @pytest.mark.parametrize(("fixes", "knows"), [(0.0, False), (0.15, True), (1.0, True)])
    def test_velocity_is_the_way_between_two_fixes_over_a_period(self, fixes: float, knows: bool) -> None:
        """1, -2, 0.5 m in 0.2 s; the first fix has no velocity, but of a filter that began with part of one it has."""
        sensor = receiver(**PLAIN)
        state, _ = begun(sensor, slots_of())
        state, reading = stepped(sensor, replace(state, fixes=np.full(1, fixes, F32)), slots_of(), vec(1, -2, -49.5))
        assert value(state.fixes) == pytest.approx(fixes + 1.0)
        expected = [5.0, -10.0, 2.5] if knows else [math.nan] * 3
        np.testing.assert_allclose(np.ravel(reading.velocity_ned.stack()), expected, rtol=1e-5)

    def test_a_settled_filter_stays_settled(self) -> None:
        sensor = receiver(**PLAIN)
        state, _ = stepped(sensor, begun(sensor, slots_of())[0], slots_of())
        assert value(state.fixes) == 1048576.0

    @pytest.mark.parametrize(("before", "kind"), [(3.0, 3.0), (4.0, 0.0)])
    def test_it_coasts_for_a_time_to_half_a_period(self, before: float, kind: float) -> None:
        """0.89 s are 4.45 periods: the fourth period without enough satellites has a fix, the fifth none."""
        sensor = receiver(coast=0.89, **PLAIN)
        state, _ = begun(sensor, slots_of())
        lost = replace(state.geometry, enough=np.zeros(1, bool))
        state = replace(state, geometry=lost, coasted=np.full(1, before, F32))
        state, reading = stepped(sensor, state, slots_of())
        assert value(state.coasted) == before + 1.0
        assert value(reading.fix_type) == kind

    def test_satellites_that_have_risen_are_new_at_the_knot(self) -> None:
        """For a millisecond; the others count on, but no longer than to 1e6 s."""
        sensor = receiver(**PLAIN)
        state, _ = begun(sensor, slots_of())
        age = np.array([1e6, 20.0, 1e6, 1e6, 1e6, 1e6], F32)[:, None]
        state = replace(state, geometry=replace(state.geometry, age=age))
        ids = np.array([9, 1, 2, 3, 4, 5], np.uint32)
        state, reading = stepped(sensor, state, slots_of(ids=ids, knot=np.int32(1)))
        np.testing.assert_allclose(state.geometry.age[:, 0], [1e-3, 25.0, 1e6, 1e6, 1e6, 1e6], rtol=1e-6)
        assert value(reading.satellites) == COUNT - 1


class TestCorrected:
    """A receiver of range rates with corrections of a base by code, and a hill that hides a satellite."""

    HOW: ClassVar[dict[str, Any]] = {"corrections": "dgps", "velocity": "doppler"}

    def test_satellites_that_are_hidden_at_the_start_have_been_so_for_long(self) -> None:
        """For 1000 s, counted downwards from -1000."""
        state, reading = begun(receiver(**self.HOW), slots_of(base=True), hill=True)
        np.testing.assert_array_equal(np.ravel(state.age), [1e6] * (COUNT - 1) + [-2000.0])
        assert value(reading.satellites) == COUNT - 1

    def test_velocity_has_the_drift_of_the_carrier(self) -> None:
        """1, -2, 3 m in the 5 s between two knots."""
        sensor, slots = receiver(**self.HOW), slots_of((1.0, -2.0, 3.0), base=True)
        state, _ = begun(sensor, slots, hill=True)
        state, reading = stepped(sensor, state, slots, hill=True)
        np.testing.assert_allclose(np.ravel(reading.velocity_ned.stack()), [0.2, -0.4, 0.6], rtol=1e-4)
        assert value(reading.fix_type) == 4.0

    def test_another_kind_of_solution_begins_anew(self) -> None:
        sensor, slots = receiver(**self.HOW), slots_of(base=True)
        state, _ = begun(sensor, slots, hill=True)
        single = replace(state, link=replace(state.link, on=np.zeros(1, bool)))
        assert value(stepped(sensor, single, slots, hill=True)[0].fixes) == 1.0
        assert value(stepped(sensor, state, slots, hill=True)[0].fixes) == 1048576.0
