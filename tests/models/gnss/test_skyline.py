"""What obstacles do to signals: the table against another geometry and Fermat's principle, and receivers."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.vectors import Vec3
from qrsim.models.gnss import hidden
from qrsim.models.gnss.sight import Sight
from qrsim.models.gnss.skyline import Skyline
from qrsim.models.gnss.skyline_table import frame_of, make_table, walls_of

Values = np.ndarray[Any, Any]
LOWEST = math.radians(10.0)


def bytes_of(table: Skyline, number: int) -> Values:
    """Return one of the four bytes of each entry, (rows, columns, levels, azimuths)."""
    words = np.asarray(table.words).view(np.uint32).reshape(table.rows, table.columns, -1, table.azimuths)
    return (words >> np.uint32(8 * number)) & 255


def sight(elevation: Values, azimuth: Values) -> Sight:
    ray = Vec3(
        *(
            jnp.asarray(part, jnp.float32)
            for part in (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), -np.sin(elevation))
        )
    )
    none = jnp.zeros(len(elevation))
    return Sight(ray, jnp.asarray(elevation, jnp.float32), none, none, none, none)


def look(table: Skyline, places: Values, elevation: Values, azimuth: Values) -> tuple[Values, Values]:
    """Return what is hidden and the detours, (n, K)."""
    at = Vec3(*(jnp.asarray(part, jnp.float32) for part in places.T))
    return tuple(np.asarray(part).T for part in table.look(at, sight(elevation, azimuth)))  # type: ignore[return-value]


def town(count: int = 36) -> list[tuple[list[Values], float, float]]:
    """Return slightly turned blocks of 24 m and less on a grid of 40 m, 4 to 50 m high."""
    rng, found = np.random.default_rng(4), []
    for i in range(count):
        middle = 40.0 * (np.array(divmod(i, 6)) - 2.5)
        angle, half = rng.uniform(-0.15, 0.15), 12.0 * rng.uniform(0.75, 1.0, 2)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        corners = (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]]) * half) @ turn.T + middle
        found.append(([corners], float(min(4.0 + rng.gamma(4.0, 4.5), 50.0)), 0.0))
    return found


def table_of(solids: Any, bounds: Any = (-140.0, 140.0, -140.0, 140.0)) -> Skyline:
    walls = walls_of(solids)
    frame = frame_of(walls, bounds, LOWEST, 4.0, 64)
    assert frame is not None
    return make_table(walls, frame, LOWEST)


@pytest.mark.long
def test_it_hides_what_rays_meet_but_near_the_edges_of_shadows() -> None:
    """Law: less than 7 % of rays differ from exact ones, and less than 1.5 % farther than 2 m from a shadow's edge."""
    shapely = pytest.importorskip("shapely")
    solids = town()
    footprints = [shapely.Polygon(rings[0]) for rings, _, _ in solids]
    roofs, tree = np.array([top for _, top, _ in solids]), shapely.STRtree(footprints)
    rng = np.random.default_rng(5)
    places = np.column_stack([rng.uniform(-110.0, 110.0, (400, 2)), -rng.choice([1.5, 5.0, 12.0, 25.0, 40.0], 400)])
    places = places[[not tree.query(shapely.Point(p[:2]), "within").size for p in places]]
    elevation, azimuth = rng.uniform(LOWEST, 1.4, 12), rng.uniform(-np.pi, np.pi, 12)

    def exact(at: Values) -> Values:
        begin = np.repeat(at[:, None, :2], len(azimuth), axis=1)
        end = begin + 500.0 * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        rays = shapely.linestrings(np.stack([begin, end], axis=2).reshape(-1, 2, 2))
        ray, block = tree.query(rays, "intersects")
        cut = shapely.intersection(rays[ray], np.array(footprints)[block])
        away = shapely.distance(shapely.points(begin.reshape(-1, 2))[ray], cut)
        up = roofs[block] + at[ray // len(azimuth), 2]
        blocked = np.zeros(len(rays), bool)
        np.logical_or.at(blocked, ray, up > away * np.tan(elevation)[ray % len(azimuth)])
        return blocked.reshape(len(at), -1)

    here = exact(places)
    around = [places + 2.0 * np.array([math.cos(a), math.sin(a), 0.0]) for a in np.arange(8) * math.pi / 4.0]
    edge = np.any([exact(at) != here for at in around], axis=0)
    hidden_, _ = look(table_of(solids), places, elevation, azimuth)
    differs = hidden_ != here
    assert 0.1 < here.mean() < 0.6
    assert differs.mean() < 0.07
    assert (differs & ~edge).mean() < 0.015


def test_the_detour_of_a_reflection_is_the_shortest_way_over_the_wall() -> None:
    """Fermat: of all points of a wall the way over the mirrored one is the shortest; within 1 m and half a bin."""
    ends = np.array([[-20.0, 30.0], [35.0, 5.0]])
    table = table_of([([ends], 60.0, 0.0)], (-60.0, 60.0, -60.0, 60.0))
    detour, part = bytes_of(table, 2)[:, :, 0], 2.0 * math.pi / 64
    points = ends[0] + np.linspace(0.0, 1.0, 4001)[:, None] * (ends[1] - ends[0])
    checked = 0
    for i, j in np.ndindex(detour.shape[0] // 3, detour.shape[1] // 3):
        place = np.array([float(table.corner[0]), float(table.corner[1])]) + 4.0 * 3 * np.array([i, j])
        ways = []
        for offset in (0.0, 0.5, 1.0):
            azimuth = (np.arange(64) + offset) * part
            to = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
            extra = np.linalg.norm(points - place, axis=1)[:, None] - (points - place) @ to.T
            best = np.argmin(extra, axis=0)
            # At an end of the wall nothing is mirrored.
            ways.append(np.where((best > 0) & (best < len(points) - 1), extra.min(axis=0), np.nan))
        whole = np.isfinite(ways).all(axis=0) & (ways[1] > 0.5) & (ways[1] < 254.0)
        # Behind the wall the shortest way is straight through it, and no detour.
        spread = np.abs(np.array(ways) - ways[1]).max(axis=0)
        found = detour[3 * i, 3 * j][whole]
        assert (np.abs(found - ways[1][whole]) <= 1.0 + spread[whole])[found > 0].all()
        # The other way round: what is mirrored in the whole bin is in the table, but for one bin at each end.
        assert np.sum(found == 0) <= 2
        checked += int(np.sum(found > 0))
    assert checked > 500


@pytest.mark.long
def test_reflections_end_at_the_roof_and_above_all_roofs_there_is_nothing() -> None:
    # A wall 10 m to the north, 25 m high, seen from 5 m: up to atan(20/10).
    table = table_of(
        [([np.array([[10.0, -100.0], [10.0, 100.0], [14.0, 100.0], [14.0, -100.0]])], 25.0, 0.0)],
        (-2.0, 2.0, -2.0, 2.0),
    )
    elevation = np.radians([60.0, 65.0, 60.0, 66.0])
    azimuth = np.radians([0.0, 0.0, 180.0, 180.0]) + 0.02
    places = np.array([[0.0, 0.0, -5.0], [0.0, 0.0, -25.0], [0.0, 0.0, -80.0], [500.0, 0.0, -5.0]])
    hides, detour = look(table, places, elevation, azimuth)
    np.testing.assert_array_equal(hides[0], [True, False, False, False])
    # Twice the distance, as the satellite is straight behind.
    np.testing.assert_allclose(detour[0], [0.0, 0.0, 20.0, 0.0], atol=1.0)
    assert not hides[1:].any()
    assert not detour[1:].any()


def test_a_higher_building_hides_no_less() -> None:
    # The first is the highest in both, so that they have the same levels.
    lower = [(rings, 60.0 if i == 0 else top, 0.0) for i, (rings, top, _) in enumerate(town(12))]
    higher = [(rings, top + (7.0 if i % 3 == 1 else 0.0), 0.0) for i, (rings, top, _) in enumerate(lower)]
    first, second = (table_of(solids, (-60.0, 60.0, -140.0, 140.0)) for solids in (lower, higher))
    north = float(first.corner[0]) + 4.0 * np.arange(first.rows)
    east = float(first.corner[1]) + 4.0 * np.arange(first.columns)
    # Who is inside of one has what is beside it.
    outside = np.ones((first.rows, first.columns), bool)
    for rings, _, _ in lower:
        (south, west), (far, right) = rings[0].min(axis=0), rings[0].max(axis=0)
        outside &= ~((north > south) & (north < far))[:, None] | ~((east > west) & (east < right))[None, :]
    a, b = (bytes_of(table, 0)[outside].astype(int) for table in (first, second))
    assert (b >= a).all()
    assert (b > a).any()


def test_a_satellite_that_was_hidden_is_used_again_after_a_while() -> None:
    """1 s after it is seen again, 30 s if it was away for over a minute; new ones wait for their own time."""
    receiver = SimpleNamespace(acquisition=5.0, reacquisition=1.0, reacquisition_long=30.0)
    there, same, second = jnp.ones((1, 1), bool), jnp.ones(1, bool), jnp.ones(())
    for away, wait in ((20, 1.0), (60, 1.0), (61, 30.0)):

        def later(before: Any, blocked: Any, same: Any = same) -> Any:
            found = hidden._tracked(receiver, before, same, there, blocked, second)
            return SimpleNamespace(held=found[0], away=found[1])

        now = later(None, ~there)
        assert float(now.held[0, 0]) > 1e5
        for _ in range(away):
            now = later(now, there)
            assert float(now.held[0, 0]) == 0.0
        now = later(now, ~there)
        # Its weight begins to grow when this is the time of acquisition.
        assert float(now.held[0, 0]) == 5.0 - wait
        now = later(now, ~there)
        assert float(now.held[0, 0]) == 6.0 - wait
        assert float(later(now, ~there, ~same).held[0, 0]) > 1e5


STREET = [
    {"type": "box", "x_min": -100, "x_max": 100, "y_min": 8, "y_max": 24, "z_min": -25},
    {"type": "prism", "corners_ned": [[-100, -24], [100, -24], [100, -8], [-100, -8]], "z_min": -25},
    {"type": "cylinder", "x": 6.0, "y": 0.0, "radius": 0.2, "z_min": -40},
]


def in_a_street(obstacles: list[Any]) -> Any:
    fleet = {
        "controller": {"type": "waypoint", "feed": "truth"},
        "sensors": {"gnss": {"type": "gnss", "preset": "m8n"}},
        "vehicles": [
            {"position_ned": [0.0, 0.0, -3.0]},
            {"position_ned": [0.0, 0.0, -30.0], "waypoints_ned": [[60.0, 30.0, -30.0]]},
        ],
    }
    sim = qrsim.load({"name": "x", "duration": 9.0, "world": {"obstacles": obstacles}, "fleets": {"a": fleet}}, seed=1)
    sim.reset()
    return sim, sim.step(ticks=400).gnss


@pytest.mark.long
def test_above_all_roofs_the_fix_is_that_of_the_open_sky_to_the_bit() -> None:
    sim, gnss = in_a_street(STREET)
    other, free = in_a_street([])
    np.testing.assert_array_equal(gnss.position_ned[1], free.position_ned[1])
    np.testing.assert_array_equal(gnss.velocity_ned[1], free.velocity_ned[1])
    np.testing.assert_array_equal(gnss.horizontal_accuracy[1], free.horizontal_accuracy[1])
    assert gnss.satellites_blocked[1] == gnss.satellites_reflected[1] == 0.0
    np.testing.assert_array_equal(gnss.satellites_seen, free.satellites_seen)
    # Between the walls most of the sky is hidden, and reflections pull the fix down and aside by metres.
    assert gnss.satellites[0] == gnss.satellites_seen[0] - gnss.satellites_blocked[0]
    assert gnss.satellites_blocked[0] + gnss.satellites_reflected[0] >= 0.6 * gnss.satellites_seen[0]
    away = np.linalg.norm(gnss.position_ned[0] - sim.truth.position_ned[0])
    assert away > 2.0 + np.linalg.norm(free.position_ned[0] - other.truth.position_ned[0])
