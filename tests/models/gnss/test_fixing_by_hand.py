"""Fixing carrier phase, epoch by epoch.

Ages, stages, wrong fixes and errors by hand from docs/howto/corrections.md and (G24).
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
from qrsim.models.gnss.fixing import Link, Received, received, started, stepped
from qrsim.models.gnss.presets import PRESETS

# The preset f9p_rtk, of docs/howto/corrections.md.
RTK: dict[str, Any] = {
    "corrections": "rtk", "moving_base": "", "base_vehicle": None, "first_fix": "fixed", "period": 0.2,
    "smoothing_time": 10.0, "float_time": 60.0, "fix_time": 9.0, "wrong_fixes": 0.003, "fixed_accuracy": 0.01,
    "fixed_per_distance": 1e-6,
}  # fmt: skip
NONE = (0.0,) * 10
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})


def test_the_preset_is_that_of_the_page() -> None:
    """docs/howto/corrections.md: 1 cm + 1 ppm, the data sheet's; a minute to float, and what tests below need."""
    numbers = {name: value for name, value in RTK.items() if name not in ("base_vehicle", "first_fix")}
    assert {name: PRESETS["f9p_rtk"][name] for name in numbers} == numbers


class Given:
    """A draw of given numbers: a pair of uniform ones in (0, 1) at pair 40, and ten normals from pair 48 on."""

    def __init__(self, chance: Any = 0.5, other: Any = 0.9, normals: Any = NONE) -> None:
        self.uniform, self.normals = (chance, other), normals

    def normal_rows(self, rows: int, first: int = 0) -> Any:
        """Return the first of the normals."""
        assert first == 48, "a seed means the same flight as ever"
        return jnp.asarray(self.normals, jnp.float32)[:rows, None]

    def uniform_pairs(self, pairs: Any) -> Any:
        """Return the uniform numbers with mean 0 and variance 1; of another pair, none."""
        scaled = [jnp.reshape((value - 0.5) * math.sqrt(12.0), (1, 1)) for value in self.uniform]
        return [jnp.where((pairs == 40)[:, None], value, jnp.nan) for value in scaled]


