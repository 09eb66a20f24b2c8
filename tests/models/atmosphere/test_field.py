"""One field of turbulence: its waves against closed forms, and the component against its waves in double precision."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from tests.models.atmosphere import field_reference as field

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.contracts import CONVECTION_HEIGHT
from qrsim.models.atmosphere.field import VON_KARMAN_ENERGY, VON_KARMAN_SCALE, ResidualState
from qrsim.models.atmosphere.field_modes import modes
from qrsim.models.atmosphere.field_waves import whole_turns
from qrsim.studies.validate import hover_gusts

Floats = np.ndarray[Any, Any]
SEPARATIONS = np.geomspace(1.0, 600.0, 40)
# Length [m] and largest error of f and g; the longest is cut at the lowest wavenumber.
LENGTHS = [(15.24, 0.006), (50.0, 0.006), (94.0, 0.006), (275.0, 0.006), (533.4, 0.008)]
COUNT = 200


def places(height: float | None = None, spread: float = 100.0, offset: float = 0.0) -> Floats:
    """Return COUNT places in NED, at a height or at heights from 3 to 120 m; single precision holds them."""
    numbers = np.random.default_rng(3)
    flat = numbers.uniform(-spread, spread, (COUNT, 2)) + offset
    down = -numbers.uniform(3.0, 120.0, COUNT) if height is None else np.full(COUNT, -height)
    return np.column_stack([flat, down]).astype(np.float32).astype(np.float64)


# The set of waves, in closed form.


@pytest.mark.parametrize("chains", [8, 12, 16, 24, 32])
def test_waves_are_across_their_direction_and_as_large_in_both_phases(chains: int) -> None:
    of = modes(chains, 12)
    n = of.directions[None, :, :, None]
    assert of.directions.shape == (4, chains // 2, 3)
    np.testing.assert_allclose(np.linalg.norm(of.directions, axis=-1), 1.0, atol=1e-12)
    for part in (of.cosine, of.sine):
        assert np.abs(np.sum(part * n, axis=-1)).max() < 1e-12
    np.testing.assert_allclose(np.linalg.norm(of.cosine, axis=-1), np.linalg.norm(of.sine, axis=-1), rtol=1e-12)
    assert np.abs(np.sum(of.cosine * of.sine, axis=-1)).max() < 1e-12
    # The mean square of a group's waves is that of its centre.
    np.testing.assert_allclose(np.mean(np.sum(of.cosine**2, axis=-1), axis=2), 1.0, rtol=1e-12)
    # Right-handed or left-handed: k x A is eps times k and -B, from curl v = eps k v.
    eps = of.handedness[:, :, None, None]
    np.testing.assert_allclose(np.cross(n, of.cosine), -eps * of.sine, atol=1e-12)
    for segment in of.directions.reshape(2, chains, 3):
        share = np.linalg.eigvalsh(segment.T @ segment / chains)
        # A third each; a few chains cannot be spread as evenly.
        low, high = (0.30, 0.37) if chains >= 16 else (0.28, 0.40)
        assert low < share.min() <= share.max() < high


def test_wavenumbers_run_from_half_of_one_over_1750_ft_in_even_steps() -> None:
    of = modes(16, 12)
    first = of.first.ravel() / (0.5 / 533.4)
    np.testing.assert_allclose(first[:16], 2.0 ** ((np.arange(16) + 0.5) / 16.0), rtol=1e-12)
    np.testing.assert_allclose(first[16:], 2.0 ** (6.0 + (np.arange(16) + 0.5) / 16.0), rtol=1e-12)
    centre = of.centre[:, :, 0] / (0.5 / 533.4)
    np.testing.assert_allclose(centre[3], 2.0 ** np.array([3.25, 3.75, 9.25, 9.75]), rtol=1e-12)
    assert 2.0 * math.pi / of.highest == pytest.approx(1.6365, rel=1e-3)
    # An odd number: the last octave of the second segment has no weight.
    assert (modes(16, 11).centre[5, :, 0] > 0.0).tolist() == [True, True, False, False]
    assert modes(16, 11).highest == pytest.approx(0.5 / 533.4 * 2.0**11)


@pytest.mark.parametrize("spectrum", ["dryden", "von_karman"])
@pytest.mark.parametrize(("length", "most"), LENGTHS)
def test_mean_over_worlds_has_the_correlations_of_isotropic_turbulence(
    length: float, most: float, spectrum: str
) -> None:
    k, share = field.shells(length, spectrum=spectrum)
    # The longer tails of von Karman's form at both ends are cut off.
    most = most if spectrum == "dryden" else most + 0.006
    f, g = field.shell_along(k, share, SEPARATIONS), field.shell_across(k, share, SEPARATIONS)
    assert np.abs(f - field.along(SEPARATIONS, length, spectrum)).max() < most
    assert np.abs(g - field.across(SEPARATIONS, length, spectrum)).max() < most


def test_variance_kept_is_the_integral_of_the_spectrum_over_the_waves() -> None:
    for height, kept_h, kept_w in [(3, 0.981, 0.860), (5, 0.988, 0.914), (10, 0.994, 0.957), (30, 0.997, 0.986)]:
        of = field.mil(float(height))
        for length, kept in ((of.length_h, kept_h), (of.length_w, kept_w)):
            _, share = field.shells(float(length))
            assert np.mean(np.sum(share, axis=1)) == pytest.approx(kept, abs=0.003)


@pytest.mark.parametrize("spectrum", ["dryden", "von_karman"])
@pytest.mark.parametrize("length", [15.24, 94.0, 533.4])
def test_mean_over_worlds_has_the_spectra_of_the_standard(length: float, spectrum: str) -> None:
    """Along a line, at wavelengths from 8 m: of each 10 and 5 %, of the means of octaves from 16 m 3 %."""
    k, share = field.shells(length, spectrum=spectrum, dilations=32)
    wavelength = np.geomspace(8.0, 512.0, 6 * 40 + 1)
    o = 2.0 * math.pi / wavelength
    found = field.shell_spectra(k, share, o)
    wanted = field.spectrum_along(o, length, spectrum), field.spectrum_across(o, length, spectrum)
    for got, want, most in zip(found, wanted, (0.10, 0.05), strict=True):
        # Von Karman's tail is longer, so more of it is missing.
        assert np.abs(got / want - 1.0).max() < (most if spectrum == "dryden" else most + 0.04)
        octaves = (got / want)[:-1].reshape(6, 40).mean(axis=1)
        assert np.abs(octaves[1:] - 1.0).max() < 0.03


def test_closed_forms_agree_with_each_other() -> None:
    """E(k) integrates to 3/2, f is its transform, and the spectra along a line its projections."""
    k = np.geomspace(1e-6, 1e3, 200_001)
    for spectrum in ("dryden", "von_karman"):
        e = field.energy(k, 20.0, spectrum)
        tail = 0.0 if spectrum == "dryden" else 1.4527 * (1e3 * 20.0 * 1.339) ** (-2 / 3)
        assert np.trapezoid(e, k) / 1.5 + tail == pytest.approx(1.0, abs=1e-4)
        far = k > 0.05
        along = np.trapezoid((e / k * (1.0 - (0.05 / k) ** 2))[far], k[far])
        assert along == pytest.approx(float(field.spectrum_along(0.05, 20.0, spectrum)), rel=2e-3)
        across = np.trapezoid((e / (2.0 * k) * (1.0 + (0.05 / k) ** 2))[far], k[far])
        assert across == pytest.approx(float(field.spectrum_across(0.05, 20.0, spectrum)), rel=2e-3)
    assert pytest.approx(1.339, abs=1e-4) == VON_KARMAN_SCALE
    # IEC 61400-1, annex B: E(k) = 1.453 s^2 l (k l)^4/(1 + (k l)^2)^(17/6).
    assert pytest.approx(1.453, abs=5e-4) == VON_KARMAN_ENERGY


# What a world draws.


def test_a_world_turns_mirrors_dilates_and_shifts_the_waves_at_random() -> None:
    drawn = field.draws(field.component())
    turned = np.array([[row.x, row.y, row.z] for row in drawn.turned]).transpose(2, 0, 1)
    np.testing.assert_allclose(turned @ turned.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (400, 3, 3)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(turned), drawn.handedness, atol=1e-6)
    # Each test at 99.99 %: coins, cosines of a uniform direction, phases and the logarithm of the dilation.
    assert scipy.stats.binomtest(int(np.sum(np.asarray(drawn.handedness) > 0.0)), 400).pvalue > 1e-4
    for entry in np.abs(turned).reshape(400, 9).T:
        assert scipy.stats.kstest(entry, "uniform").pvalue > 1e-4
    phases = np.asarray(drawn.phase) / 2.0**32
    assert scipy.stats.kstest(phases.ravel(), "uniform").pvalue > 1e-4
    assert np.abs(np.corrcoef(phases.T) - np.eye(32)).max() < 0.25
    dilation = np.asarray(drawn.dilation, float)
    assert scipy.stats.kstest(16.0 * np.log2(dilation), "uniform").pvalue > 1e-4


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.long)])
def test_frequencies_carry_each_chain_with_the_mean_wind(precision: str) -> None:
    """w = d k (n.(Q U) + sweep q)/(2 pi); the mean wind at 20 m, or 20 ft, from MIL-F-8785C's logarithm."""
    direction = -np.array([math.cos(0.7), math.sin(0.7), 0.0])
    speed = 8.0 * math.log(20.0 / 0.3048 / 0.15) / math.log(20.0 / 0.15)
    assert CONVECTION_HEIGHT == 20.0
    cases: list[tuple[dict[str, Any], Any]] = [
        ({}, speed * direction),
        ({"convection_height": 6.096}, 8.0 * direction),
        ({"convection_ned": [50.0, -20.0]}, np.array([50.0, -20.0, 0.0])),
    ]
    for settings, velocity in cases:
        with jax.enable_x64(precision == "float64"):
            turbulence = field.component(precision, **settings)
            drawn = field.draw(turbulence, dtype=precision)
            of = field.waves(turbulence, drawn)
            expected = of.k[:32] @ velocity / (2.0 * math.pi)
            tolerance = 1e-12 if precision == "float64" else 2e-6
            np.testing.assert_allclose(of.frequency[:32], expected, atol=tolerance)
            whole = np.round(of.frequency[:32] * 2.0**32).astype(np.int64) % 2**32
            np.testing.assert_array_equal(np.asarray(drawn.advance), whole)


