"""Full Dryden turbulence: the step's matrices against matrix exponentials, and what they imply against MIL-F-8785C.

The component's step is linear, so its matrices are read off it by feeding it unit states and unit normals.
"""

from __future__ import annotations

import decimal
import itertools
import math
from decimal import Decimal
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from qrsim.core.noise import Draw, Drawn, Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere import dryden
from qrsim.models.atmosphere.dryden import Dryden, DrydenState, FilterState, dryden_scales, severity_sigma
from qrsim.models.atmosphere.turbulence import low_altitude_scales

Array = np.ndarray[Any, Any]
FOOT = 0.3048
# In the run's wind axes NED is (along, across, down).
WIND_FROM = math.pi
# The lowest of HEIGHTS is below 10 ft, where the standard ends.
TURBULENCE = Dryden(speed_20ft=8.0, wind_from_rad=WIND_FROM, span=2.0, near_ground="constant")  # type: ignore[arg-type]
# As simulation.py compiles.
FAST_COMPILE = {"xla_cpu_use_fusion_emitters": False}
# From the lowest height of the model to above 2000 ft.
HEIGHTS = (3.0, 15.0, 80.0, 450.0, 1500.0)
AIRSPEEDS = (2.0, 10.0, 30.0)
STEPS = (0.005, 0.02, 0.1)
# pi times the squared gain of H_p over twice its lag, MIL-F-8785C, with b = L_w = sigma_w = 1.
SIGMA_P = math.sqrt(math.pi * 0.8 * (math.pi / 4.0) ** (1.0 / 3.0) / (2.0 * 4.0 / math.pi))


class System(NamedTuple):
    """x <- transition x + noise n, (u, v, w, p, q, r) = output x; the state is (8,), in the state's order."""

    transition: Array
    noise: Array
    output: Array


def vec(x: Any, y: Any, z: Any) -> Vec3:
    return Vec3(jnp.asarray(x), jnp.asarray(y), jnp.asarray(z))


@jax.jit
def respond(turbulence: Dryden, height: Any, airspeed: Any, dt: Any) -> tuple[Any, Any]:
    """States (8, 16) a step after unit states (8 vehicles) and unit normals (8 more); outputs (6, 16) before it."""
    states, normals = jnp.eye(8, 16), jnp.eye(8, 16, k=8)
    state = DrydenState(states[0], FilterState(*states[1:4]), FilterState(*states[4:7]), states[7])
    zero = jnp.zeros(16)
    velocity, high = vec(airspeed + zero, zero, zero), height + zero
    after = turbulence.step(state, Drawn(tuple(normals)), high, velocity, vec(zero, zero, zero), dt)
    gust, rates = turbulence.gust_ned(state, high), turbulence.gust_rates_ned(state, high)
    return jnp.stack(jax.tree.leaves(after)), jnp.stack([gust.x, gust.y, gust.z, rates.x, rates.y, rates.z])


def system(turbulence: Dryden, height: float, airspeed: float, dt: float) -> System:
    """Read the matrices off the component, in double precision."""
    with jax.enable_x64(True):
        numbers = (np.float64(number) for number in (height, airspeed, dt))
        moved, output = map(np.asarray, respond(cast(turbulence, np.float64), *numbers))
    return System(moved[:, :8], moved[:, 8:], output[:, :8])


class Scales(NamedTuple):
    """Lengths [m] of u, v, w, their standard deviations and those of p [m/s, rad/s], worked out in NumPy."""

    length: Array
    sigma: Array
    sigma_p: float


def scales(height: float, speed_20ft: float = 8.0, span: float = 2.0) -> Scales:
    """Lengths and intensities of MIL-F-8785C; severity 3."""
    feet = max(height / FOOT, 10.0)
    low = min(feet, 1000.0)
    share = min(max(feet / 1000.0 - 1.0, 0.0), 1.0)
    shape = 0.177 + 0.000823 * low
    horizontal, sigma_w = low / shape**1.2, 0.1 * speed_20ft
    high = np.interp(feet, dryden.TABLE_FT, dryden.SEVERITY_TABLE_FT_S[3]) * FOOT
    length = (1.0 - share) * np.array([horizontal, horizontal, low]) + share * 1750.0
    sigma = (1.0 - share) * sigma_w * np.array([shape**-0.4, shape**-0.4, 1.0]) + share * high
    length = length * FOOT
    return Scales(length, sigma, SIGMA_P * sigma[2] / (span**2 * length[2]) ** (1.0 / 3.0))


