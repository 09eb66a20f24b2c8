"""Nominal constellations of four systems, slots, and weighted solutions."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.models.gnss import flown_receivers as receivers

from qrsim.core.clock import split_time
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.gnss.constellations import NominalConstellations, satellite_name
from qrsim.models.gnss.orbits import NominalConstellation, dilution_of_precision, elevation_azimuth
from qrsim.models.gnss.sight import sight_of
from qrsim.models.gnss.slots import assigned
from qrsim.models.gnss.solving import correlated, factor, solve
from qrsim.models.site import Site

# 2016-11-21 00:00 UTC: 13469 days and 17 leap seconds of GPS time.
EPOCH = 13469 * 86400.0 + 17.0


def rays(systems: str, times: np.ndarray, site: Site) -> np.ndarray:
    """Return rays (T, S, 3) [m] in NED from a site to the satellites."""
    return (NominalConstellations(systems).positions_ecef(times) - site.origin_ecef()) @ site.ned_from_ecef_rotation().T


class TestConstellations:
    def test_numbers_of_satellites_say_their_names(self):
        for ephemeris in (NominalConstellations("GERC"), NominalConstellations("RC")):
            names = [satellite_name(int(number)) for number in ephemeris.satellite_ids]
            assert names == list(ephemeris.satellites)
        alone = NominalConstellation()
        assert satellite_name(int(alone.satellite_ids[5])) == f"G-{alone.satellites[5]}"
        # Of a file: 256 times the letter's code plus the number.
        assert satellite_name(256 * ord("E") + 7) == "E07"

    def test_gps_is_the_constellation_of_gps(self):
        times = EPOCH + np.array([0.0, 1e5, 3e8])
        expected = NominalConstellation().positions_ecef(times)
        np.testing.assert_array_equal(NominalConstellations("G").positions_ecef(times), expected)

    def test_a_galileo_satellite_is_where_its_slot_was_published(self):
        """Slot A02: node at 317.632 deg of right ascension, 225.153 deg of argument; Greenwich at 60.4264 deg."""
        galileo = NominalConstellations("E")
        where = galileo.positions_ecef(EPOCH)[galileo.satellites.index("E-A2")]
        node, argument, tilt = np.radians([317.632 - 60.4264, 225.153, 56.0])
        up = np.cos(argument) * np.array([np.cos(node), np.sin(node), 0.0])
        across = np.array([-np.sin(node) * np.cos(tilt), np.cos(node) * np.cos(tilt), np.sin(tilt)])
        np.testing.assert_allclose(where, 29599.8e3 * (up + np.sin(argument) * across), atol=100.0)

    @pytest.mark.parametrize(
        ("system", "period"), [("R", 11 * 3600.0 + 15 * 60.0 + 44.0), ("E", 14 * 3600.0 + 4 * 60.0 + 42.0)]
    )
    def test_satellites_come_back_after_a_period(self, system, period):
        """In space: the Earth turns below them. ICD of GLONASS 5.1; Galileo's 29600 km are 14 h 4 min 42 s."""
        first, last = NominalConstellations(system).positions_ecef(EPOCH + np.array([0.0, period]))
        turn = 7.2921151467e-5 * period
        east, north = first[:, 0], first[:, 1]
        expected = np.stack(
            [np.cos(turn) * east + np.sin(turn) * north, np.cos(turn) * north - np.sin(turn) * east], -1
        )
        # 1 s of the orbit is 4 km, and the nodes drift by 6 km a turn.
        np.testing.assert_allclose(last[:, :2], expected, atol=4e4)

    def test_eight_satellites_in_each_of_three_planes(self):
        for system, height in (("E", 29599.8), ("R", 25508.0), ("C", 27906.0)):
            places = NominalConstellations(system).positions_ecef(EPOCH)
            assert places.shape == (24, 3)
            np.testing.assert_allclose(np.linalg.norm(places, axis=1), height * 1e3, rtol=1e-4)
            for plane in places.reshape(3, 8, 3):
                assert np.linalg.matrix_rank(plane / 1e7, tol=1e-3) == 2
                beside = np.sum(plane * np.roll(plane, -1, axis=0), axis=1) / (height * 1e3) ** 2
                np.testing.assert_allclose(beside, np.cos(np.radians(45.0)), atol=1e-3)

    def test_satellites_in_view(self):
        """28.5 of four systems, 14.0 of two, above 10 deg at 51.7 N."""
        times = 1.4e9 + np.arange(0.0, 86400.0, 600.0)
        for systems, mean in (("GERC", 28.5), ("GE", 14.0), ("G", 6.8)):
            seen = elevation_azimuth(rays(systems, times, Site()))[0] > np.radians(10.0)
            assert seen.sum(axis=1).mean() == pytest.approx(mean, abs=0.5)

    @pytest.mark.parametrize("step", [20.0, pytest.param(6.0, marks=pytest.mark.nightly)])
    def test_dilution_of_gps_is_that_of_its_performance_standard(self, step):
        """SPS PS 2020, appendix B: HDOP 0.94, 1.16 and 1.25 at 50, 90 and 95 % of the globe and a day, 5 deg mask."""
        found, weight = [], []
        times = 1.4e9 + np.arange(0.0, 86164.0, 180.0 * step)
        for latitude in np.arange(-90.0 + step / 2.0, 90.0, step):
            for longitude in np.arange(-180.0, 180.0, 3.0 * step):
                for ray in rays("G", times, Site.from_degrees(latitude, longitude)):
                    unit = ray / np.linalg.norm(ray, axis=1, keepdims=True)
                    found.append(dilution_of_precision(unit[-unit[:, 2] > np.sin(np.radians(5.0))])[0])
                    weight.append(np.cos(np.radians(latitude)))
        order = np.argsort(found)
        share = np.cumsum(np.array(weight)[order]) / np.sum(weight)
        quantiles = [float(np.array(found)[order][np.searchsorted(share, q)]) for q in (0.5, 0.9, 0.95)]
        assert quantiles == pytest.approx([0.94, 1.16, 1.25], abs=0.02)

    def test_numbers_of_satellites_do_not_depend_on_the_systems(self):
        every = dict(zip(NominalConstellations().satellites, NominalConstellations().satellite_ids, strict=True))
        some = dict(zip(NominalConstellations("CE").satellites, NominalConstellations("CE").satellite_ids, strict=True))
        assert some.items() <= every.items()
        assert len(set(every.values())) == 96

    @pytest.mark.parametrize(
        ("systems", "words"),
        [("X", "G (GPS), E (Galileo), R (GLONASS), C (BeiDou)"), ("", "does not consist"), ("GG", "twice")],
    )
    def test_letters_are_checked(self, systems, words):
        with pytest.raises(UsageError) as caught:
            NominalConstellations(systems)
        assert words in str(caught.value)