def test_sweep_moves_each_chain_by_a_normal_speed() -> None:
    still, swept = field.component(convection_ned=[0.0, 0.0]), field.component(convection_ned=[0.0, 0.0], sweep=2.0)
    assert not np.any(field.draw(still).frequency)
    drawn = field.draws(swept)
    k = modes(16, 12).first.ravel() * np.asarray(drawn.dilation, float)[:, None]
    speeds = 2.0 * math.pi * np.asarray(drawn.frequency) / k
    assert scipy.stats.kstest(speeds.ravel() / 2.0, "norm").pvalue > 1e-4


def test_whole_turns_are_exact_where_single_precision_can_be() -> None:
    given = np.array([0.0, 0.5, -0.5, 1.0, 1.75, -0.25, -3.4999, 1e-9, 0.49999997], np.float32)
    expected = [round(float(x) * 2**32) % 2**32 for x in given.astype(np.float64)]
    assert np.asarray(whole_turns(jnp.asarray(given))).tolist() == expected


# The component against its waves; all of one structure, which is compiled once.

CARRIED = {"convection_ned": [-5.0, 4.0]}


@pytest.mark.parametrize(
    ("settings", "offset", "most"),
    [
        ({}, 0.0, 1e-4),
        ({}, 1e4, 3e-3),
        pytest.param({"spectrum": "von_karman"}, 0.0, 1e-4, marks=pytest.mark.long),
        # A last octave that one segment has and the other has not.
        pytest.param({"octaves": 11, "chains": 12}, 0.0, 1e-4, marks=pytest.mark.long),
        pytest.param({"octaves": 9, "spectrum": "von_karman"}, 0.0, 1e-4, marks=pytest.mark.long),
    ],
)
def test_single_precision_is_the_sum_of_the_waves_at_any_time(
    settings: dict[str, Any], offset: float, most: float
) -> None:
    turbulence = field.component(sweep=0.3, **CARRIED, **settings)
    drawn, at = field.draw(turbulence), places(offset=offset)
    for seconds in (0, 1_000_000, 2_000_000_000):
        found, _ = field.gust(turbulence, drawn, at, seconds, 0.5)
        exact, _ = field.reference(turbulence, drawn, at, seconds, 0.5)
        assert np.abs(found - exact).max() < most
    assert 0.5 < exact.std() < 1.5


