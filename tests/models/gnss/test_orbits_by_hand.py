"""Orbits of the nominal constellation and of SP3 files, by geometry that has closed forms.

See docs/explanation/models/gnss.md.
"""

from __future__ import annotations

import cmath
import math
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.models.gnss.orbits import NominalConstellation, Phase, circular_orbits, dilution_of_precision
from qrsim.models.gnss.sp3 import Sp3Ephemeris, Sp3Orbits
from qrsim.models.gnss.sp3_file import Sp3File
from qrsim.models.site import Site

Array = np.ndarray[Any, Any]
# Speed of light [m/s], rotation of the Earth [rad/s] (IS-GPS-200), equatorial radius [m] (WGS-84).
C, OMEGA, RADIUS = 299792458.0, 7.2921151467e-5, 6378137.0
# On the equator at longitude 0, where north is z, east is y and down is -x of the Earth-fixed frame.
EQUATOR = Site.from_degrees(0.0, 0.0)
# What compiles these programs in the least time.
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
FIRST = 967_302_000.0


@partial(jax.jit, compiler_options=QUICK)
def positions_of(orbits: Any, seconds: Any, fraction: Any) -> Any:
    return orbits.positions_ned(seconds, fraction)


def received(orbits: Any, seconds: int, fraction: float = 0.0) -> Array:
    """Return positions (S, 3) in NED, in double precision."""
    with jax.enable_x64(True):
        found = positions_of(orbits, *moment(seconds, fraction))
        return np.stack([np.asarray(axis, np.float64) for axis in found.axes], axis=-1)


def moment(seconds: int, fraction: float = 0.0) -> Any:
    return np.int32(seconds), np.float64(fraction)


# The nominal constellation


def test_phases_count_in_parts_of_a_turn() -> None:
    """A quarter of a turn is 2^30 of 2^32 parts; whole turns drop out for years."""
    part = 2.0 * math.pi / 4294967296.0
    phase = Phase.of(np.array([0.5 * math.pi]), np.array([3.25 * part]))
    assert phase.units.tolist() == [1073741824]
    assert phase.units_per_s.tolist() == [3]
    assert phase.rest_per_s[0] == pytest.approx(0.25, abs=1e-6)
    # After 2^30 s it is 3.25/4 of a turn farther: 1.0625 turns, of which 22.5 degrees count.
    assert phase.angle(*moment(1073741824))[0] == pytest.approx(math.pi / 8.0, abs=1e-8)


def test_a_signal_leaves_one_step_from_77_ms_before_it_arrives() -> None:
    """(G3) in the plane of the equator, with complex numbers, of a satellite ten times as fast as real ones."""
    radius, rate, begin = 26_560_000.0, 1e-3, 0.3
    zero = np.zeros(1)
    orbits = circular_orbits((zero + begin, zero), (rate, 0.0), radius, 0.0, EQUATOR)

    def ray(flight: float) -> complex:
        # At transmission, turned back by what the Earth turned on.
        angle = begin + rate * (12.25 - flight) - OMEGA * flight
        return radius * cmath.exp(1j * angle) - RADIUS

    expected = ray(abs(ray(0.077)) / C)
    found = received(orbits, 12, 0.25)
    np.testing.assert_allclose(found, [[0.0, expected.imag, -expected.real]], rtol=0.0, atol=1e-5)


def test_numbers_of_slots_are_no_prns() -> None:
    """A hand list knows satellites by the lower byte, which slots leave at 0."""
    ids = NominalConstellation().satellite_ids
    assert len(set(ids.tolist())) == 24
    assert not (ids & 0xFF).any()


def test_directions_may_miss_unit_length_by_a_thousandth() -> None:
    bearings = np.radians([0.0, 120.0, 240.0])
    horizon = np.column_stack([np.cos(bearings), np.sin(bearings), np.zeros(3)])
    sky = np.vstack([horizon, [0.0, 0.0, -1.0]])
    assert dilution_of_precision(1.0009 * sky)[3] == pytest.approx(math.sqrt(1.0 / 3.0), rel=2e-3)
    with pytest.raises(UsageError, match="unit vectors"):
        dilution_of_precision(1.0011 * sky)


# SP3 files


def ephemeris_of(
    positions: Array, interval: int = 900, names: tuple[str, ...] = ("G01",), systems: str | None = None
) -> Sp3Ephemeris:
    """Return the ephemeris of a file with these positions (E, S, 3) [m]."""
    shape = positions.shape[:2]
    data = Sp3File(
        "orbits.sp3", "c", names, FIRST, interval, positions, np.zeros(shape), np.zeros(shape, bool), (), {}, (), ""
    )
    found = Sp3Ephemeris("orbits.sp3", systems)
    vars(found)["data"] = data
    return found


def standing(epochs: int, names: int = 4) -> Array:
    """Return positions of satellites that stand still."""
    return np.full((epochs, names, 3), 15e6)


def test_numbers_of_satellites_tell_letter_and_prn() -> None:
    """256 times the code of the letter, E 69 and G 71, plus the PRN."""
    found = ephemeris_of(standing(12, 3), names=("E11", "G05", "G32"), systems="GE")
    assert found.satellite_ids.tolist() == [17675, 18181, 18208]


