"""SP3 orbits: interpolation, the polynomials of a tick, gaps, warnings, and fixes.

Leave-one-out errors of the recorded file, epoch by epoch: the epoch is left out, the polynomial of degree 11 through
the 12 nearest of the others is evaluated there. Largest and root mean square length over 31 satellites, in cm:

    epoch     1    2    3    4    5    6    7    8    9   10   11   12   13   14   15   16   17   18   19   20
    largest 193 16.1 2.93 0.88 0.39 0.24 0.21 0.22 0.22 0.20 0.27 0.47 0.50 0.42 0.49 0.78 1.75 5.83 32.1  385
    rms     107 8.91 1.62 0.49 0.22 0.14 0.12 0.14 0.13 0.11 0.10 0.14 0.16 0.15 0.17 0.28 0.63 2.09 11.5  138

At epoch 18 the 5.83 cm are those of G29, whose positions are rougher than the others'; without it the largest is
3.09 cm. Leaving an epoch out makes a gap twice as wide as the interpolation really spans, which does far better.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from tests.models.gnss.sp3_writing import FIRST, NOMINAL, edit, line_of, names_of, sp3_text

import qrsim
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.gnss.orbits import elevation_azimuth
from qrsim.models.gnss.receivers import GnssReceiver, SkyState
from qrsim.models.gnss.sp3 import DEGREE, Sp3Ephemeris, Sp3Orbits, lagrange_basis
from qrsim.models.site import Site, gps_seconds_from_utc, utc_from_gps_seconds

Array = np.ndarray[Any, Any]
F32 = np.float32
OMEGA, C = 7.2921151467e-5, 299792458.0
RECORDED = "ngs15992_16to17.sp3"
# The default site; the others look at other parts of the sky.
SITES = [Site(), Site.from_degrees(0.0, 120.0, 50.0), Site.from_degrees(-35.0, -70.0)]
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False})


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], str]:
    def write_it(text: str) -> str:
        path = tmp_path / "orbits.sp3"
        path.write_text(text, encoding="latin-1")
        return str(path)

    return write_it


@pytest.fixture(scope="module")
def recorded(recordings: Path) -> Sp3Ephemeris:
    return Sp3Ephemeris(str(recordings / RECORDED))


# Which satellites


def test_fewer_than_twelve_epochs_in_a_row(write: Any) -> None:
    ephemeris = Sp3Ephemeris(write(sp3_text(epochs=11)))
    with pytest.raises(UsageError, match=r"'G' has positions at 12 epochs in a row.*the file has 11 epochs"):
        ephemeris.satellites  # noqa: B018


def test_systems(write: Any) -> None:
    path = write(sp3_text("c", names_of("E", 10) + names_of("G")))
    assert Sp3Ephemeris(path).satellites == tuple(names_of("G"))
    assert Sp3Ephemeris(path, "E").satellites == tuple(names_of("E", 10))
    both = Sp3Ephemeris(path, "GE")
    assert both.satellites == tuple(names_of("E", 10) + names_of("G"))
    # The same number in every file, so that a satellite keeps its randomness whatever else is used.
    np.testing.assert_array_equal(both.satellite_ids[10:], Sp3Ephemeris(path).satellite_ids)
    assert len(set(both.satellite_ids.tolist())) == 34
    assert both.satellite_ids.dtype == np.uint32
    with pytest.raises(UsageError, match=r"no satellite of systems 'R'; the file has E \(Galileo\): 10, G \(GPS\): 24"):
        Sp3Ephemeris(path, "R").satellites  # noqa: B018
    for letters in ("", "GX", "gps"):
        with pytest.raises(UsageError, match=f"systems: '{letters}' does not consist of letters .* R .GLONASS."):
            Sp3Ephemeris(path, letters).satellites  # noqa: B018


# Interpolation


def test_lagrange_basis() -> None:
    nodes = np.array([0.0, 1.0, 2.5, 4.0, 7.0])
    points = np.array([[0.0, 2.5, 7.0], [0.3, 3.3, 6.9]])
    basis = lagrange_basis(nodes, points)
    assert basis.shape == (2, 3, 5)
    np.testing.assert_allclose(basis[0], np.eye(5)[[0, 2, 4]], atol=1e-15)
    # A polynomial of degree 4 is its own interpolation.
    powers = np.array([3.0, -2.0, 0.5, 1.0, -4.0])
    np.testing.assert_allclose(basis @ np.polyval(powers, nodes), np.polyval(powers, points), rtol=1e-12, atol=1e-9)


def leave_one_out(positions: Array) -> Array:
    """Length of the error (E, S) [m] at each epoch, from the 12 nearest of the others."""
    epochs = len(positions)
    errors = []
    for left_out in range(epochs):
        others = np.delete(np.arange(epochs), left_out)
        low = np.clip(left_out - (DEGREE + 1) // 2, 0, epochs - 1 - (DEGREE + 1))
        nodes = others[low : low + DEGREE + 1]
        found = np.einsum("n,nsa->sa", lagrange_basis(nodes, left_out), positions[nodes])
        errors.append(np.linalg.norm(found - positions[left_out], axis=-1))
    return np.array(errors)


def test_leave_one_out(recorded: Sp3Ephemeris) -> None:
    """The table at the top of this file."""
    errors = leave_one_out(recorded.data.positions_ecef)
    largest, rms = 100.0 * errors.max(axis=1), 100.0 * np.sqrt(np.mean(errors**2, axis=1))
    np.testing.assert_allclose(
        largest,
        [193, 16.1, 2.93, 0.88, 0.39, 0.24, 0.21, 0.22, 0.22, 0.20,
         0.27, 0.47, 0.50, 0.42, 0.49, 0.78, 1.75, 5.83, 32.1, 385],
        rtol=5e-3, atol=0.0051,
    )  # fmt: skip
    np.testing.assert_allclose(
        rms,
        [107, 8.91, 1.62, 0.49, 0.22, 0.14, 0.12, 0.14, 0.13, 0.11,
         0.10, 0.14, 0.16, 0.15, 0.17, 0.28, 0.63, 2.09, 11.5, 138],
        rtol=5e-3, atol=0.0051,
    )  # fmt: skip
    # Epochs 3 to 18 stay under 5 cm but for G29 at the last of them.
    within = errors[2:18]
    assert [(epoch + 3, recorded.satellites[i]) for epoch, i in np.argwhere(within > 0.05)] == [(18, "G29")]
    assert errors[2].max() < 0.03
    assert errors[6:15].max() < 0.0051


def test_interpolation_of_circular_orbits(write: Any) -> None:
    """The truth is known between the epochs. The file's millimetres are rounded, which alone makes up to 0.8 mm."""
    ephemeris = Sp3Ephemeris(write(sp3_text()))
    into = np.linspace(20.0, 880.0, 44)
    times = FIRST + 900.0 * np.arange(19)[:, None] + into
    errors = np.linalg.norm(ephemeris.positions_ecef(times) - NOMINAL.positions_ecef(times), axis=-1).max(axis=(1, 2))
    # Of the 19 intervals: 15, 3.1, 1.4, then 0.9 to 1.2, and 1.5, 3.4, 18 mm measured.
    assert errors[2:-2].max() < 2e-3
    assert errors[[1, -2]].max() < 5e-3
    assert errors[[0, -1]].max() < 25e-3