def test_nothing_jumps_at_a_whole_second() -> None:
    turbulence = field.component(convection_ned=[50.0, -30.0])
    drawn, at = field.draw(turbulence), places()
    before, _ = field.gust(turbulence, drawn, at, 7, 0.9999999)
    after, _ = field.gust(turbulence, drawn, at, 8, 0.0)
    assert np.abs(after - before).max() < 1e-4


def test_a_gust_is_of_its_place_alone() -> None:
    """To the bit, in any order of the vehicles and whoever else is there."""
    turbulence = field.component(**CARRIED)
    drawn, at = field.draw(turbulence), places()
    order = np.random.default_rng(1).permutation(COUNT)
    for part, turned in zip(field.gust(turbulence, drawn, at), field.gust(turbulence, drawn, at[order]), strict=True):
        np.testing.assert_array_equal(part[order], turned)


def test_rates_are_half_the_curl() -> None:
    """Against the exact curl of the waves: p, q and r of the right sign and size, closest where it is isotropic."""
    turbulence = field.component(**CARRIED)
    for height, least in ((5.0, 0.95), (15.0, 0.97), (700.0, 0.99)):
        found, exact = [], []
        for world in range(6):
            drawn, at = field.draw(turbulence, world=world), places(height, spread=3000.0)
            found.append(field.gust(turbulence, drawn, at)[1])
            exact.append(field.half_curl(field.reference(turbulence, drawn, at)[1]))
        for got, want in zip(np.concatenate(found).T, np.concatenate(exact).T, strict=True):
            assert np.corrcoef(got, want)[0, 1] > least
            assert got.std() == pytest.approx(want.std(), rel=0.08)