class TestSlots:
    @pytest.mark.long
    def test_satellites_keep_their_slots(self):
        places = jnp.array([3, -1, 0, 5], jnp.int32)
        in_view = jnp.array([True, True, False, False, False, True, True])
        found, dropped = assigned(in_view, jnp.linspace(0.1, 0.9, 7), places)
        # 0 and 5 stay; 1 and 6 take what 3 has left and what was free.
        assert found.tolist() == [1, 6, 0, 5]
        assert int(dropped) == 0

    def test_the_lowest_find_none(self):
        found, dropped = assigned(
            jnp.array([True, True, True, True]), jnp.array([0.3, 0.9, 0.1, 0.5]), jnp.full(3, -1, jnp.int32)
        )
        assert sorted(found.tolist()) == [0, 1, 3]
        assert int(dropped) == 1

    def test_slots_are_given_back(self):
        found, _ = assigned(jnp.zeros(4, bool), jnp.zeros(4), jnp.array([2, 1], jnp.int32))
        assert found.tolist() == [-1, -1]


class TestSight:
    def test_mappings(self):
        """Both are 1 at the zenith. At 10 deg: 6371 cos e/6721 = 0.93352, 1/sqrt(1 - 0.93352^2); DO-229D gives 5.58."""
        elevation = np.radians([90.0, 10.0])
        towards = Vec3(
            *(jnp.asarray(2.3e7 * axis) for axis in (np.cos(elevation), 0.0 * elevation, -np.sin(elevation)))
        )
        sight = sight_of(towards)
        np.testing.assert_allclose(sight.ionosphere, [1.0, 2.789], rtol=2e-3)
        np.testing.assert_allclose(sight.troposphere, [1.0, 5.58], rtol=2e-3)
        # psi = 90 deg - 10 deg - asin(0.93352) = 11.009 deg of a circle of 6371 km.
        np.testing.assert_allclose(sight.pierce_north, [0.0, 1224.2], atol=3.0)
        np.testing.assert_allclose(sight.pierce_east, 0.0, atol=1e-3)


