"""Second-order range errors: exact discretisation, the published recursion, spectra in time, presets."""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from qrsim.core.allan import overlapping_allan_deviation
from qrsim.core.noise import Draw, Drawn, Key
from qrsim.core.tree import cast
from qrsim.models.gnss.errors import BUDGETS, PRESETS, GaussMarkov2, GaussMarkov2State
from qrsim.models.gnss.orbits import NominalConstellation
from qrsim.models.gnss.receivers import SharedSky
from qrsim.models.site import Site

Array = np.ndarray[Any, Any]
F32 = np.float32
# Of the continuous form of gauss_markov_2.
TAU, TAU_DRIVE, DRIVE = 40.1, 4.0, 0.006877
T = 0.2
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False})


discretise = jit(lambda errors, dt: errors.discretise(dt))


def matrices(errors: GaussMarkov2, dt: float, dtype: Any = np.float64) -> tuple[Array, Array]:
    """Transition (2, 2) and noise factor (2, 2) of a step of (error, drive), as the model computes them."""
    with jax.enable_x64(dtype is np.float64):
        by = jax.tree.map(np.float64, discretise(cast(errors, dtype), dtype(dt)))
    return (
        np.array([[by.decay, by.coupling], [0.0, by.drive_decay]]),
        np.array([[by.own, by.shared], [0.0, by.drive_noise]]),
    )


def continuous(tau: float, tau_drive: float) -> tuple[Array, Array]:
    """Drift matrix and noise intensity of the process with unit variances."""
    a, b = 1.0 / tau, 1.0 / tau_drive
    return np.array([[-a, math.sqrt(a * (a + b))], [0.0, -b]]), np.diag([0.0, 2.0 * b])


def discretised(drift: Array, intensity: Array, dt: float) -> tuple[Array, Array]:
    """Transition and noise covariance by the exponential of a block matrix (Van Loan 1978), on halved steps."""
    halvings = max(0, math.ceil(math.log2(2.0 * dt * np.max(np.abs(drift)))))
    block = np.block([[-drift, intensity], [np.zeros((2, 2)), drift.T]]) * (dt / 2**halvings)
    exponential = scipy.linalg.expm(block)
    transition = exponential[2:, 2:].T
    covariance = transition @ exponential[:2, 2:]
    for _ in range(halvings):
        covariance = covariance + transition @ covariance @ transition.T
        transition = transition @ transition
    return transition, covariance


# Steps in units of the time constants: fine, coarse, at the change of formula (4), equal, and the drive slower.
RATIOS = [
    (5e-3, 0.05), (1e-4, 1e-3), (1e-6, 1e-4), (0.025, 0.25), (0.1, 3.9), (0.1, 4.1), (1e-3, 20.0), (0.02, 0.02),
    (0.02, 0.02 * (1.0 + 1e-9)), (0.02, 0.0201), (5.0, 5.0), (5.0, 6.0), (3.0, 40.0), (0.3, 0.001), (8.0, 0.01),
    (30.0, 70.0),
]  # fmt: skip


@pytest.mark.parametrize("ratios", RATIOS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-9), (F32, 1e-5)])
def test_discretisation_against_matrix_exponentials(ratios: tuple[float, float], dtype: Any, tolerance: float) -> None:
    # Numbers as the run's precision has them.
    tau, tau_drive, dt = (float(dtype(number)) for number in (T / ratios[0], T / ratios[1], T))
    transition, factor = matrices(GaussMarkov2(1.0, tau, tau_drive), dt, dtype)  # type: ignore[arg-type]
    expected, covariance = discretised(*continuous(tau, tau_drive), dt)
    # expm leaves 1e-16 of its largest entry.
    np.testing.assert_allclose(transition, expected, rtol=tolerance, atol=1e-15)
    np.testing.assert_allclose(factor @ factor.T, covariance, rtol=tolerance, atol=1e-15)


@pytest.mark.parametrize("dt", [0.005, 0.02, 0.1, 0.2, 1.0, 5.0, 60.0, 1e4])
@pytest.mark.parametrize(("tau", "tau_drive"), [(TAU, TAU_DRIVE), (1100.0, 100.0), (30.0, 30.0), (4.0, 40.1)])
def test_stationary_covariance_by_the_lyapunov_equation(dt: float, tau: float, tau_drive: float) -> None:
    transition, factor = matrices(GaussMarkov2(1.0, tau, tau_drive), dt)  # type: ignore[arg-type]
    found = scipy.linalg.solve_discrete_lyapunov(transition, factor @ factor.T)
    correlation = math.sqrt(tau_drive / (tau + tau_drive))
    np.testing.assert_allclose(found, [[1.0, correlation], [correlation, 1.0]], rtol=1e-8)