def test_the_waves_have_no_divergence_where_the_air_is_isotropic() -> None:
    turbulence = field.component(**CARRIED)
    drawn = field.draw(turbulence)
    for height, most in ((5.0, 0.13), (15.0, 0.11), (60.0, 0.08), (700.0, 1e-6)):
        _, slope = field.reference(turbulence, drawn, places(height, spread=3000.0))
        divergence = np.sqrt(np.mean(np.trace(slope, axis1=1, axis2=2) ** 2) / np.mean(np.sum(slope**2, axis=(1, 2))))
        assert divergence < most
        assert divergence > 0.02 or height > 600.0


@pytest.mark.long
def test_double_precision_is_carried_and_has_no_divergence() -> None:
    """Taylor's hypothesis with the rounded frequencies, and the divergence by differences of the component itself."""
    with jax.enable_x64(True):
        turbulence = field.component(np.float64, evolution="frozen", convection_ned=[-5.0, 4.0])
        drawn, at = field.draw(turbulence, dtype="float64"), places()
        start, _ = field.gust(turbulence, drawn, at)
        for seconds, most in ((1, 1e-6), (100, 1e-4), (10_000, 1e-3)):
            moved, _ = field.gust(turbulence, drawn, at + np.array([-5.0, 4.0, 0.0]) * seconds, seconds)
            assert np.abs(moved - start).max() < most
        # Above 80 000 ft lengths and intensities are the same at all heights; a lower severity has no gusts there.
        turbulence = field.component(np.float64, severity=7, **CARRIED)
        high, step = places(25_000.0, spread=2000.0), 1e-4

        def aside(way: Floats) -> Floats:
            return np.asarray(field.gust(turbulence, drawn, high + way)[0])

        slopes = [(aside(step * axis) - aside(-step * axis)) / (2.0 * step) for axis in np.eye(3)]
        slope = np.stack(slopes, axis=-1)
        size = np.sqrt(np.mean(np.sum(slope**2, axis=(1, 2))))
        assert np.abs(np.trace(slope, axis1=1, axis2=2)).max() < 1e-4 * size