class TestSolving:
    def setup_method(self):
        numbers = np.random.default_rng(4)
        azimuth, elevation = numbers.uniform(0.0, 2.0 * np.pi, 14), numbers.uniform(0.2, 1.5, 14)
        self.unit = np.stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), -np.sin(elevation)], axis=-1
        )
        self.weight = numbers.uniform(0.1, 2.0, 14) * (np.arange(14) < 11)
        self.columns = Vec3(*(jnp.asarray(self.unit[:, i : i + 1], jnp.float32) for i in range(3)))
        self.solution = solve(
            self.columns, jnp.asarray(self.weight[:, None], jnp.float32), jnp.asarray(self.weight[:, None] > 0.0)
        )
        # rho = -u . d + c: least squares by the full matrix, in double precision.
        design = np.column_stack([-self.unit, np.ones(14)])
        self.matrix = np.linalg.inv((design * self.weight[:, None]).T @ design) @ (design * self.weight[:, None]).T

    def test_it_is_weighted_least_squares(self):
        errors = np.random.default_rng(5).normal(size=(14, 3))
        (found,) = self.solution.of([jnp.asarray(errors, jnp.float32)])
        np.testing.assert_allclose(found.stack().T, (self.matrix @ errors)[:3], atol=2e-5)
        np.testing.assert_allclose(self.solution.rows().stack()[:, 0].T, self.matrix[:3], atol=2e-5)

    def test_dilution_counts_each_satellite_alike(self):
        hdop, vdop, _, _ = dilution_of_precision(self.unit[:11])
        assert float(self.solution.hdop[0]) == pytest.approx(hdop, rel=1e-5)
        assert float(self.solution.vdop[0]) == pytest.approx(vdop, rel=1e-5)

    def test_noise_has_the_covariance_of_the_solution(self):
        variance = np.random.default_rng(6).uniform(0.5, 2.0, 14)
        by = factor(self.solution.rows(), jnp.asarray(variance[:, None], jnp.float32))
        columns = [correlated(by, tuple(jnp.asarray(float(i == k)) for k in range(3))).stack()[0] for i in range(3)]
        root = np.stack(columns, axis=1)
        np.testing.assert_allclose(
            root @ root.T, (self.matrix * variance @ self.matrix.T)[:3, :3], rtol=1e-4, atol=1e-6
        )

    def test_three_satellites_are_not_enough(self):
        used = jnp.asarray((np.arange(14) < 3)[:, None])
        few = solve(self.columns, used.astype(jnp.float32), used)
        assert not bool(few.enough[0])
        assert np.isfinite(few.rows().stack()).all()


@pytest.mark.nightly
def test_a_sky_that_steps_by_parts_is_the_same():
    """At every tick of three knots, to the bit."""
    sky = receivers.sky_of(receivers.receiver("f9p_single"))
    sky = replace(sky, time_step=0.02, each_epoch=False)
    assert sky.steps_by_parts
    stream = Key.root(3).stream("/sky", sky.ids)
    like = jnp.zeros((), jnp.float32)
    start = sky.init(Draw(stream, jnp.int32(0), like))

    @jax.jit
    def run(start: Any) -> Any:
        def step(both: Any, tick: jax.Array) -> Any:
            whole, parts = both
            draw = Draw(stream, tick, like)
            seconds, fraction = split_time(tick, 0.02, like.dtype)
            whole = jax.lax.cond(tick % 10 == 0, lambda: sky.step(whole, draw, seconds, fraction), lambda: whole)
            parts = sky.step_by_parts(parts, draw, tick)
            pairs = zip(jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True)
            return (whole, parts), jnp.all(jnp.stack([jnp.all(a == b) for a, b in pairs]))

        return jax.lax.scan(step, (start, start), jnp.arange(1, 760, dtype=jnp.int32))

    (end, _), same = run(start)
    assert bool(np.all(same))
    assert int(end.slots.knot) == 3