def spectra(height: float, airspeed: float, omega: Array, span: float = 2.0) -> Array:
    """Two-sided densities S(omega) of (u, v, w, p, q, r), (6, ...): the integral of S/(2 pi) is the variance."""
    of = scales(height, span=span)
    tau = (of.length / airspeed).reshape(3, *([1] * omega.ndim))
    variance = np.square(of.sigma).reshape(tau.shape)
    square = np.square(omega * tau)
    first = 2.0 * variance * tau / (1.0 + square)
    second = variance * tau * (1.0 + 3.0 * square) / np.square(1.0 + square)
    lag_q, lag_r = 4.0 * span / (math.pi * airspeed), 3.0 * span / (math.pi * airspeed)
    roll = 2.0 * of.sigma_p**2 * lag_q / (1.0 + np.square(omega * lag_q))
    pitch = np.square(omega / airspeed) / (1.0 + np.square(omega * lag_q)) * second[2]
    yaw = np.square(omega / airspeed) / (1.0 + np.square(omega * lag_r)) * second[1]
    return np.stack([first[0], second[1], second[2], roll, pitch, yaw])


def aliased(height: float, airspeed: float, omega: Array, dt: float) -> Array:
    """Densities (6, k) of samples every dt: the sum over the aliases, the far ones by their integral."""
    images, folded = 2000, 2.0 * math.pi / dt
    shifts = folded * np.arange(-images, images + 1)
    total = np.sum(spectra(height, airspeed, omega[:, None] + shifts), axis=-1)
    # Beyond, S falls as omega^-2.
    edge = folded * (images + 0.5)
    return np.asarray(total + 2.0 * spectra(height, airspeed, np.array([edge])) * edge / folded)


def discrete_spectrum(of: System, omega: Array, dt: float) -> Array:
    """Densities (6, k) of the state-space system's outputs, from its transfer function."""
    shifted = np.exp(1j * omega * dt)[:, None, None] * np.eye(8) - of.transition
    response = of.output @ np.linalg.solve(shifted, np.broadcast_to(of.noise.astype(complex), shifted.shape))
    return np.asarray(dt * np.sum(np.square(np.abs(response)), axis=-1).T)


def decibel(ratio: Array) -> Array:
    return np.asarray(10.0 * np.log10(ratio))


# Numbers that float32 holds: step in units of tau, and tau over the lag of the span, about the double pole at 1 too.
X = np.logspace(-7, math.log10(50.0), 30).astype(np.float32).astype(np.float64)
RATIOS = (0.0625, 0.5773503184318542, 0.9990234375, 1.0, 1.0001220703125, 4.0, 40.0, 1000.0)
X_GRID, RATIO_GRID = (part.ravel() for part in np.meshgrid(X, RATIOS))


def continuous(ratio: Array) -> tuple[Array, Array]:
    """Matrices (k, 3, 3) and (k, 3) of dz = A z dt + b dW for ratios (k,), as the module states them."""
    root, one, zero = np.sqrt(ratio), np.ones_like(ratio), np.zeros_like(ratio)
    rows = [[-one, zero, zero], [-2.0 * one, -one, zero], [-2.0 * root, -2.0 * root, -ratio]]
    a: Array = np.moveaxis(np.array(rows), -1, 0)
    return a, np.sqrt(2.0) * np.stack([one, one, root], axis=1)