@pytest.mark.long
def test_gradients_are_those_of_the_waves_and_finite_below_ground() -> None:
    turbulence = field.component(**CARRIED)
    drawn, at = field.draw(turbulence), places(60.0)[:20]

    def whole(place: Any, fraction: Any) -> Any:
        return field.gust_at(turbulence, drawn, place, jnp.int32(3), fraction)

    @jax.jit
    def slopes(place: Any) -> Any:
        def along(axis: Any) -> Any:
            return jax.jvp(lambda p: whole(p, 0.25)[0], (place,), (jnp.zeros_like(place) + axis[None],))[1]

        of_time = jax.jvp(lambda f: whole(place, f)[0], (jnp.float32(0.25),), (jnp.float32(1.0),))[1]
        return jnp.moveaxis(jax.vmap(along)(jnp.eye(3)), 0, -1), of_time

    of_place, of_time = map(np.asarray, slopes(jnp.asarray(at, jnp.float32)))
    step = 1e-4
    for axis in range(3):
        aside = step * np.eye(3)[axis]
        difference = (
            field.reference(turbulence, drawn, at + aside, 3, 0.25)[0]
            - field.reference(turbulence, drawn, at - aside, 3, 0.25)[0]
        ) / (2.0 * step)
        np.testing.assert_allclose(of_place[:, :, axis], difference, atol=1e-4 * np.abs(difference).max())
    later, earlier = (field.reference(turbulence, drawn, at, 3, 0.25 + s)[0] for s in (step, -step))
    difference = (later - earlier) / (2.0 * step)
    np.testing.assert_allclose(of_time, difference, atol=1e-4 * np.abs(difference).max())
    low = np.column_stack([np.zeros((20, 2)), np.linspace(10.0, -10.0, 20)]).astype(np.float32)
    assert np.isfinite(np.asarray(slopes(jnp.asarray(low))[0])).all()


@pytest.mark.long
def test_other_worlds_and_seeds_have_other_fields() -> None:
    turbulence = field.component(**CARRIED)
    numbers = np.random.default_rng(0)
    at = np.column_stack([numbers.uniform(-1e4, 1e4, (1000, 2)), -numbers.uniform(10.0, 100.0, 1000)])
    drawn = [field.draw(turbulence, world=world) for world in range(20)] + [field.draw(turbulence, seed=6)]
    found = np.array([field.gust(turbulence, each, at)[0] for each in drawn])
    for axis in range(3):
        between = np.corrcoef(found[:, :, axis])[np.triu_indices(21, 1)]
        assert np.sqrt(np.mean(between**2)) < 0.05
        assert np.abs(between).max() < 0.2


@pytest.mark.long
def test_a_hovering_vehicle_meets_the_gusts_that_the_dryden_filter_is_validated_by() -> None:
    """``qrsim validate``'s variances and autocovariances at 10 s in the published wind, over 400 worlds of 120 s.

    Four standard errors, and the variance that the waves leave out: 16/(3 pi k L), k = 3.84/m.
    """
    east, north = math.sin(math.radians(30.0)), math.cos(math.radians(30.0))
    carried = [-hover_gusts.SPEED * north, -hover_gusts.SPEED * east]
    turbulence = field.component(speed_20ft=hover_gusts.SPEED, convection_ned=carried)
    time = np.arange(600) * 0.2
    gust, _ = field.sampled(turbulence, 400, np.tile([0.0, 0.0, -hover_gusts.CASE.height], (600, 1)), time)
    found = hover_gusts.statistics("dryden", gust.swapaxes(0, 1))
    scales = field.mil(hover_gusts.CASE.height)
    for axis, length in (("along", scales.length_h), ("across", scales.length_h), ("down", scales.length_w)):
        missing = 16.0 / (3.0 * math.pi * 3.839 * float(length))
        variance, covariance = found[axis]["variance"], found[axis]["autocovariance_10_s"]
        assert abs(variance["value"] - (1.0 - missing)) < 4.0 * variance["standard_error"] + 0.005
        # At a way of 6.1 m none of it is of the waves that are missing.
        assert abs(covariance["value"] - covariance["expected"]) < 4.0 * covariance["standard_error"] + 0.005
        assert covariance["standard_error"] < 0.06


