"""What plumes, persons and grounds make of draws that are given, of distances and of times, by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.models.by_hand import Given, words

from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.contracts import Wind as MeanWind
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.contents import Contents, ContentsState, Surroundings
from qrsim.models.scene.persons import Persons
from qrsim.models.scene.plume import (
    DispersionPlume,
    GaussianPlume,
    NoPlume,
    PuffPlume,
    PuffState,
    Sources,
    Wind,
    inner_box,
    trail,
)
from qrsim.models.scene.terrain import PatchyGround, TerrainState

AREA = BoxArea(0.0, 100.0, 200.0, 300.0, -50.0, 0.0)  # type: ignore[arg-type]


def test_the_inner_part_of_a_box_has_its_middle() -> None:
    low, high = inner_box(AREA, 0.5)
    assert (low.x, low.y, low.z) == pytest.approx((25.0, 225.0, -37.5))
    assert (high.x, high.y, high.z) == pytest.approx((75.0, 275.0, -12.5))


# Of three sources: places, how many (the first one's), and what comes after.
DRAWN = (
    (0.25, 0.5, 0.75),
    (0.1, 0.2, 0.3),
    (0.5, 0.75, 0.875),
    (0.4, 0.9, 0.9),
    (0.9, 0.6, 0.3),
    (0.15, 0.35, 0.55),
    (0.7, 0.05, 0.45),
    (0.8, 0.65, 0.25),
    (0.02, 0.97, 0.12),
)


def test_sources_by_their_draws() -> None:
    """Along each axis in the inner 80 %; of one to three two are there, at 0.4; then each plume's own."""
    gauss: Any = GaussianPlume(peak=2.0, std_min=0.0, std_max=10.0, fewest=1, most=3)  # type: ignore[arg-type]
    steady: Any = DispersionPlume(rate_min=1.0, rate_max=2.0, fewest=1, most=3)  # type: ignore[arg-type]
    puffs: Any = PuffPlume(gap=5.0, fewest=1, most=3, puffs=2)  # type: ignore[arg-type]
    init = jax.jit(lambda table: [plume.init(Given(table), AREA) for plume in (gauss, steady, puffs)])
    drawn, rates, waiting = init(words(DRAWN))
    for sources in (drawn.sources, rates, waiting.sources):
        np.testing.assert_allclose(sources.position_ned.x, [30.0, 50.0, 70.0], rtol=1e-5)
        np.testing.assert_allclose(sources.position_ned.y, [218.0, 226.0, 234.0], rtol=1e-5)
        np.testing.assert_allclose(sources.position_ned.z, [-25.0, -15.0, -10.0], rtol=1e-5)
    np.testing.assert_allclose(drawn.sources.strength, [2.0, 2.0, 0.0])
    np.testing.assert_allclose(drawn.std.stack().T, 10.0 * np.array(DRAWN[4:7]), rtol=1e-5)
    np.testing.assert_allclose(drawn.yaw, math.pi * np.array(DRAWN[7]), rtol=1e-5)
    np.testing.assert_allclose(rates.strength, [1.9, 1.6, 0.0], rtol=1e-5)
    np.testing.assert_allclose(waiting.wait, -5.0 * np.log(DRAWN[4]), rtol=1e-5)


def test_a_step_has_four_releases() -> None:
    """Amounts from 0 to 10 by each second draw; gaps of 0.05 s and 0.1 s, -ln of the others being 1 and 2."""
    plume: Any = PuffPlume(amount_min=0.0, amount_max=10.0, gap=0.05, puffs=8, period=0.5)  # type: ignore[arg-type]
    one, two = math.exp(-1.0), math.exp(-2.0)
    table = words([[part] for part in (0.1, one, 0.2, two, 0.3, one, 0.4, two, 0.5, one, 0.6, two, 0.7, one)])
    zero, nothing = np.zeros(1, np.float32), np.zeros((1, 8), np.float32)
    begun: Any = PuffState(Sources(Vec3(zero, zero, zero), zero + 1.0), zero, np.zeros(1, np.int32), nothing, nothing)  # type: ignore[arg-type]
    after = jax.jit(lambda state, given: plume.step(state, Given(given)))(begun, table)
    assert np.asarray(after.released).tolist() == [4]
    np.testing.assert_allclose(after.amount, [[1.0, 2.0, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0]], rtol=1e-5)
    np.testing.assert_allclose(np.asarray(after.age)[0, :4], [0.5, 0.45, 0.35, 0.3], rtol=1e-5)
    np.testing.assert_allclose(after.wait, [-0.2], rtol=1e-5)


