"""Turbulence with the full Dryden spectra of MIL-F-8785C: linear and angular gusts, at any height.

The filters of MIL-F-8785C, 3.7.2, are kept in coordinates in which the stationary covariance is the identity
(the all-pass cascade of Takenaka and Malmquist). In units of tau = L/V, for unit white noise n:

    z1' = -z1 + sqrt(2) n
    z2' = -2 z1 - z2 + sqrt(2) n                      gust / sigma = cos(15 deg) z1 + sin(15 deg) z2
    z3' = -2 sqrt(r) (z1 + z2) - r z3 + sqrt(2 r) n   r = tau over the lag of the vehicle's span

z1 alone is u, (z1, z2) are v and w, and z3 turns them into r and q. The covariance of the noise over a step is
I - Phi Phi^T whatever the step, so that the first value is a standard normal and a change of height only rescales.
"""

from __future__ import annotations

import math
from typing import ClassVar, Literal, NamedTuple

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, power
from qrsim.core.noise import Noise
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.contracts import Turbulence
from qrsim.models.atmosphere.turbulence import (
    HIGHEST_FT,
    NEAR_GROUND,
    NearGround,
    blocked,
    carrying_speed,
    crossing_speed,
    driving_speed,
    high_severity,
    low_altitude_scales,
    own_axes,
)
from qrsim.models.atmosphere.wind import FEET_PER_METRE, wind_to_ned