@pytest.mark.long
def test_the_ground_blocks_vertical_gusts_below_10_ft() -> None:
    """In proportion to the height: 0.164 of those at 10 ft at 0.5 m, half at 1.524 m, none at the ground."""
    turbulence = field.component(chains=8, octaves=8, **CARRIED)
    drawn, whole = field.draw(turbulence), replace(turbulence, near_ground="constant")
    for height, share in ((0.0, 0.0), (0.5, 0.1640420), (1.524, 0.5), (3.048, 1.0), (40.0, 1.0)):
        at = places(height)
        found, every = (field.gust(each, drawn, at, 7, 0.5)[0] for each in (turbulence, whole))
        np.testing.assert_array_equal(found[:, :2], every[:, :2])
        np.testing.assert_allclose(found[:, 2], share * every[:, 2], rtol=1e-5, atol=1e-7)
        assert every[:, 2].std() > 0.05


# The residual.


@pytest.mark.long
def test_residual_has_the_variance_of_what_is_left_out_and_continues_the_tails() -> None:
    """A quarter of a million steps of one vehicle would be needed to see it; the recursion is closed instead."""
    turbulence = field.component(residual="filter", convection_ned=[0.0, 0.0], speed_20ft=8.0)
    drawn = field.draw(turbulence)
    one, zero = jnp.ones(3, jnp.float32), jnp.zeros(3, jnp.float32)
    at, state = jnp.array([[0.0, 0.0, -15.0]] * 3, jnp.float32), ResidualState(Vec3(*jnp.eye(3, dtype=jnp.float32)))
    given = {"seconds": jnp.int32(0), "fraction": jnp.float32(0.0), "field": drawn}
    with_it = turbulence.gust_ned(state, 15.0 * one, Vec3(*at.T), **given).stack()
    without = turbulence.gust_ned(ResidualState(Vec3(zero, zero, zero)), 15.0 * one, Vec3(*at.T), **given).stack()
    of, highest = field.mil(15.0), 0.5 / 533.4 * 2.0**12
    share = [16.0 / (3.0 * math.pi) / (highest * float(length)) for length in (of.length_h, of.length_h, of.length_w)]
    sigma = np.array([of.sigma_h, of.sigma_h, of.sigma_w], float)
    np.testing.assert_allclose(np.asarray(with_it - without), np.diag(sigma * np.sqrt(share)), atol=1e-5)
    # One step of a vehicle that flies north-east through still air, 0.05 m: along, across and down.
    still, velocity = Vec3(zero, zero, zero), Vec3(2.5 / math.sqrt(2.0) * one, 2.5 / math.sqrt(2.0) * one, zero)

    class Silent:
        def normals(self, count: int) -> Any:
            return (zero,) * count

    after = turbulence.step(state, Silent(), 15.0 * one, velocity, still, 0.02)  # type: ignore[arg-type]
    found = np.asarray(after.gust.stack(), float)  # type: ignore[union-attr]
    along, across = (math.exp(-0.05 * highest / length) for length in (1.69765, 1.13177))
    middle, apart = (along + across) / 2.0, (along - across) / 2.0
    np.testing.assert_allclose(found, [[middle, apart, 0.0], [apart, middle, 0.0], [0.0, 0.0, across]], atol=1e-5)
    # Its spectra at high wavenumbers are 2 s^2/(pi L O^2) along and 3 s^2/(pi L O^2) across.
    for length, tail in ((1.69765 / highest, 2.0), (1.13177 / highest, 3.0)):
        level = share[0] * 2.0 / (math.pi * length)
        assert level == pytest.approx(tail / (math.pi * float(of.length_h)), rel=1e-4)
    assert replace(turbulence, residual="none").normals == 0
    assert turbulence.normals == 3