def test_a_plume_spreads_with_the_distance() -> None:
    """s = 2 a x'^b with a = 1/2 and b = 1 is x', 1 mm at least; with a wind of 1 m/s on the ground c = 2 Q/(pi s)."""
    plume: Any = DispersionPlume(spread_factor=0.5, spread_exponent=1.0)  # type: ignore[arg-type]
    zero = np.zeros(1, np.float32)
    source: Any = Sources(Vec3(zero, zero, zero), zero + math.pi)  # type: ignore[arg-type]
    wind: Any = Wind(np.float32(1.0), np.float32(1.0), np.float32(0.0))  # type: ignore[arg-type]
    still = np.zeros(2, np.float32)
    north: Any = np.array([9.0, 0.5e-3], np.float32)
    found = jax.jit(lambda at: plume.mean(source, at, wind))(Vec3(north, still, still))  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [2.0 / 9.0, 2.0 / 1e-3], rtol=1e-5)


def test_a_puff_ends_at_a_hundredth_of_its_peak() -> None:
    """exp(-d^2/s) = 1/100 with s = 2 a x'^b = 36 m^2 of a = 2, b = 1, x' = 9 m; 0.004 m^2 at 1 mm and nearer."""
    found = jax.jit(lambda flown: trail(2.0, 1.0, flown))(np.array([9.0, 0.0], np.float32))
    np.testing.assert_allclose(found, [6.0 * 2.145966, math.sqrt(0.004) * 2.145966], rtol=1e-5)


def test_persons_by_their_draws() -> None:
    """Four cells, of each 40 m by 40 m in the inner part: at 0.6, 0.1 and 0.9 the third, the first and the fourth."""
    persons: Any = Persons(fewest=1, most=3)
    table = words(
        [(0.5, 0.5, 0.5), (0.6, 0.1, 0.9), (0.25, 0.5, 0.75), (0.5, 0.75, 0.125), (0.4, 0.9, 0.9), (0.9, 0.1, 0.1)]
    )
    found = jax.jit(lambda given: persons.init(Given(given), jnp.zeros((2, 2), jnp.int32), AREA))(table)
    np.testing.assert_allclose(found.north, [60.0, 30.0, 80.0], rtol=1e-5)
    np.testing.assert_allclose(found.east, [230.0, 240.0, 255.0], rtol=1e-5)
    assert np.asarray(found.there).tolist() == [True, True, False]
    assert np.asarray(found.found_tick).tolist() == [-1, -1, -1]


def test_cells_in_steps_of_a_metre() -> None:
    """50 cells over 10 m and over 9.2 m: the middle of each whole metre counts, at the edge that of the last one."""
    number: Any = 100 * np.arange(50)[:, None] + np.arange(50)
    area = BoxArea(0.0, 10.0, 0.0, 9.2, -50.0, 0.0)  # type: ignore[arg-type]
    north, east = np.array([0.0, 3.7, 10.0, 20.0], np.float32), np.array([0.0, 4.2, 9.2, 20.0], np.float32)
    found = PatchyGround(side=50).class_at(TerrainState(number), Vec3(north, east, 0.0 * north), area)  # type: ignore[arg-type]
    assert np.asarray(found).tolist() == [202, 1724, 4749, 4749]


class Rising(MeanWind):
    """Half a metre per second for each metre of height, to the north."""

    def velocity_ned(self, height_agl: Any, seconds: Any, fraction: Any, *args: Any, **reads: Any) -> Vec3:
        return Vec3(0.5 * height_agl, 0.0 * height_agl, 0.0 * height_agl)


@dataclass(frozen=True)
class Since(NoPlume):
    """A plume whose concentration is the time since its last step."""

    period: float = 0.0

    def concentration(self, state: Any, position_ned: Vec3, wind: Any, area: Any, since: Any) -> Any:
        return since


def around(plume: Any, tick: int) -> Surroundings:
    return Surroundings(Contents(plume=plume), ContentsState(), Rising(), AREA, jnp.int32(tick), 0.5)


def test_the_wind_6_m_above_the_ground_carries() -> None:
    wind = around(NoPlume(), 0).carrying_wind(np.float32)
    assert (float(wind.speed), float(wind.north), float(wind.east)) == pytest.approx((3.0, 1.0, 0.0))


def test_the_time_since_the_last_step_of_a_plume() -> None:
    """Ticks of 0.5 s: steps every third, every one, and those of what never changes."""
    place = Vec3(*np.zeros((3, 1), np.float32))
    for period, since in ((1.5, 1.0), (0.5, 0.0), (0.0, 0.0)):
        assert float(around(Since(period=period), 5).concentration(place)) == since