def filter_matrices(x: Array, ratio: Array, precision: str) -> tuple[Array, Array]:
    """Transition minus identity and Cholesky factor, (k, 3, 3) each, as the component's formulas give them."""
    with jax.enable_x64(precision == "float64"):
        steps, ratios = jnp.asarray(x, precision), jnp.asarray(ratio, precision)
        of, of_lag = dryden.exponential_decay(steps), dryden.exponential_decay(jnp.asarray(x * ratio, precision))
        two = dryden.second_order(steps, of)
        row = dryden.third_row(steps, ratios, of, of_lag, two)
        zero = jnp.zeros_like(steps)
        change = [[-two.loss, zero, zero], [-two.cross, -two.loss, zero], [row.f1, row.f2, -row.loss]]
        factor = [[two.l11, zero, zero], [two.l21, two.l22, zero], [row.l31, row.l32, row.l33]]
        return tuple(np.moveaxis(np.array(m, np.float64), -1, 0) for m in (change, factor))  # type: ignore[return-value]


@cache
def exact_matrices() -> tuple[Array, Array]:
    """Transition minus identity and noise covariance of z1, z2, z3, (k, 3, 3) each, from matrix exponentials.

    Van Loan's block matrix (1978) grows as exp(+x); where that costs digits, many small steps make the large one.
    """
    a, b = continuous(RATIO_GRID)
    halvings = np.maximum(0, np.ceil(np.log2(X_GRID * np.maximum(1.0, RATIO_GRID) / 0.25))).astype(int)
    block = np.zeros((X_GRID.size, 6, 6))
    block[:, :3, :3], block[:, 3:, 3:] = -a, a.transpose(0, 2, 1)
    block[:, :3, 3:] = b[:, :, None] * b[:, None, :]
    block = scipy.linalg.expm(block * (X_GRID * 0.5**halvings)[:, None, None])
    step = block[:, 3:, 3:].transpose(0, 2, 1)
    covariance = step @ block[:, :3, 3:]
    for done in range(int(halvings.max())):
        going = done < halvings
        covariance[going] += (step @ covariance @ step.transpose(0, 2, 1))[going]
        step = np.where(going[:, None, None], step @ step, step)
    # expm(A x) - I without cancellation: A times the integral of expm, from an augmented matrix.
    augmented = np.zeros((X_GRID.size, 6, 6))
    augmented[:, :3, :3], augmented[:, :3, 3:] = a, np.eye(3)
    integral = scipy.linalg.expm(augmented * X_GRID[:, None, None])[:, :3, 3:]
    return np.asarray(a @ integral), covariance


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-11), ("float32", 3e-6)])
def test_closed_forms_are_the_matrix_exponential(precision: str, tolerance: float) -> None:
    changes, factors = filter_matrices(X_GRID, RATIO_GRID, precision)
    exact, covariances = exact_matrices()
    # Each entry of the change relative to what its row changes by in a step.
    rates = np.stack([np.ones_like(RATIO_GRID), np.ones_like(RATIO_GRID), np.maximum(1.0, RATIO_GRID)], axis=1)
    scale = np.minimum(X_GRID[:, None] * rates, 1.0)[:, :, None]
    np.testing.assert_allclose(changes / scale, exact / scale, rtol=0.0, atol=tolerance)
    size = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    sizes = size[:, :, None] * size[:, None, :]
    found = factors @ factors.transpose(0, 2, 1)
    np.testing.assert_allclose(found / sizes, covariances / sizes, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize(
    ("precision", "tolerance"), [pytest.param("float64", 1e-9, marks=pytest.mark.long), ("float32", 3e-6)]
)
def test_third_noise_keeps_its_digits(precision: str, tolerance: float) -> None:
    """l33 is (r x)^2.5 small: the root of a quotient of Gram determinants, to 100 digits, relative to itself."""
    usual = (X_GRID > 1e-4) & (X_GRID < 0.9) & (X_GRID * RATIO_GRID < 20.0) & (RATIO_GRID >= 4.0)
    _, factors = filter_matrices(X_GRID[usual], RATIO_GRID[usual], precision)
    exact = [third_noise(x, ratio) for x, ratio in zip(X_GRID[usual], RATIO_GRID[usual], strict=True)]
    np.testing.assert_allclose(factors[:, 2, 2] / exact, 1.0, rtol=0.0, atol=tolerance)


def third_noise(x: float, ratio: float) -> float:
    """sqrt(det Q / det Q2) of the noise covariance over a step, as integrals of the three impulse responses."""
    with decimal.localcontext(decimal.Context(prec=100)):
        r = Decimal(ratio)
        # exp(-r s), exp(-s), s exp(-s) span the responses; z3 has sqrt(2 r) ((1 + r)/(1 - r))^2 exp(-r s) of its own.
        poles, powers = (r, Decimal(1), Decimal(1)), (0, 0, 1)

        def moment(rate: Decimal, power: int) -> Decimal:
            """Integral of s^power exp(-rate s) over the step."""
            y, factorial = rate * Decimal(x), Decimal(math.factorial(power))
            tail = sum((y**k / Decimal(math.factorial(k)) for k in range(power + 1)), Decimal(0))
            return factorial / rate ** (power + 1) * (1 - (-y).exp() * tail)

        gram = [
            [moment(p + q, i + j) for q, j in zip(poles, powers, strict=True)]
            for p, i in zip(poles, powers, strict=True)
        ]
        (a, b, c), (_, d, e), (_, _, f) = gram
        small = d * f - e * e
        whole = a * small - b * (b * f - e * c) + c * (b * e - d * c)
        return float((2 * r * ((1 + r) / (1 - r)) ** 4 * whole / small).sqrt())


@pytest.mark.parametrize(
    ("precision", "tolerance"), [pytest.param("float64", 1e-12, marks=pytest.mark.long), ("float32", 2e-6)]
)
def test_cholesky_factor_keeps_its_digits_at_any_step(precision: str, tolerance: float) -> None:
    """l22 is x^1.5 small; 60 digits leave enough after the cancellation that the closed form avoids."""
    _, factors = filter_matrices(X, np.full_like(X, 4.0), precision)
    with decimal.localcontext(decimal.Context(prec=60)):
        for step, factor in zip(X, factors, strict=True):
            exact = Decimal(float(step))
            a = (-exact).exp()
            phi21 = -2 * exact * a
            q11, q21, q22 = 1 - a * a, -phi21 * a, 1 - a * a - phi21 * phi21
            l11 = q11.sqrt()
            expected = [float(l11), float(q21 / l11), float((q22 - q21 * q21 / q11).sqrt())]
            found = [factor[0, 0], factor[1, 0], factor[1, 1]]
            # exp(-2 x) underflows to a number that matters to nobody.
            np.testing.assert_allclose(found, expected, rtol=tolerance, atol=1e-30, err_msg=f"x = {step}")


@pytest.mark.parametrize("dt", STEPS)
def test_lyapunov_variance_is_sigma_squared(dt: float) -> None:
    for height in HEIGHTS:
        for airspeed in AIRSPEEDS:
            of = system(TURBULENCE, height, airspeed, dt)
            stationary = scipy.linalg.solve_discrete_lyapunov(of.transition, of.noise @ of.noise.T)
            variance = np.diag(of.output @ stationary @ of.output.T)
            expected = np.square([*scales(height).sigma, scales(height).sigma_p])
            np.testing.assert_allclose(variance[:4], expected, rtol=1e-6)


@pytest.mark.parametrize("dt", STEPS)
def test_single_precision_settles_at_sigma_squared(dt: float) -> None:
    """The coefficients as float32 rounds them, and what they settle at; float32 resolves 1.2e-7."""
    weights = np.array([math.cos(math.pi / 12.0), math.sin(math.pi / 12.0), 0.0])
    for height in HEIGHTS:
        for length in scales(height).length:
            x = np.array([dt * airspeed / length for airspeed in AIRSPEEDS])
            changes, factors = filter_matrices(x, length * math.pi / (4.0 * 0.6) * np.ones(3), "float32")
            for change, factor in zip(changes, factors, strict=True):
                settled = scipy.linalg.solve_discrete_lyapunov(np.eye(3) + change, factor @ factor.T)
                assert settled[0, 0] == pytest.approx(1.0, abs=1e-6)
                assert weights @ settled @ weights == pytest.approx(1.0, abs=1e-6)
                np.testing.assert_allclose(settled, np.eye(3), rtol=0.0, atol=5e-6)


def test_stationary_covariance_is_the_identity_whatever_height_and_speed_do() -> None:
    """I = Phi I Phi^T + M M^T for every step, so the first draw is stationary and stays so in a climb."""
    generator = np.random.default_rng(5)
    for height, airspeed, dt, span in zip(
        generator.uniform(0.0, 1500.0, 40),
        generator.uniform(0.0, 60.0, 40),
        generator.uniform(0.001, 0.1, 40),
        generator.uniform(0.05, 60.0, 40),
        strict=True,
    ):
        of = system(replace(TURBULENCE, span=span), height, airspeed, dt)
        covariance = of.transition @ of.transition.T + of.noise @ of.noise.T
        np.testing.assert_allclose(covariance, np.eye(8), rtol=0.0, atol=1e-12)


def test_autocorrelation() -> None:
    dt, height, airspeed = 0.02, 15.0, 10.0
    of = system(TURBULENCE, height, airspeed, dt)
    expected = scales(height)
    tau = expected.length / airspeed
    for steps in (0, 1, 5, 20, 100, 400):
        lagged = of.output @ np.linalg.matrix_power(of.transition, steps) @ of.output.T
        t = steps * dt / tau
        shape = np.exp(-t) * np.array([1.0, 1.0 - t[1] / 2.0, 1.0 - t[2] / 2.0])
        np.testing.assert_allclose(np.diag(lagged)[:3], expected.sigma**2 * shape, rtol=0.0, atol=1e-10)
    # Different axes share nothing but what q has of w, and r of v.
    between = of.output @ of.output.T
    np.testing.assert_allclose(between[:4, :4], np.diag(np.diag(between)[:4]), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("height", HEIGHTS)
@pytest.mark.parametrize("airspeed", AIRSPEEDS)
def test_spectrum_is_the_closed_form(height: float, airspeed: float) -> None:
    """Within 1 dB where Omega V T = omega T <= 1; the sampled process has the aliased form at every frequency."""
    dt = 0.02
    omega = np.logspace(-3, 0, 60) * math.pi / dt
    found = discrete_spectrum(system(TURBULENCE, height, airspeed, dt), omega, dt)
    slow = omega * dt <= 1.0
    continuous = spectra(height, airspeed, omega)
    assert np.max(np.abs(decibel(found[:3, slow] / continuous[:3, slow]))) < 1.0
    assert np.max(np.abs(decibel(found / aliased(height, airspeed, omega, dt)))) < 0.01


def test_angular_filters_are_those_of_the_standard() -> None:
    """z3's weights make s/(s + r) H of the gust's H, at complex frequencies s in units of 1/tau."""
    for ratio in RATIOS:
        (a,), (b,) = continuous(np.array([ratio]))
        with jax.enable_x64(True):
            weights = np.array(dryden.rate_weights(jnp.asarray(ratio)))
        for s in (0.1j, 1.0j, 3.0 + 2.0j, 50.0j):
            states = np.linalg.solve(s * np.eye(3) - a, b)
            gust = (1.0 + math.sqrt(3.0) * s) / (1.0 + s) ** 2
            assert math.cos(math.pi / 12.0) * states[0] + math.sin(math.pi / 12.0) * states[1] == pytest.approx(gust)
            assert weights @ states == pytest.approx(s / (s + ratio) * gust)


def test_roll_gust_has_the_standard_deviation_of_its_filter() -> None:
    """White noise of intensity pi through H_p of MIL-F-8785C, integrated numerically; about 0.954 in front."""
    sigma_w, span, length, airspeed = 1.3, 0.6, 20.0, 7.0
    gain = sigma_w * math.sqrt(0.8 / airspeed) * (math.pi / (4.0 * span)) ** (1.0 / 6.0) / length ** (1.0 / 3.0)
    lag = 4.0 * span / (math.pi * airspeed)
    variance, _ = scipy.integrate.quad(lambda w: gain**2 / (1.0 + (lag * w) ** 2), 0.0, np.inf)
    by_hand = sigma_w / (span**2 * length) ** (1.0 / 3.0)
    assert math.sqrt(variance) == pytest.approx(dryden.ROLL_FACTOR * by_hand, rel=1e-9)
    assert pytest.approx(0.954, abs=5e-4) == dryden.ROLL_FACTOR
    of = system(replace(TURBULENCE, span=span), 20.0, airspeed, 0.02)
    assert np.linalg.norm(of.output[3]) == pytest.approx(SIGMA_P * 0.8 / (span**2 * 20.0) ** (1.0 / 3.0), rel=1e-6)


def test_sign_of_the_angular_gusts() -> None:
    """Over a span that is short against a step's way, q goes with the change of w and r against that of v."""
    of = system(replace(TURBULENCE, span=0.01), 80.0, 10.0, 0.02)
    q, r = of.output[4], of.output[5]
    # Covariances with the change over the last step; the stationary covariance is the identity.
    with_w = q @ of.output[2] - q @ of.transition @ of.output[2]
    with_v = r @ of.output[1] - r @ of.transition @ of.output[1]
    assert with_w > 0.0 > with_v


@pytest.mark.parametrize("severity", range(1, 8))
def test_severity_table(severity: int) -> None:
    rows = dryden.SEVERITY_TABLE_FT_S[severity]
    with jax.enable_x64(True):
        at = severity_sigma(jnp.asarray(dryden.TABLE_FT) * FOOT, severity)
        np.testing.assert_allclose(at, np.array(rows) * FOOT, rtol=1e-12, atol=1e-12)
        feet = np.linspace(0.0, 90000.0, 500)
        between = severity_sigma(jnp.asarray(feet * FOOT), severity)
        np.testing.assert_allclose(between, np.interp(feet, dryden.TABLE_FT, rows) * FOOT, atol=1e-11)


def test_severity_table_against_the_standard() -> None:
    """Spot values read from figure 7 of MIL-F-8785C: one per index, at different heights."""
    heights = {1: (1750, 2.2), 2: (7500, 1.6), 3: (3750, 7.4), 4: (55000, 2.7), 5: (80000, 2.1), 6: (15000, 22.1)}
    for severity, (feet, expected) in (heights | {7: (25000, 31.0)}).items():
        sigma = severity_sigma(jnp.array([feet * FOOT], jnp.float32), severity)
        assert float(sigma[0]) == pytest.approx(expected * FOOT, rel=1e-5)


def test_the_ground_blocks_vertical_gusts_below_10_ft() -> None:
    """At 0, 0.5, 1.524 and 3.048 m they are 0, 0.1640, 0.5 and 1 of 0.8 m/s, underground 0; as at 10 ft by option.

    Horizontal gusts have 0.8/0.18523^0.4 m/s down to the ground.
    """
    heights = jnp.array([-2.0, 0.0, 0.5, 1.524, 3.048, 15.0], jnp.float32)
    lengths, sigmas = dryden_scales(heights, jnp.float32(8.0), 3, near_ground="blocked")
    np.testing.assert_allclose(sigmas.z, [0.0, 0.0, 0.1312336, 0.4, 0.8, 0.8], rtol=1e-6)
    np.testing.assert_allclose(sigmas.x[:5], 1.570, rtol=1e-3)
    open_lengths, open_sigmas = dryden_scales(heights, jnp.float32(8.0), 3, near_ground="constant")
    np.testing.assert_allclose(open_sigmas.z, 0.8, rtol=1e-6)
    np.testing.assert_array_equal(lengths.stack(), open_lengths.stack())
    np.testing.assert_array_equal(sigmas.stack()[:, :2], open_sigmas.stack()[:, :2])


def test_a_vehicle_half_a_metre_above_ground_meets_a_sixth_of_the_vertical_gust() -> None:
    """And of the roll and pitch rates of the air, which come from it; the yaw rate comes from horizontal gusts."""
    state = DrydenState(*(jnp.float32([x]) for x in (1.0,)), *(
        FilterState(*(jnp.float32([x]) for x in three)) for three in ((0.5, -0.3, 0.2), (0.7, 0.4, -0.6))
    ), jnp.float32([0.8]))  # fmt: skip
    height = jnp.array([0.5], jnp.float32)
    default = Dryden(speed_20ft=8.0, wind_from_rad=WIND_FROM)  # type: ignore[arg-type]
    constant = replace(default, near_ground="constant")
    for name, share in (("gust_ned", [1.0, 1.0, 0.1640420]), ("gust_rates_ned", [0.1640420, 0.1640420, 1.0])):
        found, whole = (np.ravel(getattr(each, name)(state, height).stack()) for each in (default, constant))
        assert np.abs(whole).min() > 0.01
        np.testing.assert_allclose(found, whole * share, rtol=1e-4)


@pytest.mark.long
def test_low_and_high_altitude_are_blended_without_a_step() -> None:
    with jax.enable_x64(True):
        speed = jnp.asarray(8.0)
        heights = jnp.asarray(np.array([0.0, 3.048, 50.0, 304.79]))
        lengths, sigmas = dryden_scales(heights, speed, 5)
        low_lengths, ratios = low_altitude_scales(heights)
        np.testing.assert_allclose(lengths.stack(), low_lengths.stack())
        np.testing.assert_allclose(sigmas.stack(), 0.8 * ratios.stack())
        for edge in (1000.0, 2000.0):
            around = jnp.asarray((edge + np.array([-1e-6, 1e-6])) * FOOT)
            for pair in jax.tree.leaves(dryden_scales(around, speed, 5)):
                assert abs(float(pair[1] - pair[0])) < 1e-6
        high_lengths, high_sigmas = dryden_scales(jnp.asarray(np.array([1500.0, 2000.0, 7500.0]) * FOOT), speed, 5)
        np.testing.assert_allclose(high_lengths.stack(), np.array([1375.0, 1750.0, 1750.0])[:, None] * [[FOOT] * 3])
        # Halfway at 1500 ft: half of 0.8 m/s and half of 12.76 ft/s, which lies between 11.8 and 13.0.
        expected = [0.4 + 0.5 * 12.76 * FOOT, np.interp(2000.0, [1750.0, 3750.0], [13.0, 16.0]) * FOOT, 15.1 * FOOT]
        np.testing.assert_allclose(high_sigmas.stack(), np.array(expected)[:, None] * [[1.0] * 3], rtol=1e-12)


@partial(jax.jit, static_argnames=("ticks", "keep"), compiler_options=FAST_COMPILE)
def simulate(turbulence: Dryden, height: Any, airspeed: Any, dt: float, ticks: int, keep: int) -> Any:
    """Outputs (keep, 6, n) of the last ticks, in float32."""
    n = height.shape[0]
    ids = jnp.arange(n, dtype=jnp.uint32)
    stream, like, zero = Key.root(20).stream("gust", ids), jnp.zeros((), jnp.float32), jnp.zeros_like(height)
    start = turbulence.init(Draw(Key.root(20).stream("start", ids), jnp.uint32(0), like))

    def tick(state: DrydenState, now: Any) -> tuple[DrydenState, Any]:
        state = turbulence.step(state, Draw(stream, now, like), height, vec(airspeed, zero, zero), vec(*[zero] * 3), dt)
        gust, rates = turbulence.gust_ned(state, height), turbulence.gust_rates_ned(state, height)
        return state, jnp.stack([gust.x, gust.y, gust.z, rates.x, rates.y, rates.z])

    first = jnp.arange(ticks - keep, dtype=jnp.uint32)
    state, _ = jax.lax.scan(lambda s, now: (tick(s, now)[0], None), start, first)
    return jax.lax.scan(tick, state, jnp.arange(ticks - keep, ticks, dtype=jnp.uint32))[1]


@pytest.mark.long
def test_monte_carlo_variance() -> None:
    """Chi-squared over 2048 independent vehicles, in a band of 99 % confidence over all 15 x 6 variances."""
    vehicles, cases = 2048, list(itertools.product(HEIGHTS, AIRSPEEDS))
    tail = 0.005 / (6 * len(cases))
    low, high = scipy.stats.chi2.ppf([tail, 1.0 - tail], vehicles) / vehicles
    height, airspeed = np.repeat(np.array(cases, np.float32), vehicles, axis=0).T
    found = np.asarray(simulate(cast(TURBULENCE, np.float32), height, airspeed, 0.02, 40, 1), np.float64)[0]
    for case, part in zip(cases, np.split(found, len(cases), axis=1), strict=True):
        expected = np.sum(np.square(system(TURBULENCE, *case, 0.02).output), axis=1)
        ratio = np.mean(np.square(part), axis=1) / expected
        assert np.all((ratio > low) & (ratio < high)), (case, ratio, low, high)


@pytest.mark.long
def test_monte_carlo_spectrum() -> None:
    """Welch's estimate over 256 vehicles and 7 half-overlapping segments, within 1 dB of the aliased form.

    In third-octave bands the estimate's standard error is below 0.1 dB; 1 dB is ten of them.
    """
    height, airspeed, dt, segment = 15.0, 10.0, 0.02, 1024
    shape = np.ones(256, np.float32)
    found = simulate(cast(TURBULENCE, np.float32), height * shape, airspeed * shape, dt, 4096, 4096)
    frequency, density = scipy.signal.welch(
        np.asarray(found, np.float64), 1.0 / dt, nperseg=segment, detrend=False, axis=0
    )
    omega, estimate = 2.0 * math.pi * frequency, np.mean(density, axis=-1).T / 2.0
    bands = 2.0 * math.pi * np.array([0.2 * 10.0 ** (0.1 * k) for k in range(21)])
    expected = aliased(height, airspeed, omega[1:], dt)
    for low, high in itertools.pairwise(bands):
        inside = (omega[1:] >= low) & (omega[1:] < high)
        ratio = np.mean(estimate[:, 1:][:, inside], axis=1) / np.mean(expected[:, inside], axis=1)
        assert np.all(np.abs(decibel(ratio)) < 1.0), (low, high, decibel(ratio))


@pytest.mark.long
def test_airspeed_options() -> None:
    def transition(airspeed: str, ground: float, wind: float) -> float:
        with jax.enable_x64(True):
            turbulence = cast(replace(TURBULENCE, airspeed=airspeed), np.float64)
            one, zero = jnp.ones(1), jnp.zeros(1)
            state = DrydenState(one, FilterState(zero, zero, zero), FilterState(zero, zero, zero), zero)
            moved = turbulence.step(
                state, Drawn((zero,) * 8), 20.0 * one, vec(zero, ground * one, zero), vec(zero, wind * one, zero), 0.1
            )
            return float(moved.along[0])

    length = scales(20.0).length[0]
    assert transition("relative", 3.0, -4.0) == pytest.approx(math.exp(-0.7 / length), rel=1e-12)
    assert transition("relative", 2.0, 2.0) == pytest.approx(math.exp(-0.05 / length), rel=1e-12)
    assert transition("ground", 3.0, -4.0) == pytest.approx(math.exp(-0.35 / length), rel=1e-12)


@pytest.mark.long
def test_gradients_are_finite_at_rest_in_still_air() -> None:
    one = jnp.ones(3, jnp.float32)
    draw = Drawn((one,) * 8)

    def total(turbulence: Dryden, velocity: Vec3, height: Any) -> Any:
        state = turbulence.step(turbulence.init(draw), draw, height, velocity, vec(*[0.0 * one] * 3), 0.02)
        gust, rates = turbulence.gust_ned(state, height), turbulence.gust_rates_ned(state, height)
        return jnp.sum(gust.dot(gust) + rates.dot(rates))

    heights = jnp.array([0.0, 20.0, 700.0], jnp.float32)
    slopes = jax.jit(jax.grad(total, argnums=(0, 1, 2)), compiler_options=FAST_COMPILE)(
        cast(TURBULENCE, np.float32), vec(*[0.0 * one] * 3), heights
    )
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(slopes))


def test_gusts_turn_with_the_wind() -> None:
    one, zero = jnp.ones(1, jnp.float32), jnp.zeros(1, jnp.float32)
    state = DrydenState(one, FilterState(zero, zero, zero), FilterState(zero, zero, zero), one)
    west = cast(replace(TURBULENCE, wind_from_rad=1.5 * math.pi), np.float32)
    gust, rates = west.gust_ned(state, 20.0 * one), west.gust_rates_ned(state, 20.0 * one)
    for found in (gust, rates):
        assert abs(float(found.x[0])) < 1e-6 < float(found.y[0])
        assert float(found.z[0]) == pytest.approx(0.0, abs=1e-6)