def test_two_steps_are_one_of_twice_the_length() -> None:
    for dt in (0.02, 1.0, 9.0):
        transition, factor = matrices(GaussMarkov2(), dt)
        twice, long_factor = matrices(GaussMarkov2(), 2.0 * dt)
        np.testing.assert_allclose(transition @ transition, twice, rtol=1e-12, atol=1e-15)
        covariance = factor @ factor.T
        np.testing.assert_allclose(
            covariance + transition @ covariance @ transition.T, long_factor @ long_factor.T, rtol=1e-10
        )


# Against the published recursion: y' = y exp(-T/4) + 0.003 n, x' = x/1.005 + y

RECURSION = np.array([[1.0 / 1.005, 1.0], [0.0, math.exp(-T / 4.0)]])


def recursion_covariance() -> Array:
    return scipy.linalg.solve_discrete_lyapunov(RECURSION, np.diag([0.0, 0.003**2]))


def recursion_autocovariance(steps: int) -> Array:
    """Autocovariance (steps,) of x at lags of 0, 1, 2, ... steps."""
    covariance, found = recursion_covariance(), []
    for _ in range(steps):
        found.append(covariance[0, 0])
        covariance = RECURSION @ covariance
    return np.array(found)


def correlation_time(lags: Array, autocovariance: Array) -> float:
    """Lag [s] at which the autocovariance has fallen to 1/e."""
    return float(np.interp(-autocovariance[0] / math.e, -autocovariance, lags))


def test_facts_of_the_recursion() -> None:
    """The published numbers: x 0.589 m, y 0.00972, 1/e after about 45 s."""
    assert math.sqrt(recursion_covariance()[0, 0]) == pytest.approx(0.589, abs=5e-4)
    assert math.sqrt(recursion_covariance()[1, 1]) == pytest.approx(0.00972, abs=1e-5)
    lags = T * np.arange(1000)
    assert correlation_time(lags, recursion_autocovariance(1000)) == pytest.approx(44.31, abs=0.01)
    # The continuous form has the same time constants, and the same y with a drive of 0.006877 per root second.
    assert T / math.log(1.005) == pytest.approx(TAU, rel=1e-5)
    assert 0.003 / math.sqrt(-TAU_DRIVE / 2.0 * math.expm1(-2.0 * T / TAU_DRIVE)) == pytest.approx(DRIVE, rel=1e-4)