# From here on one length and a severity table; between HIGHEST_FT and this height both are blended.
HIGH_FT = 2000.0
HIGH_LENGTH_FT = 1750.0
# MIL-F-8785C, figure 7: sigma [ft/s] at these heights [ft], by index of severity.
TABLE_FT = (500.0, 1750.0, 3750.0, 7500.0, 15000.0, 25000.0, 35000.0, 45000.0, 55000.0, 65000.0, 75000.0, 80000.0)
SEVERITY_TABLE_FT_S = {
    1: (3.2, 2.2, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    2: (4.2, 3.6, 3.3, 1.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    3: (6.6, 6.9, 7.4, 6.7, 4.6, 2.7, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0),
    4: (8.6, 9.6, 10.6, 10.1, 8.0, 6.6, 5.0, 4.2, 2.7, 0.0, 0.0, 0.0),
    5: (11.8, 13.0, 16.0, 15.1, 11.6, 9.7, 8.1, 8.2, 7.9, 4.9, 3.2, 2.1),
    6: (15.6, 17.6, 23.0, 23.6, 22.1, 20.0, 16.0, 15.1, 12.1, 7.9, 6.2, 5.1),
    7: (18.7, 21.5, 28.4, 30.2, 30.7, 31.0, 25.2, 23.1, 17.5, 10.7, 8.4, 7.2),
}

_COS_15, _SIN_15 = math.cos(math.pi / 12.0), math.sin(math.pi / 12.0)
_SQRT_3 = math.sqrt(3.0)
# sigma_p = this sigma_w / (b^2 L_w)^(1/3): white noise of intensity pi through H_p of MIL-F-8785C.
ROLL_FACTOR = math.pi * math.sqrt(0.1) * (math.pi / 4.0) ** (1.0 / 6.0)
# The lag of the span is the time to fly 4 b/pi (p and q) or 3 b/pi (r).
_PITCH_SPANS, _YAW_SPANS = 4.0 / math.pi, 3.0 / math.pi
# Below these arguments, series. They have as many terms as double precision needs at the threshold.
_SERIES_BELOW = 1.0
_SINH_TERMS = tuple(1.0 / math.factorial(2 * k + 3) for k in range(8))
_LAG_TERMS = tuple((-1.0) ** k / math.factorial(k + 2) for k in range(17))
_SMALLEST_VARIANCE = 1e-24
# Below these values of x and r x the series of ``_third_variance`` is closer than the subtraction, by number of bytes.
_THIRD_SERIES_BELOW = {4: (1.0, 2.0), 8: (0.25, 0.25)}


def severity_sigma(height_agl: Array, severity: int) -> Array:
    """Return the gust std (n,) [m/s] of MIL-F-8785C figure 7 at heights (n,) [m], linear between the table's heights.

    Args:
        height_agl: (n,) [m]; beyond the table's ends its end values hold.
        severity: index of the figure's curve, 1 (light) to 7.
    """
    feet, row = height_agl * FEET_PER_METRE, SEVERITY_TABLE_FT_S[severity]
    sigma = jnp.full_like(feet, row[0])
    for low, high, start, end in zip(TABLE_FT, TABLE_FT[1:], row, row[1:], strict=False):
        if start != end:
            sigma = sigma + (end - start) / (high - low) * jnp.clip(feet - low, 0.0, high - low)
    return sigma * (1.0 / FEET_PER_METRE)


def dryden_scales(
    height_agl: Array,
    speed_20ft: Array,
    severity: int,
    high_length_ft: float = HIGH_LENGTH_FT,
    near_ground: NearGround = "constant",
) -> tuple[Vec3, Vec3]:
    """Return length scales [m] and stds [m/s] of gusts along, across and down the wind, at heights (n,) [m].

    Below 1000 ft those of the low-altitude model, above 2000 ft L = 1750 ft and sigma by severity, between them
    (1 - f) low + f high with f = (h - 1000 ft)/1000 ft, the low part held at its value at 1000 ft (as JSBSim does).

    Args:
        height_agl: (n,) [m], taken as at least 10 ft.
        speed_20ft: () or (n,) wind 20 ft above the ground [m/s].
        severity: index of MIL-F-8785C figure 7, 1 to 7.
        high_length_ft: length above 2000 ft [ft].
        near_ground: vertical gusts below 10 ft.
    """
    lengths, ratios = low_altitude_scales(height_agl)
    share = jnp.clip((height_agl * FEET_PER_METRE - HIGHEST_FT) * (1.0 / (HIGH_FT - HIGHEST_FT)), 0.0, 1.0)
    low_share = 1.0 - share
    high_length = share * (high_length_ft / FEET_PER_METRE)
    high_sigma = share * severity_sigma(height_agl, severity)
    sigma = low_share * (0.1 * speed_20ft)
    of_height = ratios.map(lambda ratio: sigma * ratio + high_sigma)
    if near_ground == "blocked":
        of_height = Vec3(of_height.x, of_height.y, of_height.z * blocked(height_agl))
    return lengths.map(lambda length: low_share * length + high_length), of_height


class Decay(NamedTuple):
    """exp(-x) and related functions, each without loss of digits for x from 1e-7 to 50."""

    decay: Array  # a = exp(-x)
    loss: Array  # 1 - a
    spread: Array  # sqrt(1 - a^2)
    variance: Array  # 1 - a^2
    excess: Array  # sinh x - x, below _SERIES_BELOW only


def exponential_decay(x: Array) -> Decay:
    """Return the exponential factors, exp(-x) and others, of a filter step x = V T/L (airspeed, time, length scale)."""
    small = jnp.minimum(x, _SERIES_BELOW)
    square = small * small
    series = jnp.full_like(square, _SINH_TERMS[-1])
    for term in _SINH_TERMS[-2::-1]:
        series = series * square + term
    excess = series * square * small
    decay = 1.0 / exp(x)
    # 1 - exp(-2 x) = 2 exp(-x) sinh x.
    spread = jnp.sqrt(jnp.where(x < _SERIES_BELOW, 2.0 * decay * (small + excess), 1.0 - decay * decay))
    variance = spread * spread
    return Decay(decay, variance / (1.0 + decay), spread, variance, excess)


class SecondOrder(NamedTuple):
    """One step of (z1, z2): z1 <- z1 - loss z1 + l11 n1, z2 <- z2 - loss z2 - cross z1 + l21 n1 + l22 n2."""

    loss: Array
    cross: Array
    l11: Array
    l21: Array
    l22: Array


def second_order(x: Array, of: Decay) -> SecondOrder:
    """Return transition matrix and noise Cholesky factor of a double-pole filter for one step x = V T/L, any shape.

    Phi = a [[1, 0], [-2 x, 1]], a = exp(-x). l11^2 = 1 - a^2, l21 = 2 x a^2/l11, and
    l22^2 = 1 - a^2 - 4 x^2 a^2/(1 - a^2) = 2 a (sinh x - x) (sinh x + x)/sinh x, which is 2/3 x^3 for small x.
    """
    cross = 2.0 * x * of.decay
    l11 = of.spread
    small = jnp.minimum(x, _SERIES_BELOW)
    from_series = 2.0 * of.decay * of.excess * (2.0 * small + of.excess) / (small + of.excess)
    remainder = jnp.where(x < _SERIES_BELOW, from_series, of.variance - cross * cross / of.variance)
    return SecondOrder(of.loss, cross, l11, cross * of.decay / l11, jnp.sqrt(remainder))


class ThirdRow(NamedTuple):
    """One step of z3: z3 <- z3 - loss z3 + f1 z1 + f2 z2 + l31 n1 + l32 n2 + l33 n3."""

    loss: Array
    f1: Array
    f2: Array
    l31: Array
    l32: Array
    l33: Array


def third_row(x: Array, ratio: Array, of: Decay, of_lag: Decay, two: SecondOrder) -> ThirdRow:
    """Return row 3 of transition matrix and noise Cholesky factor: the filter's lag by the wing span, any shape.

    With d0 = (a - a_r)/(r - 1), d1 = (x a - d0)/(r - 1) and a_r = exp(-r x): f2 = -2 sqrt(r) d0,
    f1 = -2 sqrt(r) (d0 - 2 d1). The pole r may coincide with the other two.

    Args:
        x: step in units of tau.
        ratio: r, tau over the lag.
        of, of_lag: of x and of r x.
        two: of x.
    """
    apart = ratio - 1.0
    y = apart * x
    near = jnp.abs(y) < _SERIES_BELOW
    small = jnp.clip(y, -_SERIES_BELOW, _SERIES_BELOW)
    series = jnp.full_like(y, _LAG_TERMS[-1])
    for term in _LAG_TERMS[-2::-1]:
        series = series * small + term
    scale = x * of.decay
    divisor = jnp.where(near, 1.0, apart)
    d0 = jnp.where(near, scale * (1.0 - small * series), of.decay - of_lag.decay) / divisor
    d1 = jnp.where(near, scale * x * series, scale - d0) / divisor
    twice_root = 2.0 * jnp.sqrt(ratio)
    f2, f1 = -twice_root * d0, -twice_root * (d0 - 2.0 * d1)
    l31 = -f1 * of.decay / two.l11
    # What of z2's noise z1's does not explain, in the covariance with z3's: 1 - a sinh x/x is small for small x.
    unexplained = jnp.where(x < _SERIES_BELOW, of.loss - of.decay * of.excess / x, 1.0 - of.variance / (2.0 * x))
    l32 = twice_root * (2.0 * d1 - unexplained * d0) * two.cross / (of.variance * two.l22)
    subtracted = of_lag.variance - f1 * f1 - f2 * f2 - l31 * l31 - l32 * l32
    remainder = _third_variance(x, ratio * x, of_lag.decay, subtracted)
    return ThirdRow(of_lag.loss, f1, f2, l31, l32, jnp.sqrt(jnp.maximum(remainder, _SMALLEST_VARIANCE)))


def _third_variance(x: Array, y: Array, lag_decay: Array, subtracted: Array) -> Array:
    """Return the variance of noise 3 given noises 1 and 2 of the gust filter, for steps x and y = ratio x, any shape.

    It is a fraction y^5/360 of the variance for small y, which subtraction cannot find in single precision. It is
    2 r (1 + r)^4/(r - 1)^4 times the squared distance of exp(-r s) from the span of exp(-s) and s exp(-s) on [0, x],
    a quotient of Gram determinants whose series, with exp(-y) taken out, has even orders only.
    """
    x_below, y_below = _THIRD_SERIES_BELOW[x.dtype.itemsize]
    small_x, small_y = jnp.minimum(x, x_below), jnp.minimum(y, y_below)
    a, b = small_x * small_x, small_y * small_y
    order_2 = (9.0 * b - 10.0 * a) * (1.0 / 210.0)
    order_4 = ((5.0 * a - 22.0 * b) * a + 10.0 * b * b) * (1.0 / 12_600.0)
    order_6 = (((2100.0 * a + 321.0 * b) * a - 820.0 * b * b) * a + 250.0 * b * b * b) * (1.0 / 29_106_000.0)
    order_8 = (((388_525.0 * a - 235_284.0 * b) * a - 11_870.0 * b * b) * a + 24_500.0 * b * b * b) * a
    order_8 = (5625.0 * b * b * b * b - order_8) * (1.0 / 90_810_720_000.0)
    square = (small_x + small_y) * (small_x + small_y)
    leading = small_y * square * square * (1.0 / 360.0) * lag_decay
    series = leading * (1.0 + (order_2 + (order_4 + (order_6 + order_8))))
    return jnp.where((x < x_below) & (y < y_below), series, subtracted)


def rate_weights(ratio: Array) -> tuple[Array, Array, Array]:
    """Return the weights of the three filter states in the gust minus its span-lagged value, per standard deviation."""
    inverse = 1.0 / (1.0 + ratio)
    square = inverse * inverse
    half = 1.0 / (2.0 * math.sqrt(2.0))
    return (
        _COS_15 * inverse,
        half * ((3.0 * _SQRT_3 + 1.0) * ratio + (_SQRT_3 - 1.0)) * square,
        jnp.sqrt(0.5 * ratio) * (_SQRT_3 * ratio - 1.0) * square,
    )


@record
class FilterState:
    """z1, z2, z3 of one axis, each (n,) and of unit variance."""

    first: Array = quantity(unit="1", doc="z1")
    second: Array = quantity(unit="1", doc="z2")
    third: Array = quantity(unit="1", doc="z3, of the angular gust")

    def advance(self, x: Array, of: Decay, ratio: Array, of_lag: Decay, normals: tuple[Array, ...]) -> FilterState:
        """Return the gust filters (n,) one step later, for x = V T/L, driven by three standard ``normals`` (n,)."""
        n1, n2, n3 = normals
        two = second_order(x, of)
        row = third_row(x, ratio, of, of_lag, two)
        # Old value plus change: exp(-x) itself loses digits for small x.
        return FilterState(
            self.first + (two.l11 * n1 - two.loss * self.first),
            self.second + (two.l21 * n1 + two.l22 * n2 - two.loss * self.second - two.cross * self.first),
            self.third
            + (
                row.l31 * n1
                + row.l32 * n2
                + row.l33 * n3
                + (row.f1 * self.first + row.f2 * self.second - row.loss * self.third)
            ),
        )

    def gust(self) -> Array:
        """Return the gust (n,) in units of its standard deviation, from the filter's states."""
        return _COS_15 * self.first + _SIN_15 * self.second

    def gust_less_lagged(self, ratio: Array) -> Array:
        """Return the gust minus its lagged value (n,), for angular gusts, in units of the gust's standard deviation."""
        w1, w2, w3 = rate_weights(ratio)
        return w1 * self.first + w2 * self.second + w3 * self.third


@record
class DrydenState:
    """The gust filters, each (n,), in units of their standard deviations."""

    along: Array = quantity(unit="1", doc="gust along the mean wind")
    across: FilterState = quantity(unit="1", doc="filter across the mean wind")
    down: FilterState = quantity(unit="1", doc="vertical filter")
    roll: Array = quantity(unit="1", doc="angular gust about the mean wind")


@record
class Dryden(Turbulence):
    """Linear and angular gusts with the Dryden spectra of MIL-F-8785C, discretised exactly."""

    speed_20ft: Array = driving_speed(" below 2000 ft")
    wind_from_rad: Array = own_axes()
    span: Array = parameter(
        default=0.6, unit="m", doc="span of the vehicle, over which angular gusts are averaged", minimum=0.01
    )
    severity: int = high_severity()
    airspeed: Literal["relative", "ground"] = crossing_speed()
    near_ground: NearGround = setting(default="blocked", doc=NEAR_GROUND)

    normals: ClassVar[int] = 8
    rates: ClassVar[bool] = True

    def init(self, draw: Noise) -> DrydenState:
        """Return the filters' random initial state (n,), in the statistical steady state."""
        u, v1, v2, w1, w2, p, v3, w3 = draw.normals(8)
        return DrydenState(u, FilterState(v1, v2, v3), FilterState(w1, w2, w3), p)

    def step(
        self, state: DrydenState, draw: Noise, height_agl: Array, velocity_ned: Vec3, mean_wind_ned: Vec3, dt: float
    ) -> DrydenState:
        """Return the filters' state dt [s] later; heights [m] and ground velocities [m/s] (n,) are held in the step."""
        u, v1, v2, w1, w2, p, v3, w3 = draw.normals(8)
        lengths, _ = self._scales(height_agl)
        way = dt * carrying_speed(self.airspeed, velocity_ned, mean_wind_ned)
        # u and v have the same length, p and q the same lag.
        x_across, x_down = way / lengths.y, way / lengths.z
        x_yaw, x_pitch = way * (1.0 / self._yaw_length()), way * (1.0 / self._pitch_length())
        across, down = exponential_decay(x_across), exponential_decay(x_down)
        yaw_lag, pitch_lag = exponential_decay(x_yaw), exponential_decay(x_pitch)
        return DrydenState(
            state.along + (across.spread * u - across.loss * state.along),
            state.across.advance(x_across, across, x_yaw / x_across, yaw_lag, (v1, v2, v3)),
            state.down.advance(x_down, down, x_pitch / x_down, pitch_lag, (w1, w2, w3)),
            state.roll + (pitch_lag.spread * p - pitch_lag.loss * state.roll),
        )

    def gust_ned(self, state: DrydenState, height_agl: Array) -> Vec3:
        """Return the gust velocity (n,) [m/s] NED, which adds to the mean wind, at heights (n,) [m] above ground."""
        _, sigma = self._scales(height_agl)
        return wind_to_ned(
            sigma.x * state.along, sigma.y * state.across.gust(), sigma.z * state.down.gust(), self.wind_from_rad
        )

    def gust_rates_ned(self, state: DrydenState, height_agl: Array) -> Vec3:
        """Return the air's rotation (n,) [rad/s] NED by gusts, at heights (n,) [m] above ground.

        It is to the vehicle's rates what the wind is to its velocity: aerodynamic rates are the vehicle's minus these.
        About the wind axes, right-handed, it is p = the roll gust, q = H_q/H_w w and r = -H_r/H_v v of MIL-F-8785C
        (q of the sign of dw/dt, r of the opposite sign of dv/dt): the rotation of gusts that the mean wind carries
        past a vehicle that hovers or flies against the wind. One that outruns the wind meets -q and -r.
        """
        lengths, sigma = self._scales(height_agl)
        per_pitch, per_yaw = 1.0 / self._pitch_length(), 1.0 / self._yaw_length()
        roll_sigma = ROLL_FACTOR * sigma.z / power(jnp.asarray(self.span * self.span * lengths.z), 1.0 / 3.0)
        return wind_to_ned(
            roll_sigma * state.roll,
            sigma.z * per_pitch * state.down.gust_less_lagged(lengths.z * per_pitch),
            -sigma.y * per_yaw * state.across.gust_less_lagged(lengths.y * per_yaw),
            self.wind_from_rad,
        )

    def _scales(self, height_agl: Array) -> tuple[Vec3, Vec3]:
        """Return length scales [m] and standard deviations [m/s] of the gusts at heights (n,) [m] above ground."""
        return dryden_scales(height_agl, self.speed_20ft, self.severity, near_ground=self.near_ground)

    def _pitch_length(self) -> Array:
        """Return the lag length [m] of the roll and pitch rates of the air, proportional to the wing span."""
        return _PITCH_SPANS * self.span

    def _yaw_length(self) -> Array:
        """Return the lag length [m] of the yaw rate of the air, proportional to the wing span."""
        return _YAW_SPANS * self.span