def vec(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Vec3:
    return Vec3(*(one(value) for value in (x, y, z)))


def one(value: Any) -> Any:
    return np.full(1, value, bool if isinstance(value, bool) else np.float32)


def link_of(**changes: Any) -> Link:
    """Return what one receiver remembers whose phase floats."""
    usual: dict[str, Any] = {
        "age": one(0.0),
        "on": one(True),
        "fixed": one(False),
        "stage": one(0.0),
        "carrier": vec(),
        "wrong": vec(),
        "drift": vec(),
        "said": vec(),
    }
    return Link(**{**usual, **changes})


def geometry(strong: Any = 16.0, mirrored: Any = 0.0, count: Any = 20.0) -> Any:
    """Return a solution with satellites that carrier phase can be fixed with, and reflections of all used."""
    part = SimpleNamespace(
        strong=strong,
        horizontal=one(0.8),
        vertical=one(1.2),
        float_horizontal=one(0.3),
        float_vertical=one(0.5),
        before=vec(),
        after=vec(),
    )
    return SimpleNamespace(
        enough=one(True),
        differential=part,
        mirrored=mirrored,
        count=count,
        horizontal=one(3.0),
        vertical=one(4.0),
        slope_north=vec(),
        slope_east=vec(),
    )


def slots_of(carrier: Any = None) -> Any:
    """Return slots with a base that sends nothing."""
    base = SimpleNamespace(
        position_ned=vec(),
        sends=np.array(False),
        reach=np.float32(1e6),
        age=np.float32(0.0),
        coordinates=vec(),
        carrier=carrier or vec(),
        tilt_north=vec(),
        tilt_east=vec(),
    )
    return SimpleNamespace(base=base, part=np.float32(0.0))


def got_of(way: Vec3 | None = None, age: float = 0.0, on: bool = True) -> Received:
    zero = vec()
    return Received(way or zero, one(True), one(on), one(age), zero, zero, zero)


@partial(jit, static_argnames="corrections")
def _stepped(
    link: Link, got: Received, uniform: Any, normals: Any, counts: Any, base: Vec3, corrections: str
) -> tuple[Link, Any]:
    receiver, draw = SimpleNamespace(**{**RTK, "corrections": corrections}), Given(uniform[0], uniform[1], normals)
    given: Any = draw
    return stepped(receiver, link, given, slots_of(base), geometry(*counts), got, vec(), one(100.0))


def epoch(
    link: Link | None = None,
    draw: Given | None = None,
    got: Received | None = None,
    counts: tuple[float, float, float] = (16.0, 0.0, 20.0),
    base: Vec3 | None = None,
    corrections: str = "rtk",
) -> tuple[Link, Any]:
    """Return memory and quality after an epoch, with counts of strong satellites, of reflections and of all."""
    given, numbers = draw or Given(), tuple(one(count) for count in counts)
    uniform, normals = (np.asarray(part, np.float32) for part in (given.uniform, given.normals))
    return _stepped(link or link_of(), got or got_of(), uniform, normals, numbers, base or vec(), corrections)


@jit
def _received(link: Link | None) -> Received:
    receiver, zero = SimpleNamespace(**RTK), vec()
    return received(receiver, slots_of(), link, zero, geometry(), zero, zero, zero)


@pytest.mark.parametrize(("age", "on"), [(59.7, True), (59.9, False)])
def test_corrections_are_of_use_for_a_minute(age: float, on: bool) -> None:
    """A period of 0.2 s later; a base that is silent sends none.

    See docs/howto/corrections.md, after 60 s it is single again.
    """
    got = _received(link_of(age=one(age)))
    assert float(got.age[0]) == pytest.approx(age + 0.2, abs=1e-4)
    assert bool(got.on[0]) is on


def test_corrections_that_never_came_are_ten_thousand_seconds_old() -> None:
    """And no older than that later."""
    for link in (None, link_of(age=one(1e4))):
        got = _received(link)
        assert float(got.age[0]) == 1e4
        assert not bool(got.on[0])


@pytest.mark.parametrize(("age", "fixed"), [(9.9, True), (10.1, False)])
def test_phase_is_lost_with_corrections_older_than_ten_seconds(age: float, fixed: bool) -> None:
    assert bool(epoch(link_of(fixed=one(True)), got=got_of(age=age))[0].fixed[0]) is fixed


@pytest.mark.parametrize(("strong", "fixed"), [(4.0, False), (5.0, True)])
def test_phase_is_lost_with_fewer_than_five_satellites(strong: float, fixed: bool) -> None:
    assert bool(epoch(link_of(fixed=one(True)), counts=(strong, 0.0, 20.0))[0].fixed[0]) is fixed


@pytest.mark.parametrize(
    ("counts", "north", "chance"),
    [
        # Of four stages, 9 s together, one ends within 0.2 s with a chance of 4 * 0.2/9 = 0.08889.
        ((16.0, 0.0, 20.0), 0.0, 0.08889),
        # No sooner with more than 16 satellites; with 10 of them (10 - 4)/12 = 1/2 as soon.
        ((20.0, 0.0, 20.0), 0.0, 0.08889),
        ((10.0, 0.0, 20.0), 0.0, 0.04444),
        # e times as long at 25 km.
        ((16.0, 0.0, 20.0), 25e3, 0.03270),
        # With a quarter of the satellites seen by reflections half as soon, (1 - 2/4).
        ((16.0, 5.0, 20.0), 0.0, 0.04444),
    ],
)
def test_stages_end_as_often_as_their_number_says(counts: Any, north: float, chance: float) -> None:
    """Equation (G24): the chance of an epoch, within 1 % on both sides."""
    for factor, ends in ((0.99, 1.0), (1.01, 0.0)):
        link, _ = epoch(draw=Given(factor * chance), counts=counts, got=got_of(vec(north)))
        assert float(link.stage[0]) == ends
        assert not bool(link.fixed[0])


def test_with_more_reflections_than_direct_signals_it_is_never_fixed() -> None:
    link, _ = epoch(draw=Given(1e-6), counts=(16.0, 12.0, 20.0))
    assert float(link.stage[0]) == 0.0


def test_the_fourth_stage_fixes() -> None:
    for stage, fixed in ((2.0, False), (3.0, True)):
        link, _ = epoch(link_of(stage=one(stage)), Given(0.01))
        assert bool(link.fixed[0]) is fixed
        assert float(link.stage[0]) == (0.0 if fixed else 3.0)


@pytest.mark.parametrize(
    ("share", "other", "wrong"),
    # A share of 0.003; and a tenth of a quarter more, where that are seen by reflections: 0.028.
    [(0.0, 0.0029, True), (0.0, 0.0031, False), (0.25, 0.0275, True), (0.25, 0.0285, False)],
)
def test_some_fixes_are_wrong_by_decimetres(share: float, other: float, wrong: bool) -> None:
    """By 0.3 m along each horizontal axis and 0.6 m of height, one standard deviation each."""
    normals = np.array([0.0] * 6 + [1.0, -2.0, 1.5, 0.0])
    draw = Given(0.001, other, normals)
    link, _ = epoch(link_of(stage=one(3.0)), draw, counts=(16.0, 20.0 * share, 20.0))
    assert bool(link.fixed[0])
    expected = [0.3, -0.6, 0.9] if wrong else [0.0, 0.0, 0.0]
    np.testing.assert_allclose(np.ravel(link.wrong.stack()), expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "share", "rate"),
    [
        # Noticed after half a minute on average.
        (0.3, 0.0, 1.0 / 30.0),
        # 0.2 per second and share of reflections, here of a quarter.
        (0.0, 0.25, 0.05),
    ],
)
def test_fixes_are_lost_as_often_as_their_rates_say(wrong: float, share: float, rate: float) -> None:
    """Within a period of 0.2 s, to 1 % on both sides."""
    before = link_of(fixed=one(True), wrong=vec(wrong))
    for factor, kept in ((0.99, False), (1.01, True)):
        link, _ = epoch(before, Given(0.5, factor * 0.2 * rate), counts=(16.0, 20.0 * share, 20.0))
        assert bool(link.fixed[0]) is kept
        assert float(link.wrong.x[0]) == pytest.approx(wrong if kept else 0.0)