@pytest.mark.parametrize(("epoch", "counts"), [(3, False), (4, True), (15, True), (16, False)])
def test_an_interval_is_made_of_the_twelve_epochs_around_it(epoch: int, counts: bool) -> None:
    """Of epochs 0 to 19 the interval from 9 to 10 has 4 to 15, six on each side."""
    positions = np.zeros((20, 1, 3))
    positions[epoch] = 1000.0
    found = ephemeris_of(positions).positions_ecef(FIRST + 9.5 * 900.0)
    assert bool((np.abs(found) > 1e-3).all()) == counts
    assert bool((found != 0.0).any()) == counts


def test_twelve_epochs_are_enough_up_to_the_last_one() -> None:
    """A polynomial of degree 11 is its own interpolation."""
    place = np.arange(12.0)
    positions = np.repeat(1e7 + ((place - 5.5) ** 11)[:, None, None], 3, axis=2)
    found = ephemeris_of(positions).positions_ecef(FIRST + 900.0 * np.array([0.0, 2.25, 11.0]))
    expected = 1e7 + (np.array([0.0, 2.25, 11.0]) - 5.5) ** 11
    np.testing.assert_allclose(found[:, 0], np.repeat(expected[:, None], 3, axis=1), rtol=1e-11)


def test_a_satellite_that_lacks_the_last_epoch_has_no_last_interval() -> None:
    positions = standing(14)
    positions[13, 2] = np.nan
    found = ephemeris_of(positions, names=("G01", "G02", "G03", "G04"))
    assert np.isnan(found.positions_ecef(FIRST + 12.5 * 900.0)).all(axis=-1).tolist() == [False, False, True, False]
    assert not np.isnan(found.positions_ecef(FIRST + 11.5 * 900.0)).any()


def test_notes_begin_30_minutes_from_the_ends() -> None:
    found = ephemeris_of(standing(20), names=("G01", "G02", "G03", "G04"))
    assert found.notes(FIRST + 1801.0, 60.0) == ()
    (note,) = found.notes(FIRST + 1799.0, 60.0)
    assert "within 30 minutes of the start" in note


def test_the_travel_time_of_a_fast_satellite_is_found_from_75_ms() -> None:
    """At 0.7 % of the speed of light a round shrinks the error by 150 only; one that is 75 ms away needs none.

    It flies outwards in the zenith of the equator. When it transmitted it was c times 75 ms above the ground.
    """
    speed, flight = 2e6, 0.075
    there = RADIUS + C * flight
    outwards = there + speed * (np.arange(12.0) - 5.5 + flight)
    positions = np.zeros((12, 1, 3))
    positions[:, 0, 0] = outwards
    found = ephemeris_of(positions, interval=1).received_ned(EQUATOR, FIRST + 5.5)
    turned = OMEGA * flight
    expected = [0.0, -there * math.sin(turned), -(there * math.cos(turned) - RADIUS)]
    np.testing.assert_allclose(found, [expected], rtol=0.0, atol=1e-3)


def test_a_tick_has_the_least_polynomial_of_degree_5() -> None:
    """Through the zeros of T6, so that s^6 is missed by T6/2^5, the same at both ends and, reversed, in the middle.

    Satellites stand over the equator, but for a z of 32 s^6 metres, s from -1 to 1 over an interval.
    """
    middle = 9.5 * 900.0
    positions = np.zeros((20, 4, 3))
    positions[..., 0] = 26e6
    positions[..., 2] = (32.0 * ((900.0 * np.arange(20) - middle) / 450.0) ** 6)[:, None]
    found = ephemeris_of(positions, names=("G01", "G02", "G03", "G04"))
    orbits = found.at(EQUATOR, FIRST + 3600.0, np.float64)
    flight = (26e6 - RADIUS) / C
    north = [received(orbits, t - 3600)[0, 0] for t in (8100, 8550, 8999)]
    exact = [32.0 * ((t - flight - middle) / 450.0) ** 6 for t in (8100, 8550, 8999)]
    # T6 is 1 at -1, -1 at 0; near 1 its slope is 36.
    last = 1.0 - 36.0 / 450.0 + 0.5 * 420.0 / 450.0**2
    np.testing.assert_allclose(np.subtract(north, exact), [-1.0, 1.0, -last], atol=1e-3)


@pytest.mark.parametrize(("seconds", "expected"), [(0, 5.0), (99, 14.9), (100, 17.0), (150, 20.0), (200, 23.0)])
def test_the_end_of_the_last_interval_belongs_to_it(seconds: int, expected: float) -> None:
    """Two intervals of 100 s: 10 + 5 s, then 20 + 3 s."""
    coefficients: Any = np.zeros((2, 2, 3, 1))
    coefficients[:, :, 0, 0] = [[5.0, 10.0], [3.0, 20.0]]
    fields: Any = (np.int32(100), np.int32(0), np.float64(0.0))
    found = received(Sp3Orbits(coefficients, *fields), seconds)
    np.testing.assert_allclose(found, [[expected, 0.0, 0.0]], rtol=1e-12)
