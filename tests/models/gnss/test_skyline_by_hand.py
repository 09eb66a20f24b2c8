"""The table of what obstacles do.

Its bytes for single walls (G20 of docs/explanation/models/gnss.md), and looking into one.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.models.gnss.sight import Sight
from qrsim.models.gnss.skyline import Skyline
from qrsim.models.gnss.skyline_table import LEVELS, Frame, frame_of, make_table, skyline_of, walls_of

Array = np.ndarray[Any, Any]
LOWEST = math.radians(10.0)
# Degrees in a part of 255 of a right angle.
PART = 90.0 / 255.0
# What compiles these programs in the least time.
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
look_into = jax.jit(Skyline.look, compiler_options=QUICK)
AZIMUTHS = 360.0 / 64.0 * np.arange(64)


def table_of(ends: Any, top: float, corner: tuple[float, float], rows: int = 1, columns: int = 1) -> Array:
    """Return the four bytes of each entry, (rows, columns, levels, azimuths, 4), of a thin wall on the ground."""
    walls = walls_of([([np.array(ends, float)], top, 0.0)])
    frame = Frame(corner, 4.0, rows, columns, (0.0, top), 64)
    words = np.asarray(make_table(walls, frame, LOWEST).words).view(np.uint32)
    return np.stack([(words >> np.uint32(8 * i)) & 255 for i in range(4)], axis=-1).reshape(rows, columns, 2, 64, 4)


# Where there is a table


def test_lowest_levels() -> None:
    """As the docs have them; levels over the highest of these grow from it."""
    assert LEVELS == (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0)


def test_levels_above_each_other() -> None:
    """0, 2, 5, 10, 15, 20, 30 and 45 m, then 1.45 times as much each, over the ground, which is at -3 m; the roof."""
    walls = walls_of([([np.array([[0.0, 0.0], [9.0, 0.0]])], 97.0, -3.0)])
    frame = frame_of(walls, None, LOWEST, 4.0, 64)
    assert frame is not None
    heights = [0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 65.25, 94.6125, 100.0]
    np.testing.assert_allclose(np.array(frame.levels) + 3.0, heights, rtol=1e-12)


@pytest.mark.parametrize(("roof", "count"), [(20.45, 5), (20.55, 6), (19.6, 5)])
def test_the_roof_stands_for_a_level_half_a_metre_below_it(roof: float, count: int) -> None:
    """Levels below 20 m are five; that of 20 m is one where the roof is at least half a metre higher."""
    frame = frame_of(walls_of([([np.array([[0.0, 0.0], [9.0, 0.0]])], roof, 0.0)]), None, LOWEST, 4.0, 64)
    assert frame is not None
    assert frame.levels == (*(0.0, 2.0, 5.0, 10.0, 15.0, 20.0)[:count], roof)


def test_cells_of_a_frame() -> None:
    """Cells of 4 m fill the bounds from their corner on; a strip of 3 m is one cell wide. Four bytes an entry."""
    walls = walls_of([([np.array([[0.0, 0.0], [9.0, 0.0]])], 25.0, 0.0)])
    frame = frame_of(walls, (-10.0, -1.0, 5.0, 8.0), LOWEST, 4.0, 64)
    assert frame is not None
    assert (frame.rows, frame.columns) == (3, 1)
    assert frame.corner == (-8.0, 7.0)
    # 0, 2, 5, 10, 15, 20 and 25 m.
    assert frame.size == 4 * 3 * 1 * 7 * 64


# What walls do


@pytest.mark.parametrize("half", [3.0, 80.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_horizon_of_a_wall_in_the_south(half: float, sign: float) -> None:
    """20 m high and 10 m to the south, where azimuths turn from 180 to -180 degrees; listed either way round.

    A wall of 160 m spans more than half a turn less 15 degrees, one of 6 m five rays.
    """
    found = table_of([[-10.0, sign * half], [-10.0, -sign * half]], 20.0, (0.0, 0.0))[0, 0, 0]
    off = np.radians(AZIMUTHS - 180.0)
    meets = np.abs(off) < math.atan2(half, 10.0)
    away = 10.0 / np.where(meets, np.cos(off), 1.0)
    expected = np.where(meets & (math.tan(LOWEST) * away < 20.0), np.degrees(np.arctan(20.0 / away)) / PART, 0.0)
    np.testing.assert_array_equal(found[:, 0], np.round(expected))
    # The next byte is that of the next azimuth, for directions in between.
    np.testing.assert_array_equal(found[:, 1], np.round([*expected[1:], expected[0]]))


@pytest.mark.parametrize("half", [10.0, 80.0])
def test_a_wall_that_spans_more_than_half_of_the_numbers(half: float) -> None:
    """From 100 degrees over the south to -100: a difference of 200 to the other side is 160 to this."""
    across = half * math.tan(math.radians(10.0))
    found = table_of([[-across, half], [-across, -half]], 60.0, (0.0, 0.0))[0, 0, 0, :, 0]
    off = np.radians(AZIMUTHS - 180.0)
    meets = np.abs(off) < math.radians(80.0)
    away = across / np.where(meets, np.cos(off), 1.0)
    np.testing.assert_array_equal(found, np.where(meets, np.round(np.degrees(np.arctan(60.0 / away)) / PART), 0.0))


@pytest.mark.parametrize(("away", "detour"), [(0.2, 1), (10.0, 20), (127.6, 255), (127.8, 0), (150.0, 0)])
def test_detours_from_behind(away: float, detour: int) -> None:
    """A wall in the north, turned by 1 degree, mirrors to the north what comes from 182 degrees.

    That is longer by 2 cos(1 deg) times the wall's distance, to a metre: none of more than 255 m, and what is shorter
    than a metre counts as one, because 0 stands for no reflection.
    """
    tilt = math.radians(1.0)
    middle, along = away * np.array([math.cos(tilt), math.sin(tilt)]), np.array([-math.sin(tilt), math.cos(tilt)])
    found = table_of([middle - 400.0 * along, middle + 400.0 * along], 60.0, (0.0, 0.0))[0, 0, 0, 32]
    assert found[2] == detour
    ceiling = math.degrees(math.atan2(60.0 * math.cos(tilt), away)) / PART
    assert found[3] == (round(ceiling) if detour else 0)


@pytest.mark.parametrize(("ends", "opposite"), [([[10, -400], [10, 400]], 32), ([[-400, 10], [400, 10]], 48)])
def test_a_wall_along_an_axis_mirrors_to_every_direction_before_it(ends: Any, opposite: int) -> None:
    """10 m to the north, or to the east: 20 m times the cosine of the angle to its normal, from the south or west."""
    found = table_of(ends, 60.0, (0.0, 0.0))[0, 0, 0, :, 2]
    steps = np.arange(-15, 16)
    expected = np.zeros(64)
    expected[(opposite + steps) % 64] = np.round(20.0 * np.cos(np.radians(5.625 * steps)))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("away", "horizon"), [(0.0005, 0), (0.0009, 0), (0.0011, 255), (0.01, 255)])
def test_a_wall_nearer_than_a_millimetre_is_stood_on(away: float, horizon: int) -> None:
    assert table_of([[away, -9.0], [away, 9.0]], 20.0, (0.0, 0.0))[0, 0, 0, 0, 0] == horizon


@pytest.mark.parametrize("corner", [100.0, -160.0])
@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("east", [False, True])
def test_a_low_wall_is_met_at_the_end_of_a_row_of_cells(corner: float, before: bool, east: bool) -> None:
    """2 m high it hides satellites above 10 degrees from those within 11.3 m; it is 10 m beside the first or last."""
    place = corner - 10.0 if before else corner + 70.0
    ends = np.array([[place, -5.0], [place, 5.0]])
    rows, columns = (1, 16) if east else (16, 1)
    found = table_of(ends[:, ::-1] if east else ends, 2.0, (0.0, corner) if east else (corner, 0.0), rows, columns)
    azimuth = (48 if before else 16) if east else (32 if before else 0)
    expected = np.zeros(16)
    # atan(2/10), in parts.
    expected[0 if before else 15] = 32
    np.testing.assert_array_equal(found[:, :, 0, azimuth, 0].ravel(), expected)


# Looking into a table


def single(*parts: float) -> list[Any]:
    return [np.full(1, part, np.float32) for part in parts]


def look(
    table: Skyline, place: tuple[float, float, float], elevation_deg: float, azimuth_deg: float
) -> tuple[Any, Any]:
    """Return whether a satellite is hidden from a place, north, east and height, and the detour."""
    elevation, azimuth = math.radians(elevation_deg), math.radians(azimuth_deg)
    ray = (math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), -math.sin(elevation))
    at, line, angle, none = single(place[0], place[1], -place[2]), single(*ray), single(elevation), single(0.0)
    hidden, detour = look_into(table, Vec3(*at), Sight(Vec3(*line), *angle, *none, *none, *none, *none))
    return bool(hidden[0, 0]), float(detour[0, 0])


def filled(horizon: Any, detour: Any = 0, rows: int = 1, columns: int = 1) -> Skyline:
    """Return a table of cells of 10 m round the origin, of levels 0 and 20 m and 4 azimuths.

    Args:
        horizon: at each azimuth, in parts of 255, as far as it broadcasts to (rows, columns, 2, 4).
        detour: [m]; its reflections are there at all elevations.
        rows: of cells, the first one in the middle.
        columns: the same.
    """
    shape = (rows, columns, 2, 4)
    low = np.broadcast_to(np.asarray(horizon, np.uint32), shape)
    words = low | np.roll(low, -1, axis=-1) << 8 | np.broadcast_to(np.asarray(detour, np.uint32), shape) << 16
    frame = Frame((0.0, 0.0), 10.0, rows, columns, (0.0, 20.0), 4)
    return skyline_of((words | np.uint32(255 << 24)).ravel().view(np.int32), frame)


def test_elevations_are_parts_of_a_right_angle() -> None:
    """85 of 255 parts are 30 degrees."""
    table = filled(85)
    assert look(table, (0.0, 0.0, 1.0), 29.9, 30.0)[0]
    assert not look(table, (0.0, 0.0, 1.0), 30.1, 30.0)[0]


def test_azimuths_are_clockwise_from_north() -> None:
    """Horizons of 30 degrees in the east alone: at 45 and 135 degrees they are half as high."""
    table = filled([0, 85, 0, 0])
    at = (0.0, 0.0, 1.0)
    assert [look(table, at, 29.0, azimuth)[0] for azimuth in (0.0, 90.0, 180.0, 270.0)] == [False, True, False, False]
    assert [look(table, at, 14.0, azimuth)[0] for azimuth in (45.0, 135.0, 225.0)] == [True, True, False]
    assert not look(table, at, 16.0, 45.0)[0]


def test_just_before_north_is_the_end_of_the_last_azimuth() -> None:
    """Less than single precision resolves, west of north; the other level has a horizon that must not be met."""
    table = filled([[0, 0, 0, 0], [255, 255, 255, 255]], [[1, 2, 3, 4], [9, 9, 9, 9]])
    hidden, detour = look(table, (0.0, 0.0, 0.0), 20.0, -1e-7)
    assert not hidden
    assert detour == 4.0


@pytest.mark.parametrize(
    ("along", "cell"),
    [(-5.5, 0), (-4.5, 1), (4.5, 1), (5.5, 2), (7.0, 2), (14.5, 2), (15.5, 3), (24.5, 3), (25.5, 0), (24.0, 3)],
)
@pytest.mark.parametrize("east", [False, True])
def test_the_nearest_cell_counts_and_beyond_the_outermost_the_sky_is_open(along: float, cell: int, east: bool) -> None:
    """Three cells, 10 m apart; detours of 1, 2 and 3 m tell them apart."""
    shape = (1, 3, 1, 1) if east else (3, 1, 1, 1)
    table = filled(0, np.array([1, 2, 3]).reshape(shape), shape[0], shape[1])
    assert look(table, (0.0, along, 1.0) if east else (along, 0.0, 1.0), 20.0, 30.0)[1] == cell


@pytest.mark.parametrize(("height", "detour"), [(-3.0, 7), (9.0, 7), (11.0, 8), (19.9, 8), (20.1, 0)])
def test_the_nearer_level_has_the_reflection(height: float, detour: int) -> None:
    """Of levels at 0 and 20 m; above the roof there is none."""
    assert look(filled(0, [[[7], [8]]]), (0.0, 0.0, height), 20.0, 30.0)[1] == detour