def test_the_error_of_a_fixed_phase() -> None:
    """s (q + q_base)/sqrt(2) + 2 mm white: s is 1 cm over 1.17741, the circle of 50 %, and over 0.67449 for the height.

    q decays by exp(-0.2/30) in a period.
    """
    normals = np.array([0.0, 0.0, 0.0, 1.0, 2.0, -3.0, 0.0, 0.0, 0.0, 0.0])
    before = link_of(fixed=one(True), carrier=vec(1.0, -1.0, 2.0))
    link, _ = epoch(before, Given(normals=normals), base=vec(0.5, 0.5, -0.5))
    level, upright, decay = 0.0084932180, 0.0148260220, math.exp(-0.2 / 30.0)
    expected = [
        level * (decay + 0.5) / math.sqrt(2.0) + 0.002,
        level * (-decay + 0.5) / math.sqrt(2.0) + 0.004,
        upright * (2.0 * decay - 0.5) / math.sqrt(2.0) - 0.006,
    ]
    np.testing.assert_allclose(np.ravel(link.said.stack()), expected, rtol=1e-5)


def test_an_older_link_begins_with_normals_of_its_own() -> None:
    """The start draws the error of carrier phase from the same pairs."""

    @jit
    def begun(got: Received) -> tuple[Link, Any]:
        given: Any = Given(normals=np.arange(1.0, 11.0))
        return started(SimpleNamespace(**RTK), given, slots_of(), geometry(), got)

    link, quality = begun(got_of())
    np.testing.assert_array_equal(np.ravel(link.carrier.stack()), [1.0, 2.0, 3.0])
    assert float(quality.fix_type[0]) == 6.0


@pytest.mark.parametrize(
    ("corrections", "fixed", "on", "expected"),
    [
        ("rtk", True, True, 6.0),
        ("rtk", False, True, 5.0),
        ("dgps", False, True, 4.0),
        ("rtk", False, False, 3.0),
    ],
)
def test_kinds_of_fixes_are_those_of_mavlink(corrections: str, fixed: bool, on: bool, expected: float) -> None:
    """GPS_FIX_TYPE: 3 3D, 4 DGPS, 5 RTK float, 6 RTK fixed."""
    _, quality = epoch(link_of(fixed=one(fixed)), got=got_of(on=on), corrections=corrections)
    assert float(quality.fix_type[0]) == expected


def test_the_accuracy_of_a_fixed_phase() -> None:
    """Roots of 2 (s^2 + (2 mm)^2) and s^2 + (2 mm)^2, with s of (G24); 1 ppm of 10 km adds its square."""
    for north, square in ((0.0, 1e-4), (1e4, 2e-4)):
        _, quality = epoch(link_of(fixed=one(True)), got=got_of(vec(north)))
        level = math.sqrt(2.0 * (square / 1.3862944 + 4e-6))
        assert float(quality.horizontal[0]) == pytest.approx(level, rel=1e-4)
        assert float(quality.vertical[0]) == pytest.approx(math.sqrt(square / 0.4549365 + 4e-6), rel=1e-4)
