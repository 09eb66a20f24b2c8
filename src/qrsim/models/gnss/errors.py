"""GNSS range errors of second order, and presets for ordinary receivers (docs/explanation/models/gnss.md)."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.allan import exponential_allan_variance
from qrsim.core.fastmath import exp
from qrsim.core.noise import Noise
from qrsim.core.tree import parameter, quantity, record
from qrsim.models.gnss.contracts import RangeErrors
from qrsim.models.site import Float64

# Gauss-Legendre nodes and weights on [0, 1].
_LEGENDRE = np.polynomial.legendre.leggauss(12)
_NODES, _WEIGHTS = 0.5 * (_LEGENDRE[0] + 1.0), 0.5 * _LEGENDRE[1]

# Steps of more of the shorter time constants than this are long ones.
_LONG = 4.0

# European GNSS (Galileo) Open Service, Service Definition Document, issue 1.3, November 2023, annex C.4.5.1, "typical
# UERE budgets": one standard deviation of a range [m] at 5 and at 90 degrees of elevation.
BUDGETS: dict[str, dict[str, tuple[float, float]]] = {
    # Table 33, single frequency E1, rural pedestrian.
    "consumer": {
        "signal in space": (0.67, 0.67),
        "residual ionosphere": (6.0, 3.0),
        "residual troposphere": (1.35, 0.14),
        "thermal noise, interference, multipath": (0.69, 0.63),
        "broadcast group delay": (0.30, 0.30),
        "code-carrier divergence": (0.30, 0.30),
    },
    # Table 34, dual frequency E1/E5a, rural vehicle: code positioning without corrections. With corrections and carrier
    # phase (RTK) a survey receiver is a hundred times better; no error of this kind is meant for that.
    "survey": {
        "signal in space": (0.67, 0.67),
        "residual ionosphere": (0.08, 0.03),
        "residual troposphere": (1.35, 0.14),
        "thermal noise, interference, multipath": (0.50, 0.23),
    },
}


def _typical_std(budget: dict[str, tuple[float, float]]) -> float:
    """Return the rms range error [m] of a published error budget, {term: std [m] at two elevations}, rounded to cm."""
    return round(float(np.sqrt(np.mean(np.sum(np.square(list(budget.values())), axis=0)))), 2)


# What world.sky.errors of a scenario says for a receiver of each kind.
# - std: of the budget above. One number for all elevations, because the errors know of none.
# - time_constant: 1100 s, Beard and McLain, "Small Unmanned Aircraft", 2012, section 7.5 (1/k_GPS). The budgets name
#   none.
# - drive_time_constant: 100 s, the time over which airborne receivers smooth code by carrier phase as a standard (RTCA
#   DO-253). The budgets are those of smoothed code, as the row for code-carrier divergence shows, so that noise and
#   multipath come correlated: the receiver's own white range_noise_std stays what it is.
PRESETS: dict[str, dict[str, float | str]] = {
    name: {
        "type": "gauss_markov_2",
        "std": _typical_std(budget),
        "time_constant": 1100.0,
        "drive_time_constant": 100.0,
    }
    for name, budget in BUDGETS.items()
}


@record
class GaussMarkov2State:
    """Range errors and their driving processes, each (S,) and in units of its standard deviation."""

    error: Array = quantity(unit="1", doc="range error")
    drive: Array = quantity(unit="1", doc="first-order process that the range error integrates with a leak")


@record
class GaussMarkov2Step:
    """An exact step over a fixed time, each field ().

    x' = decay x + coupling y + own n1 + shared n2, y' = drive_decay y + drive_noise n2.
    """

    decay: Array = quantity(unit="1", doc="decay of the error x")
    coupling: Array = quantity(unit="1", doc="gain of the drive y into x")
    drive_decay: Array = quantity(unit="1", doc="decay of the drive y")
    own: Array = quantity(unit="1", doc="noise of x alone")
    shared: Array = quantity(unit="1", doc="noise that x shares with y")
    drive_noise: Array = quantity(unit="1", doc="noise of y")


@record
class GaussMarkov2(RangeErrors):
    """One range error per satellite: a first-order process driven by another, as in Symington 2014.

    In metres, dx = -x/tau_1 dt + k y dt and dy = -y/tau_2 dt + q dW. Only the standard deviation of x and the two time
    constants can be seen in x, so these are the parameters. The defaults are the reference implementation's: y' = y
    exp(-T/4) + 0.003 n, x' = x/1.005 + y, T = 0.2 s, which is q = 0.006877 m/s^0.5, k = 5.0131 per second (1/T
    and the correction for the step), y of standard deviation 0.00972 m, and a correlation of 1/e after 44.3 s.
    """

    std: Array = parameter(default=0.58878, unit="m", doc="stationary std of each satellite's range error", minimum=0.0)
    time_constant: Array = parameter(default=40.1, unit="s", doc="time constant of the error itself", above=0.0)
    drive_time_constant: Array = parameter(
        default=4.0, unit="s", doc="time constant of the process that drives it", above=0.0
    )
    normals: ClassVar[int] = 2

    def init(self, draw: Noise) -> GaussMarkov2State:
        """Return the process' random initial state for S satellites, in the statistical steady state."""
        first, second = draw.normals(2)
        rate, drive_rate = self._rates()
        correlation = jnp.sqrt(rate / (rate + drive_rate))
        rest = jnp.sqrt(drive_rate / (rate + drive_rate))
        return GaussMarkov2State(rest * first + correlation * second, second)

    def step(self, state: GaussMarkov2State, draw: Noise, dt: float) -> GaussMarkov2State:
        """Return the process' state dt [s] later, by the exact transition."""
        first, second = draw.normals(2)
        by = self.discretise(dt)
        return GaussMarkov2State(
            by.decay * state.error + by.coupling * state.drive + by.own * first + by.shared * second,
            by.drive_decay * state.drive + by.drive_noise * second,
        )

    def value(self, state: GaussMarkov2State) -> Array:
        """Return the range errors (S,) [m] of the process' state."""
        return self.std * state.error

    def discretise(self, dt: float | Array) -> GaussMarkov2Step:
        """Return the exact transition, and the Cholesky factor of the noise covariance, of a step of any length dt [s].

        With rates a = 1/tau_1 and b = 1/tau_2, unit variances need k' = sqrt(a (a + b)) and noise of intensity 2 b.
        An impulse on y is worth exp(-b s) in y and k' (exp(-a s) - exp(-b s))/(b - a) in x after s, and the covariances
        are integrals of products of these over the step. The closed forms cancel where the step is short: there
        quadrature with 12 nodes is as exact, and cannot cancel.
        """
        a, b = self._rates()
        gain = jnp.sqrt(a * (a + b))
        coupling = gain * _lag(a, b, jnp.asarray(dt, a.dtype))
        slow, fast = jnp.minimum(a, b), jnp.maximum(a, b)

        within = jnp.minimum(dt, _LONG / fast)
        times = within * jnp.asarray(_NODES, a.dtype)
        in_x, in_y = gain * _lag(a, b, times), exp(-b * times)
        weights = 2.0 * b * within * jnp.asarray(_WEIGHTS, a.dtype)
        # The variance of x is the same with a and b exchanged; this way round nothing cancels.
        ratio = coupling * jnp.sqrt(slow / a)
        long_xx = -jnp.expm1(-2.0 * slow * dt) - ratio * (2.0 * jnp.sqrt(slow / (a + b)) * exp(-slow * dt) + ratio)
        apart = fast > 2.0 * slow
        integrals = -jnp.expm1(-(a + b) * dt) / (a + b) + jnp.expm1(-2.0 * b * dt) / (2.0 * b)
        remaining = -jnp.sqrt(a / (a + b)) * jnp.expm1(-(a + b) * dt) - coupling * exp(-b * dt)
        long_xy = jnp.where(apart, 2.0 * b * gain * integrals / jnp.where(apart, b - a, 1.0), remaining)

        is_short = dt * fast <= _LONG
        variance_x = jnp.where(is_short, jnp.sum(weights * in_x * in_x), long_xx)
        covariance = jnp.where(is_short, jnp.sum(weights * in_x * in_y), long_xy)
        drive_noise = jnp.sqrt(-jnp.expm1(-2.0 * b * dt))
        shared = covariance / drive_noise
        own = jnp.sqrt(jnp.maximum(variance_x - shared * shared, 0.0))
        return GaussMarkov2Step(exp(-a * dt), coupling, exp(-b * dt), own, shared, drive_noise)

    def autocovariance(self, lag: npt.ArrayLike) -> Float64:
        """Return the autocovariance (...) [m^2] of the range error at time lags (...) [s], in float64.

        std^2 (b exp(-a t) - a exp(-b t))/(b - a), with a = 1/tau_1, b = 1/tau_2.
        """
        t = np.abs(np.asarray(lag, np.float64))
        (first, slow), (second, quick) = self._terms()
        return np.asarray(first * np.exp(-t / slow) + second * np.exp(-t / quick))

    def allan_variance(self, window: npt.ArrayLike) -> Float64:
        """Return the Allan variance (...) [m^2] of the range error at windows (...) [s], in float64."""
        return np.asarray(sum(weight * exponential_allan_variance(window, tau) for weight, tau in self._terms()))

    def _rates(self) -> tuple[Array, Array]:
        """Return the inverse time constants [1/s] of the process and of its drive."""
        return 1.0 / jnp.asarray(self.time_constant), 1.0 / jnp.asarray(self.drive_time_constant)

    def _terms(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return (weight [m^2], time constant [s]) of each of the two exponentials in the autocovariance."""
        std, slow, quick = float(self.std), float(self.time_constant), float(self.drive_time_constant)
        if abs(slow - quick) < 1e-5 * slow:
            # Equal ones are a limit: moved apart about their mean they change the result by 1e-10 of itself.
            mean = 0.5 * (slow + quick)
            slow, quick = mean * (1.0 + 5e-6), mean * (1.0 - 5e-6)
        return (std**2 * slow / (slow - quick), slow), (-(std**2) * quick / (slow - quick), quick)


def _lag(a: Array, b: Array, s: Array) -> Array:
    """Return (exp(-a s) - exp(-b s))/(b - a) for rates () and times (...), without cancellation, also for a = b."""
    z = jnp.abs(b - a) * s
    small = z < 1e-3
    ratio = jnp.where(small, 1.0 - z * (0.5 - z * (1.0 / 6.0 - z / 24.0)), -jnp.expm1(-z) / jnp.where(small, 1.0, z))
    return s * exp(-jnp.minimum(a, b) * s) * ratio


@record
class ConsumerErrors(GaussMarkov2):
    """Range errors of an ordinary single-frequency receiver: PRESETS["consumer"], with its sources."""

    std: Array = parameter(
        default=PRESETS["consumer"]["std"], unit="m", doc="stationary std of each satellite's range error", minimum=0.0
    )
    time_constant: Array = parameter(default=1100.0, unit="s", doc="time constant of the error itself", above=0.0)
    drive_time_constant: Array = parameter(
        default=100.0, unit="s", doc="time constant of the process that drives it", above=0.0
    )


@record
class SurveyErrors(GaussMarkov2):
    """Range errors of a dual-frequency receiver without corrections: PRESETS["survey"], with its sources."""

    std: Array = parameter(
        default=PRESETS["survey"]["std"], unit="m", doc="stationary std of each satellite's range error", minimum=0.0
    )
    time_constant: Array = parameter(default=1100.0, unit="s", doc="time constant of the error itself", above=0.0)
    drive_time_constant: Array = parameter(
        default=100.0, unit="s", doc="time constant of the process that drives it", above=0.0
    )
