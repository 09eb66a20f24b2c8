"""Elementary functions that XLA vectorises on a CPU.

XLA calls a scalar library routine per element for sin and cos, which costs more than the rest of a
simulation step. In single precision these are range reduction and a polynomial: for exp, log and arctan2 the
classical ones of Cephes (S. L. Moshier), for sin and cos our own fit.
In double precision they are the library's own, because there accuracy is what is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.primitives import Kernel, primitive_of

# pi/2 in three parts whose products with small integers are exact in single precision (Cody and Waite).
_PIO2_HIGH, _PIO2_MID, _PIO2_LOW = 1.5703125, 4.837512969970703125e-4, 7.54978995489188e-8
_LN2_HIGH, _LN2_LOW = 0.693359375, -2.12194440e-4
_SHIFT = 1.5 * 2.0**23


Rounding = Callable[[Array], Array]


def freely(product: Array) -> Array:
    """Return the argument unchanged: the default of ``rounding``, with which the compiler may fuse product and sum."""
    return product


def rounded(product: Array) -> Array:
    """Return a product that the compiler must round before adding to it (no fused multiply-add); magnitude below 1e30.

    XLA contracts a * b + c to one rounding where it happens to see both operations together, so the last bit of a
    result depends on the program around it. An operation between the two, which the compiler cannot know to be
    idle, prevents that.
    """
    found: Array = rounded_p.bind(product)
    return found


# The minimum is what XLA gets; our own code generator rounds what is marked by this primitive, and computes no minimum.
rounded_p = primitive_of("rounded", lambda product: jnp.minimum(product, 1e30), elementwise=True)


def _polynomial(x: Array, coefficients: tuple[float, ...], rounding: Rounding = freely) -> Array:
    """Return the polynomial at x with ``coefficients``, the highest power first (Horner's rule)."""
    result = jnp.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        result = rounding(result * x) + coefficient
    return result


def sincos_ratio(x: Array, rounding: Rounding = freely) -> tuple[Array, Array, Array]:
    """Return (a, b, c) with sin x = a/c and cos x = b/c for angles [rad] of any shape; ``rounding``: see ``rounded``.

    From the tangent t of half the reduced angle: 2t/(1 + t^2) and (1 - t^2)/(1 + t^2). The division is left for
    last on purpose: XLA on a CPU computes a result that ends in a division once, and repeats one that ends in
    anything cheaper inside every consumer.
    """
    if x.dtype != jnp.float32:
        return jnp.sin(x), jnp.cos(x), jnp.ones_like(x)
    quadrant, sine, cosine, scale = _reduced(x, rounding)
    swap = (quadrant & 1) == 1
    sin_part, cos_part = jnp.where(swap, cosine, sine), jnp.where(swap, sine, cosine)
    sin_part = jnp.where((quadrant & 2) == 2, -sin_part, sin_part)
    cos_part = jnp.where(((quadrant + 1) & 2) == 2, -cos_part, cos_part)
    return sin_part, cos_part, scale


def sine_ratio(x: Array, quarters: Array, rounding: Rounding = freely) -> tuple[Array, Array]:
    """Return (a, c) with sin(x + quarters pi/2) = a/c of float32 x; to the bit those of ``sincos_ratio``.

    Args:
        x: (...) [rad].
        quarters: (...) int32 quarter turns; with 1 it is the cosine.
        rounding: see ``rounded``.
    """
    quadrant, sine, cosine, scale = _reduced(x, rounding)
    turned = quadrant + quarters
    part = jnp.where((turned & 1) == 1, cosine, sine)
    return jnp.where((turned & 2) == 2, -part, part), scale


def _reduced(x: Array, rounding: Rounding) -> tuple[Array, Array, Array, Array]:
    """Return the quadrant (int32) of float32 x [rad], and sine and cosine of the angle in it with their denominator."""
    # Added to a number below 2**22, this leaves the nearest whole one in the last bits; quicker than to convert it.
    shifted = lax.stop_gradient(rounding(x * (2.0 / math.pi)) + _SHIFT)
    # Marked, or XLA takes a number plus another minus the same for itself.
    turns = rounded(shifted) - _SHIFT
    half = 0.5 * (((x - turns * _PIO2_HIGH) - turns * _PIO2_MID) - turns * _PIO2_LOW)
    z = half * half
    # Chebyshev fit of tan(y)/y on |y| <= pi/8, relative error 2e-9.
    t = rounding(
        half * _polynomial(z, (0.025671956095, 0.05343703505, 0.133363104741, 0.333332753321, 1.000000001803), rounding)
    )
    square = rounding(t * t)
    return lax.bitcast_convert_type(shifted, jnp.int32), t + t, 1.0 - square, 1.0 + square


def _sincos(x: Array) -> tuple[Array, Array]:
    """Return sine and cosine of angles [rad] of any shape; the function that ``sincos`` compiles."""
    sine, cosine, scale = sincos_ratio(x)
    return sine / scale, cosine / scale


_SINCOS = Kernel("sincos", ("float32",), ("float32",) * 2, _sincos)


def sincos(x: Array) -> tuple[Array, Array]:
    """Return sine and cosine of angles [rad] of any shape; float32 error below 2e-7 for |x| < 1e4."""
    if x.dtype != jnp.float32:
        return jnp.sin(x), jnp.cos(x)
    sine, cosine = _SINCOS(x)
    return sine, cosine


def sincos_turns(turns: Array) -> tuple[Array, Array]:
    """Return sine and cosine of 2 pi times turns of any shape; float32 error below 9e-7 for |turns| < 1/2.

    From sine and cosine of half the angle, which need neither quadrants nor choices. XLA on a CPU repeats it in each
    consumer, see ``sincos_ratio``.
    """
    if turns.dtype != jnp.float32:
        part = turns - jnp.round(turns)
        return jnp.sin(2.0 * math.pi * part), jnp.cos(2.0 * math.pi * part)
    double, cosine, whole_cosine = _SINCOS_TURNS(turns)
    return double * cosine, whole_cosine


def _sincos_turns(turns: Array) -> tuple[Array, Array, Array]:
    """Return (a, b, cos) of 2 pi turns with sin = a b, a product left to the caller, so that a sum may fuse it."""
    part = turns - jnp.round(turns)
    z = part * part
    # Fits of sin(pi p)/p and cos(pi p) in z = p^2 on [0, 1/4], errors of sine and cosine below 4e-9 and 5e-8.
    sine = part * _polynomial(z, (0.07722007, -0.59804514, 2.55003137, -5.16770688, 3.14159258))
    cosine = _polynomial(z, (0.2196968, -1.33188018, 4.05841192, -4.93479286, 0.99999995))
    double = sine + sine
    return double, cosine, 1.0 - double * sine


_SINCOS_TURNS = Kernel("sincos_turns", ("float32",), ("float32",) * 3, _sincos_turns)


def log_f32(x: Array, rounding: Rounding = freely) -> Array:
    """Return the natural logarithm of positive, normal float32 numbers; ``rounding``: see ``rounded``."""
    bits = lax.bitcast_convert_type(x, jnp.int32)
    # Split so that the mantissa lies in [sqrt(1/2), sqrt(2)), where the polynomial is centred.
    exponent = (bits - 0x3F3504F3) >> 23
    mantissa = lax.bitcast_convert_type(bits - (exponent << 23), jnp.float32)
    e = exponent.astype(jnp.float32)
    f = mantissa - 1.0
    z = f * f
    tail = _polynomial(
        f,
        (
            7.0376836292e-2,
            -1.1514610310e-1,
            1.1676998740e-1,
            -1.2420140846e-1,
            1.4249322787e-1,
            -1.6668057665e-1,
            2.0000714765e-1,
            -2.4999993993e-1,
            3.3333331174e-1,
        ),
        rounding,
    )
    # The products not named below are exact, so it does not matter how they are rounded.
    return (f + ((rounding(f * z * tail) + rounding(e * _LN2_LOW)) - 0.5 * z)) + e * _LN2_HIGH


_LOG = Kernel(
    "log", ("float32",), ("float32",), lambda x: (log_f32(x),), lambda x, tangent, found: (tangent[0] / x[0],)
)


def log(x: Array) -> Array:
    """Return the natural logarithm of positive, normal numbers of any shape and floating dtype."""
    return _LOG(x)[0] if x.dtype == jnp.float32 else jnp.log(x)


def _exp(x: Array) -> tuple[Array, Array]:
    """Return two factors of e**x in single precision: e**r with abs(r) <= ln(2)/2, and the power of two 2**k.

    The caller multiplies them, so that a sum there can be fused with the product.
    """
    x = jnp.clip(x, -87.0, 88.0)
    # The last bits of ``shifted`` are k, the whole number nearest to x/ln(2), as in ``sincos_ratio``.
    shifted = lax.stop_gradient(x * (1.0 / math.log(2.0)) + _SHIFT)
    k = rounded(shifted) - _SHIFT
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    tail = _polynomial(
        r, (1.9875691500e-4, 1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1)
    )
    # 2**k: k plus the bias 127 in the bits of the exponent.
    scale = lax.bitcast_convert_type((lax.bitcast_convert_type(shifted, jnp.int32) + 127) << 23, jnp.float32)
    return 1.0 + (r + r * r * tail), scale


_EXP = Kernel("exp", ("float32",), ("float32",) * 2, _exp)


def exp(x: Array) -> Array:
    """Return e**x of any shape; in float32 the argument is clipped to [-87, 88], so that results are normal."""
    if x.dtype != jnp.float32:
        return jnp.exp(x)
    mantissa, scale = _EXP(x)
    return mantissa * scale


def _reciprocal_root(x: Array) -> tuple[Array]:
    """Return (1/sqrt(x),) for float32 x above 0, relative error below 8e-7; a tuple, as ``Kernel`` requires."""
    guess = lax.bitcast_convert_type(0x5F375A86 - (lax.bitcast_convert_type(x, jnp.int32) >> 1), jnp.float32)
    # With 1 - d = x guess^2, |d| < 0.07: one over the root of 1 - d, error below 8e-7.
    d = 1.0 - (x * guess) * guess
    return (guess * _polynomial(d, (0.31303353, 0.37628168, 0.50000048, 0.99999925)),)


_RECIPROCAL_ROOT = Kernel(
    "reciprocal_root",
    ("float32",),
    ("float32",),
    _reciprocal_root,
    lambda x, tangent, found: (-0.5 * tangent[0] * found[0] * (found[0] * found[0]),),
)


def reciprocal_root(x: Array) -> Array:
    """Return 1/sqrt(x) of positive, normal numbers of any shape; float32 relative error below 1e-6.

    A guess by halving the exponent, within 3.5 %, times a fit of one over the root of what is left; far cheaper than a
    root and a division.
    """
    return _RECIPROCAL_ROOT(x)[0] if x.dtype == jnp.float32 else 1.0 / jnp.sqrt(x)


def power(x: Array, exponent: float) -> Array:
    """Return x**exponent for positive numbers of any shape, as exp(exponent log x)."""
    return exp(exponent * log(x))


def _arctan2(y: Array, x: Array) -> tuple[Array]:
    """Return a tuple of one array: the angles [rad] of float32 vectors (x, y), in (-pi, pi]."""
    over, beside = jnp.abs(y), jnp.abs(x)
    steep = over > beside
    t = jnp.minimum(over, beside) / jnp.maximum(jnp.maximum(over, beside), 1e-37)
    # Above tan(pi/8) the angle less pi/4 is that of (t - 1)/(t + 1).
    wide = t > math.tan(math.pi / 8.0)
    t = jnp.where(wide, (t - 1.0) / (t + 1.0), t)
    z = t * t
    angle = t + t * z * _polynomial(z, (8.05374449538e-2, -1.38776856032e-1, 1.99777106478e-1, -3.33329491539e-1))
    angle = angle + jnp.where(wide, math.pi / 4.0, 0.0)
    angle = jnp.where(steep, math.pi / 2.0 - angle, angle)
    angle = jnp.where(x < 0.0, math.pi - angle, angle)
    return (jnp.where(y < 0.0, -angle, angle),)


_ARCTAN2 = Kernel("arctan2", ("float32",) * 2, ("float32",), _arctan2)


def arctan2(y: Array, x: Array) -> Array:
    """Return the angle [rad] of points (x, y) of any shape, in [-pi, pi]; float32 error below 3e-7, zero at (0, 0)."""
    return _ARCTAN2(y, x)[0] if x.dtype == jnp.float32 else jnp.arctan2(y, x)


def wrap_angle(x: Array) -> Array:
    """Return angles [rad] of any shape wrapped to [-pi, pi]."""
    return x - 2.0 * math.pi * jnp.round(x * (0.5 / math.pi))