def test_interpolation_passes_through_the_epochs(recorded: Sp3Ephemeris) -> None:
    times = FIRST + 900.0 * np.arange(20)
    np.testing.assert_allclose(recorded.positions_ecef(times), recorded.data.positions_ecef, rtol=0.0, atol=1e-6)
    assert recorded.positions_ecef(times[3]).shape == (31, 3)
    assert recorded.positions_ecef(times.reshape(4, 5)).shape == (4, 5, 31, 3)


def test_interpolation_is_about_the_centre(recorded: Sp3Ephemeris) -> None:
    """Epochs 5 to 16 make the interval between 10 and 11; a change of any other epoch leaves it as it is."""
    positions = recorded.data.positions_ecef
    nodes = np.arange(4, 16)
    expected = np.einsum("n,nsa->sa", lagrange_basis(nodes, 9.3), positions[nodes])
    np.testing.assert_allclose(recorded.positions_ecef(FIRST + 9.3 * 900.0), expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("after", [-0.001, 19 * 900.0 + 0.001, 86400.0, math.nan, -1e10])
def test_times_outside_name_the_span(recorded: Sp3Ephemeris, after: float) -> None:
    words = r"is outside the file's span, 2010-08-31 14:59:45 to 2010-08-31 19:44:45 UTC"
    with pytest.raises(UsageError, match=words):
        recorded.positions_ecef([FIRST + 10.0, FIRST + after])
    with pytest.raises(UsageError, match=words):
        recorded.at(Site(), FIRST + after, F32)


def test_a_run_of_another_date(recorded: Sp3Ephemeris) -> None:
    start = gps_seconds_from_utc(datetime(2026, 6, 21, 10, tzinfo=UTC))
    with pytest.raises(UsageError, match=rf"{RECORDED}: 2026-06-21 10:00:00 UTC is outside"):
        recorded.at(Site(), start, F32)
    with pytest.raises(UsageError, match=rf"{RECORDED}: 2010-08-31 20:29:45 UTC is outside"):
        recorded.at(Site(), FIRST + 3600.0, F32, duration_s=5 * 3600.0 - 1800.0)


# In a tick


def orbits_at(ephemeris: Sp3Ephemeris, site: Site, start: float, dtype: Any = F32) -> Sp3Orbits:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ephemeris.at(site, start, dtype)


def tick_positions(orbits: Sp3Orbits, seconds: Array, fraction: float, dtype: Any = F32) -> Array:
    """Positions (T, S, 3) at whole seconds (T,) and a fraction."""
    with jax.enable_x64(dtype is np.float64):
        ned = jit(jax.vmap(lambda s: orbits.positions_ned(s, jnp.asarray(fraction, dtype))))(
            jnp.asarray(seconds, jnp.int32)
        )
        assert ned.x.dtype == dtype
        return np.stack([np.asarray(axis, np.float64) for axis in (ned.x, ned.y, ned.z)], axis=-1)


def unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def about_z(vectors: Array, angle: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


@pytest.mark.parametrize("site", SITES)
def test_received_positions_solve_the_light_time_equation(recorded: Sp3Ephemeris, site: Site) -> None:
    """In axes that do not turn, the site where it is at reception and the satellite where it was at transmission."""
    each = np.arange(31)
    for time in FIRST + np.array([1.0, 5000.3, 12345.6, 17099.0]):
        flight = np.full(31, 0.07)
        for _ in range(10):
            transmitted = recorded.positions_ecef(time - flight)[each, each]
            ray = about_z(transmitted, -OMEGA * flight) - site.origin_ecef()
            flight = np.linalg.norm(ray, axis=-1) / C
        # Times of 1e9 s are rounded to 1e-7 s, in which a satellite moves 0.5 mm.
        np.testing.assert_allclose(
            recorded.received_ned(site, time), ray @ site.ned_from_ecef_rotation().T, rtol=0.0, atol=1e-3
        )


@pytest.mark.parametrize("site", SITES)
def test_single_precision_directions_over_the_whole_file(recorded: Sp3Ephemeris, site: Site) -> None:
    start = FIRST + 0.25
    seconds = np.concatenate([np.arange(40), np.arange(40, 17100, 37)])
    got = unit(tick_positions(orbits_at(recorded, site, start), seconds, 0.6))
    expected = unit(recorded.received_ned(site, np.minimum(start + seconds + np.float64(F32(0.6)), FIRST + 17100.0)))
    # 2e-6 is what is needed; 9e-8 measured.
    assert np.linalg.norm(got - expected, axis=-1).max() < 3e-7


def test_double_precision_positions_over_the_whole_file(recorded: Sp3Ephemeris) -> None:
    """Polynomials of degree 5 stand for those of degree 11 and the signal's flight."""
    start = FIRST + 1800.25
    seconds = np.arange(-1800, 15299, 41)
    got = tick_positions(orbits_at(recorded, Site(), start, np.float64), seconds, 0.6, np.float64)
    # 0.4 mm measured.
    np.testing.assert_allclose(got, recorded.received_ned(Site(), start + seconds + 0.6), rtol=0.0, atol=1e-3)


def test_short_steps_are_not_lost_late_in_a_run(recorded: Sp3Ephemeris) -> None:
    orbits = orbits_at(recorded, Site(), FIRST)
    early, late = (tick_positions(orbits, np.array([17000]), fraction)[0] for fraction in (0.2, 0.4))
    exact = np.diff(recorded.received_ned(Site(), FIRST + 17000.0 + np.array([0.2, 0.4])), axis=0)[0]
    assert np.linalg.norm(exact, axis=-1).min() > 400.0
    # Rounding of a position is 10 m at most.
    np.testing.assert_allclose(late - early, exact, atol=20.0)


def test_outside_the_span_there_are_no_positions(recorded: Sp3Ephemeris) -> None:
    got = tick_positions(orbits_at(recorded, Site(), FIRST + 100.0), np.array([-101, -100, 17000, 17001, 100000]), 0.0)
    assert np.isnan(got).all(axis=(1, 2)).tolist() == [True, False, False, True, True]
    assert np.isnan(got).any(axis=(1, 2)).tolist() == [True, False, False, True, True]


def test_worlds_with_their_own_sites_and_starts(recorded: Sp3Ephemeris) -> None:
    starts = FIRST + np.array([2000.0, 9000.5, 15000.0])
    records = [orbits_at(recorded, site, start) for site, start in zip(SITES, starts, strict=True)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *records)
    seconds, fraction = jnp.int32(1234), jnp.float32(0.4)
    together = jit(jax.vmap(lambda o: o.positions_ned(seconds, fraction)))(batch)
    assert together.x.shape == (3, 31)
    for i in range(3):
        alone = tick_positions(records[i], np.array([1234]), 0.4)[0]
        np.testing.assert_allclose(np.asarray(together.stack())[i], alone, atol=10.0)


def test_leaves(recorded: Sp3Ephemeris) -> None:
    leaves = jax.tree.leaves(orbits_at(recorded, Site(), FIRST))
    assert [(leaf.dtype.name, leaf.shape) for leaf in leaves] == [
        ("float32", (19, 6, 3, 31)), ("int32", ()), ("int32", ()), ("float32", ()),
    ]  # fmt: skip


# Warnings


def warned(ephemeris: Sp3Ephemeris, start: float, duration_s: float = math.inf) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ephemeris.at(Site(), start, F32, duration_s)
    messages = [str(warning.message) for warning in caught]
    assert messages == list(ephemeris.notes(start, duration_s))
    return messages


def test_warning_within_30_minutes_of_the_ends(recorded: Sp3Ephemeris) -> None:
    span = "the file's span, 2010-08-31 14:59:45 to 2010-08-31 19:44:45 UTC, where interpolation loses accuracy"
    path = recorded.file
    first = f"{path}: the run comes within 30 minutes of the start of {span}"
    last = f"{path}: the run comes within 30 minutes of the end of {span}"
    assert warned(recorded, FIRST + 1800.0, 60.0) == []
    assert warned(recorded, FIRST + 1799.0, 60.0) == [first]
    assert warned(recorded, FIRST + 7200.0, 17100.0 - 7200.0 - 1800.0) == []
    assert warned(recorded, FIRST + 7200.0, 17100.0 - 7200.0 - 1799.0) == [last]
    assert warned(recorded, FIRST, 17100.0) == [first, last]
    # A run of unknown length: it is no news that it may come near the end.
    assert warned(recorded, FIRST + 7200.0) == []


def gappy(write: Any) -> Sp3Ephemeris:
    """24 satellites at 40 epochs; G03 lacks epoch 20, G04 all after epoch 13, G05 is moved before epoch 26."""
    text = sp3_text(epochs=40)
    text = edit(text, line_of(text, "PG05", 26), lambda line: f"{line:<78}M")
    text = edit(text, line_of(text, "PG03", 20), lambda line: f"PG03{0:14.6f}{0:14.6f}{0:14.6f}")
    lines = text.splitlines()
    late = line_of(text, "*", 14)
    kept = [line for i, line in enumerate(lines, 1) if not (i > late and line.startswith("PG04"))]
    return Sp3Ephemeris(write("\n".join([*kept, ""])))


def test_gaps(write: Any) -> None:
    ephemeris = gappy(write)
    names = list(ephemeris.satellites)
    times = FIRST + 900.0 * (np.arange(39) + 0.5)
    positions = ephemeris.positions_ecef(times)
    absent = np.isnan(positions).any(axis=-1)
    np.testing.assert_array_equal(absent, np.isnan(positions).all(axis=-1))
    assert np.flatnonzero(absent[:, names.index("G03")]).tolist() == [19, 20]
    assert np.flatnonzero(absent[:, names.index("G04")]).tolist() == list(range(13, 39))
    assert np.flatnonzero(absent[:, names.index("G05")]).tolist() == [25]
    assert absent.sum() == 2 + 26 + 1
    # Beside the gaps polynomials take epochs of one side only, as at the ends of the file.
    truth = NOMINAL.positions_ecef(times)
    assert np.nanmax(np.linalg.norm(positions - truth, axis=-1)) < 25e-3
    # What is known in the middle of the interval is known in a tick, and the other way round.
    ned = tick_positions(orbits_at(ephemeris, Site(), FIRST), 900 * np.arange(39) + 450, 0.0)
    np.testing.assert_array_equal(np.isnan(ned).any(axis=-1), absent)
    np.testing.assert_array_equal(np.isnan(ned).all(axis=-1), absent)


def test_gaps_are_warned_of_where_the_run_meets_them(write: Any) -> None:
    ephemeris = gappy(write)
    assert warned(ephemeris, FIRST + 3 * 900.0, 900.0) == []
    late = line_of(sp3_text(epochs=40), "*", 14)
    (lost,) = warned(ephemeris, FIRST + 14.2 * 900.0, 900.0)
    assert lost.startswith(f"{ephemeris.file}: not available during all of the run: G04 (")
    assert f"G04 has no position at 26 of 40 epochs, first 2010-08-31 18:30:00 GPS, line {late}" in lost
    (lost,) = warned(ephemeris, FIRST + 15 * 900.0, 15 * 900.0)
    assert "all of the run: G03, G04, G05 (" in lost
    assert "G05 has a manoeuvre before 1 of 40 epochs" in ephemeris.data.gaps["G05"]


def test_a_file_cut_off_warns_and_is_named_where_the_run_lies_beyond_the_cut(write: Any) -> None:
    ephemeris = Sp3Ephemeris(write(sp3_text().replace("EOF\n", "")))
    (note,) = warned(ephemeris, FIRST + 3600.0, 60.0)
    assert "no EOF line" in note
    with pytest.raises(
        UsageError, match=r"outside the file's span, .* UTC; .*orbits\.sp3: no EOF line; the file may be"
    ):
        ephemeris.at(Site(), FIRST + 20 * 900.0, F32, 60.0)


def test_satellites_that_the_header_lists_in_vain_are_named(write: Any) -> None:
    """G05 has no line at all, G06 no position in any; E01 is of a system that is not asked for."""
    text = sp3_text(names=[*names_of("G"), "E01"])
    lines = [line for line in text.splitlines() if not line.startswith(("PG05", "PE01"))]
    lines = [f"PG06{0:14.6f}{0:14.6f}{0:14.6f}" if line.startswith("PG06") else line for line in lines]
    ephemeris = Sp3Ephemeris(write("\n".join([*lines, ""])))
    lost, unlocated = warned(ephemeris, FIRST + 7200.0, 60.0)
    assert lost.startswith(f"{ephemeris.file}: not available during all of the run: G06 (")
    assert "G06 has no position at 20 of 20 epochs" in lost
    assert unlocated == f"{ephemeris.file}: in the header's list, but without positions: G05"
    assert ephemeris.data.unlocated == ("E01", "G05")


def test_too_few_satellites_for_a_fix_are_warned_of(write: Any) -> None:
    ephemeris = Sp3Ephemeris(write(sp3_text(names=[*names_of("E"), *names_of("G", 3)])))
    (note,) = warned(ephemeris, FIRST + 7200.0, 60.0)
    assert note.endswith(
        "only 3 satellites of systems 'G' have positions during the run or a part of it; a fix needs 4"
    )
    assert warned(Sp3Ephemeris(ephemeris.file, "GE"), FIRST + 7200.0, 60.0) == []


def test_a_warning_points_at_whoever_asked(write: Any) -> None:
    """Not at a line of qrsim, through whatever of it the way went."""
    path = write(sp3_text(names=names_of("G", 3)))
    start = utc_from_gps_seconds(FIRST + 7200.0)
    fleet = {"controller": {"type": "waypoint", "feed": "truth"}, "vehicles": [{"position_ned": [0.0, 0.0, -9.0]}]}
    orbits = {"type": "sp3", "file": path}
    content = {"name": "few", "start_time": start, "world": {"sky": {"orbits": orbits}}, "fleets": {"a": fleet}}
    with pytest.warns(UserWarning, match="only 3 satellites") as caught:
        qrsim.load(content)
    assert [warning.filename for warning in caught] == [__file__]


# Fixes


def nonlinear_fix(satellites: Array, pseudorange: Array, guess: Array) -> Array:
    """Position (3,) by full nonlinear least squares on position and clock, in double precision."""

    def residual(x: Array) -> Array:
        return np.linalg.norm(satellites - x[:3], axis=-1) + x[3] - pseudorange

    def jacobian(x: Array) -> Array:
        ray = x[:3] - satellites
        return np.column_stack([ray / np.linalg.norm(ray, axis=-1, keepdims=True), np.ones(len(ray))])

    x = scipy.optimize.least_squares(residual, np.append(guess, 0.0), jacobian, method="lm").x
    for _ in range(2):  # the library stops at 1e-5 m
        x = x - np.linalg.lstsq(jacobian(x), residual(x))[0]
    return x[:3]


RECEIVERS = np.array([[0.0, 0.0, -10.0], [400.0, -300.0, -60.0], [-1000.0, 1000.0, -120.0]])
MASK = math.radians(10.0)


@jit
def fixes(orbits: Sp3Orbits, seconds: jax.Array, positions: Vec3, errors: jax.Array) -> Any:
    """Fixes (T, n) of noiseless receivers."""
    receiver = cast(GnssReceiver(range_noise_std=0.0), F32)  # type: ignore[arg-type]
    draw = Draw(Key.root(1).stream("gnss", jnp.arange(3, dtype=jnp.uint32)), jnp.uint32(0), jnp.zeros((), F32))

    def one(second: jax.Array, error: jax.Array) -> Any:
        return receiver.fix(draw, positions, SkyState(orbits.positions_ned(second, jnp.float32(0.2)), error))

    return jax.vmap(one)(seconds, errors)


def worst_fix(ephemeris: Sp3Ephemeris, start: float, seconds: Array) -> tuple[float, Array]:
    """Largest distance [m] of the fixes from the nonlinear ones, and the numbers of satellites used (T, 3)."""
    count = len(ephemeris.satellites)
    errors = np.random.default_rng(4).normal(0.0, 4.0, (len(seconds), count)).astype(F32)
    columns = (np.asarray(axis, F32) for axis in RECEIVERS.T)
    found = fixes(orbits_at(ephemeris, Site(), start), jnp.asarray(seconds, jnp.int32), Vec3(*columns), errors)  # type: ignore[arg-type]
    offsets = np.stack(
        [np.asarray(axis, np.float64) for axis in (found.offset_ned.x, found.offset_ned.y, found.offset_ned.z)], -1
    )
    distances, used = np.zeros((len(seconds), 3)), np.zeros((len(seconds), 3), int)
    for i, second in enumerate(seconds):
        satellites = ephemeris.received_ned(Site(), start + second + np.float64(F32(0.2)))
        present = np.isfinite(satellites[:, 0])
        for j, receiver in enumerate(RECEIVERS):
            elevation = elevation_azimuth(satellites - receiver)[0]
            up = present & (np.where(present, elevation, -1.0) > MASK)
            used[i, j] = up.sum()
            ranges = np.linalg.norm(satellites[up] - receiver, axis=-1) + errors[i, up] + 30.0
            expected = nonlinear_fix(satellites[up], ranges, receiver) - receiver
            distances[i, j] = np.linalg.norm(offsets[i, j] - expected)
    np.testing.assert_array_equal(np.asarray(found.satellites), used)
    return float(distances.max()), used


def test_fix_against_nonlinear_least_squares(recorded: Sp3Ephemeris) -> None:
    worst, used = worst_fix(recorded, FIRST + 0.5, np.arange(60, 17000, 1003))
    # 1 mm is allowed; single precision leaves some 1e-5 m.
    assert worst < 1e-4
    assert used.min() >= 7


def test_satellites_in_a_gap_are_left_out_of_the_fix(write: Any) -> None:
    ephemeris = gappy(write)
    worst, used = worst_fix(ephemeris, FIRST + 0.5, np.array([19, 20, 25]) * 900 + 400)
    assert worst < 1e-4
    assert used.min() >= 4


def test_visible_satellites(recorded: Sp3Ephemeris) -> None:
    """7 to 10 above 10 degrees over the file."""
    times = FIRST + np.arange(0.0, 17101.0, 60.0)
    elevation = elevation_azimuth(recorded.received_ned(Site(), times))[0]
    counts = (elevation > MASK).sum(axis=-1)
    assert (counts.min(), counts.max()) == (7, 10)