@pytest.mark.parametrize(("gain", "std"), [(5.0, 0.5873), (5.0131, 0.5888)])
def test_continuous_form_in_metres(gain: float, std: float) -> None:
    """dx = -x/40.1 dt + k y dt, dy = -y/4 dt + 0.006877 dW: the model's process, but for the units of x and y."""
    drift = np.array([[-1.0 / TAU, gain], [0.0, -1.0 / TAU_DRIVE]])
    covariance = scipy.linalg.solve_continuous_lyapunov(drift, -np.diag([0.0, DRIVE**2]))
    assert math.sqrt(covariance[0, 0]) == pytest.approx(std, abs=5e-5)
    assert math.sqrt(covariance[1, 1]) == pytest.approx(0.00972, abs=1e-5)
    scale = np.diag(np.sqrt(np.diag(covariance)))
    in_metres, noise = discretised(drift, np.diag([0.0, DRIVE**2]), T)
    transition, factor = matrices(GaussMarkov2(1.0, TAU, TAU_DRIVE), T)  # type: ignore[arg-type]
    np.testing.assert_allclose(scale @ transition @ np.linalg.inv(scale), in_metres, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(scale @ factor @ factor.T @ scale, noise, rtol=1e-9)


def test_defaults_are_the_recursion() -> None:
    """Its variance within 1e-4, and its autocovariance at every lag within 1e-4 of the variance."""
    lags = T * np.arange(2000)
    ours, published = GaussMarkov2().autocovariance(lags), recursion_autocovariance(2000)
    assert ours[0] == pytest.approx(published[0], rel=1e-4)
    np.testing.assert_allclose(ours, published, rtol=0.0, atol=1e-4 * published[0])
    assert correlation_time(lags, ours) == pytest.approx(44.31, abs=0.01)


# Autocovariance and Allan variance


@pytest.mark.parametrize(("tau", "tau_drive"), [(TAU, TAU_DRIVE), (1100.0, 100.0), (30.0, 30.0), (4.0, 40.1)])
def test_autocovariance_is_that_of_the_steps(tau: float, tau_drive: float) -> None:
    errors = GaussMarkov2(2.5, tau, tau_drive)  # type: ignore[arg-type]
    transition, factor = matrices(errors, T)
    covariance = scipy.linalg.solve_discrete_lyapunov(transition, factor @ factor.T)
    for steps in (0, 1, 10, 100, 1000):
        lagged = 2.5**2 * (np.linalg.matrix_power(transition, steps) @ covariance)[0, 0]
        assert float(errors.autocovariance(T * steps)) == pytest.approx(lagged, rel=1e-7, abs=1e-12)
        assert float(errors.autocovariance(-T * steps)) == pytest.approx(lagged, rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("window", [0.2, 2.0, 15.0, 76.0, 400.0, 5000.0])
@pytest.mark.parametrize(("tau", "tau_drive"), [(TAU, TAU_DRIVE), (30.0, 30.0), (4.0, 40.1)])
def test_allan_variance_against_integrals(window: float, tau: float, tau_drive: float) -> None:
    errors = GaussMarkov2(0.58878, tau, tau_drive)  # type: ignore[arg-type]

    def covariance_of_averages(shift: float) -> float:
        def integrand(t: float) -> float:
            return (1.0 - abs(t) / window) / window * float(errors.autocovariance(t + shift))

        parts = [p for p in (-window, -100.0, -10.0, 0.0, 10.0, 100.0, window) if abs(p) <= window]
        return sum(scipy.integrate.quad(integrand, *piece, epsabs=1e-15, epsrel=1e-12)[0] for piece in pairwise(parts))

    expected = covariance_of_averages(0.0) - covariance_of_averages(window)
    assert float(errors.allan_variance(window)) == pytest.approx(expected, rel=1e-5, abs=1e-12)


def test_allan_variance_of_short_windows_is_that_of_a_smooth_process() -> None:
    """The error has a rate, of variance std^2/(tau_1 tau_2), so averages over short windows differ in proportion."""
    window = 1e-3
    expected = 0.58878**2 / (TAU * TAU_DRIVE) * window**2 / 2.0
    assert float(GaussMarkov2().allan_variance(window)) == pytest.approx(expected, rel=1e-3)


# The process itself

PROCESSES, STEPS = 2048, 2000


@jit
def simulated(errors: GaussMarkov2) -> jax.Array:
    """Range errors (STEPS + 1, PROCESSES) [m] at steps of T."""
    ids = jnp.arange(PROCESSES, dtype=jnp.uint32)
    key = Key.root(20140914)
    begin, source = key.stream("start", ids), key.stream("sky", ids)

    def at(stream: Any, tick: jax.Array) -> Draw:
        return Draw(stream, tick, jnp.zeros((), F32))

    def tick(state: GaussMarkov2State, now: jax.Array) -> tuple[GaussMarkov2State, jax.Array]:
        state = errors.step(state, at(source, now), T)
        return state, errors.value(state)

    first = errors.init(at(begin, jnp.uint32(0)))
    rest = jax.lax.scan(tick, first, jnp.arange(1, STEPS + 1, dtype=jnp.uint32))[1]
    return jnp.concatenate([errors.value(first)[None], rest])


@pytest.fixture(scope="module")
def paths() -> Array:
    """Paths of the default errors, in single precision, 400 s long."""
    return np.asarray(simulated(cast(GaussMarkov2(), F32)), np.float64)


# Standard errors that none of so many independent statistics exceeds with 99.9 % confidence (Bonferroni).
def z_limit(statistics: int) -> float:
    return NormalDist().inv_cdf(1.0 - 0.0005 / statistics)


def test_variance_from_the_first_epoch_on(paths: Array) -> None:
    """At each of five epochs the mean square over 2048 processes is chi-squared; 99.9 % band over all five."""
    low, high = scipy.stats.chi2.ppf([0.0005 / 5, 1.0 - 0.0005 / 5], PROCESSES) / PROCESSES
    for epoch in (0, 1, 20, 300, STEPS):
        assert low < np.mean(paths[epoch] ** 2) / 0.58878**2 < high


def test_autocovariance_of_the_paths(paths: Array) -> None:
    """At seven lags; one estimate per process gives the standard error, and 99.9 % holds over all."""
    lags = np.array([1, 5, 20, 50, 221, 500, 1000])
    for lag in lags:
        estimates = np.mean(paths[lag:] * paths[:-lag], axis=0)
        error = np.std(estimates, ddof=1) / math.sqrt(PROCESSES)
        assert abs(np.mean(estimates) - float(GaussMarkov2().autocovariance(T * lag))) < z_limit(len(lags)) * error


def test_allan_deviation_of_the_paths(paths: Array) -> None:
    """At eight windows from 1 s to 200 s; 99.9 % over all. Sums of samples stand for averages: 0.1 % at 1 s."""
    lengths = np.array([5, 10, 25, 50, 100, 250, 500, 1000])
    windows, deviations = overlapping_allan_deviation(paths, T, lengths)
    expected = GaussMarkov2().allan_variance(windows)
    for estimates, variance in zip(deviations**2, expected, strict=True):
        error = np.std(estimates, ddof=1) / math.sqrt(PROCESSES)
        assert abs(np.mean(estimates) - variance) < z_limit(len(lengths)) * error + 2e-3 * variance


def test_start_is_stationary_together_with_its_drive() -> None:
    """Of the two normals, by unit vectors: the factor of the stationary covariance."""
    errors = cast(GaussMarkov2(), F32)
    normals = (jnp.array([1.0, 0.0], F32), jnp.array([0.0, 1.0], F32))
    state = errors.init(Drawn(normals))
    factor = np.stack([np.asarray(state.error, np.float64), np.asarray(state.drive, np.float64)])
    correlation = math.sqrt(TAU_DRIVE / (TAU + TAU_DRIVE))
    np.testing.assert_allclose(factor @ factor.T, [[1.0, correlation], [correlation, 1.0]], atol=1e-6)


# Laws


def test_gradients_are_finite() -> None:
    normals = tuple(jnp.asarray(row, F32) for row in np.random.default_rng(3).standard_normal((2, 5)))
    state = GaussMarkov2State(*(jnp.asarray(row, F32) for row in np.random.default_rng(4).standard_normal((2, 5))))
    gradient_of = jit(jax.grad(lambda errors: jnp.sum(errors.value(errors.step(state, Drawn(normals), T)))))
    for tau_drive in (4.0, 40.1, 0.01, 1e4):
        gradient = gradient_of(cast(GaussMarkov2(drive_time_constant=tau_drive), F32))  # type: ignore[arg-type]
        assert np.isfinite(jax.tree.leaves(gradient)).all()


def test_parameters_are_leaves() -> None:
    """A sweep is a vmap, and single is batched."""
    stds, taus = jnp.array([0.0, 0.5, 5.0], F32), jnp.array([20.0, 40.1, 1100.0], F32)
    batch = GaussMarkov2(stds, taus, jnp.full(3, 4.0, F32))
    normals = tuple(jnp.asarray(row, F32) for row in np.random.default_rng(5).standard_normal((2, 7)))

    def run(errors: GaussMarkov2) -> jax.Array:
        return errors.value(errors.step(errors.init(Drawn(normals)), Drawn(normals), T))

    together = np.asarray(jit(jax.vmap(run))(batch))
    single = jit(run)
    assert together.shape == (3, 7)
    assert not together[0].any()
    for i in range(3):
        alone = single(jax.tree.map(lambda leaf: leaf[i], batch))  # noqa: B023
        np.testing.assert_allclose(together[i], alone, rtol=1e-5)


def test_in_a_sky() -> None:
    orbits = NominalConstellation().at(Site(), 1e9, F32)
    errors = cast(GaussMarkov2(), F32)
    ids = jnp.arange(24, dtype=jnp.uint32)
    sky = SharedSky(orbits, errors, ids)
    draw = Draw(Key.root(1).stream("/sky", ids), jnp.uint32(3), jnp.zeros((), F32))
    state = jit(sky.init)(draw)
    after = jit(lambda s: sky.step(s, draw, jnp.int32(0), jnp.float32(0.2)))(state)
    assert state.range_error.shape == after.range_error.shape == (24,)
    # Smooth: the rate has a standard deviation of 0.58878/sqrt(40.1 * 4) = 0.046 m/s.
    assert np.abs(np.asarray(after.range_error - state.range_error)).max() < 0.2 * 0.046 * 5.0


# Presets


def test_budgets_add_up_to_the_totals_of_their_document() -> None:
    """Tables 33 and 34 print the totals at 5 and at 90 degrees."""
    for name, totals in (("consumer", (6.24, 3.17)), ("survey", (1.59, 0.72))):
        squares = np.square(np.array(list(BUDGETS[name].values())))
        np.testing.assert_allclose(np.sqrt(squares.sum(axis=0)), totals, atol=0.0051)
        expected = math.sqrt(np.mean(np.square(totals)))
        assert PRESETS[name]["std"] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_what_a_scenario_says(name: str) -> None:
    from qrsim.scenarios.schema import SkySpec

    spec = SkySpec.model_validate({"errors": PRESETS[name]})
    assert spec.errors.type == "gauss_markov_2"
    assert spec.errors.std == PRESETS[name]["std"]
    assert {"consumer": 4.95, "survey": 1.23}[name] == spec.errors.std


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_also_a_type_of_its_own(name: str) -> None:
    from qrsim.scenarios.schema import SkySpec

    spec = SkySpec.model_validate({"errors": {"type": name}}).errors
    same = SkySpec.model_validate({"errors": PRESETS[name]}).errors
    assert spec.model_dump(exclude={"type"}) == same.model_dump(exclude={"type"})
