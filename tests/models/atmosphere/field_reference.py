"""What the turbulence field is held against: closed forms of isotropic turbulence, and its waves in double precision.

The waves are summed one by one, as complex exponentials; the closed forms know nothing of waves.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import gamma, kv

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.engine.settings import quick_jit
from qrsim.models.atmosphere.field import DrydenField, FieldWaves
from qrsim.models.atmosphere.field_modes import modes
from qrsim.models.atmosphere.wind import LogShear

Floats = np.ndarray[Any, np.dtype[np.float64]]
FOOT = 0.3048
# Wind 20 ft above the ground [m/s], from the south-west, and its bearing [rad].
SPEED_20FT, WIND_FROM = 8.0, 0.7
# How many worlds draw at once, so that there is one program for any of them.
WORLDS = 400
# Length of the Dryden form above 2000 ft, and the lowest wavenumber that the set is to have: half of one over it [1/m].
LONGEST = 1750.0 * FOOT
LOWEST = 0.5 / LONGEST
# MIL-F-8785C, figure 7, light to severe curve of index 3 at 1750 and 3750 ft [ft/s].
SEVERITY_3 = ((500.0, 1750.0, 3750.0, 7500.0), (6.6, 6.9, 7.4, 6.7))


class Scales(NamedTuple):
    """Lengths [m] and standard deviations [m/s] of horizontal and vertical gusts."""

    length_h: Floats
    length_w: Floats
    sigma_h: Floats
    sigma_w: Floats


def mil(height: Any, speed_20ft: float = SPEED_20FT, high_ft: float = 1750.0) -> Scales:
    """Return the scales of MIL-F-8785C at heights [m]; blended from 1000 to 2000 ft, above that of severity 3."""
    feet = np.maximum(np.asarray(height, float) / FOOT, 10.0)
    low = np.minimum(feet, 1000.0)
    shape = 0.177 + 0.000823 * low
    share = np.clip(feet / 1000.0 - 1.0, 0.0, 1.0)
    high = np.interp(feet, *SEVERITY_3) * FOOT
    sigma_w = 0.1 * speed_20ft
    # The ground blocks vertical gusts below 10 ft.
    above = np.clip(np.asarray(height, float) / (10.0 * FOOT), 0.0, 1.0)
    blend = partial(lambda a, b: (1.0 - share) * a + share * b)
    return Scales(
        blend(low / shape**1.2 * FOOT, high_ft * FOOT),
        blend(low * FOOT, high_ft * FOOT),
        blend(sigma_w * shape**-0.4, high),
        above * blend(sigma_w, high),
    )


# Closed forms of isotropic turbulence of length L [m] and variance 1.


def energy(k: Any, length: float, spectrum: str = "dryden") -> Floats:
    """Return E(k) [m], whose integral over all k is 3/2."""
    if spectrum == "dryden":
        x = np.asarray(k) * length
        return 8.0 * length / math.pi * x**4 / (1.0 + x * x) ** 3
    a = length * gamma(1 / 3) / (math.sqrt(math.pi) * gamma(5 / 6))
    x = np.asarray(k) * a
    return 55.0 * gamma(5 / 6) / (9.0 * math.sqrt(math.pi) * gamma(1 / 3)) * a * x**4 / (1.0 + x * x) ** (17 / 6)


def along(r: Any, length: float, spectrum: str = "dryden") -> Floats:
    """Return f(r), the correlation of the components along a separation r > 0 [m]."""
    r = np.asarray(r, float)
    if spectrum == "dryden":
        return np.exp(-r / length)
    x = r / (length * gamma(1 / 3) / (math.sqrt(math.pi) * gamma(5 / 6)))
    return np.asarray(2.0 / gamma(1 / 3) * (x / 2.0) ** (1 / 3) * kv(1 / 3, x))


def across(r: Any, length: float, spectrum: str = "dryden") -> Floats:
    """Return g(r), the correlation of components across a separation: f + r f'/2, by continuity."""
    r = np.asarray(r, float)
    if spectrum == "dryden":
        return (1.0 - r / (2.0 * length)) * np.exp(-r / length)
    step = 1e-4 * r
    return along(r, length, spectrum) + r / 2.0 * (
        along(r + step, length, spectrum) - along(r - step, length, spectrum)
    ) / (2.0 * step)


def spectrum_along(o: Any, length: float, spectrum: str = "dryden") -> Floats:
    """Return the one-sided spectrum [m] of the component along a line at wavenumbers [rad/m], MIL-F-8785C."""
    x = np.asarray(o) * length
    if spectrum == "dryden":
        return 2.0 * length / math.pi / (1.0 + x * x)
    return 2.0 * length / math.pi / (1.0 + (1.339 * x) ** 2) ** (5 / 6)


def spectrum_across(o: Any, length: float, spectrum: str = "dryden") -> Floats:
    """Return the one-sided spectrum [m] of a component across a line at wavenumbers [rad/m], MIL-F-8785C."""
    x = np.asarray(o) * length
    if spectrum == "dryden":
        return length / math.pi * (1.0 + 3.0 * x * x) / (1.0 + x * x) ** 2
    square = (1.339 * x) ** 2
    return length / math.pi * (1.0 + 8.0 / 3.0 * square) / (1.0 + square) ** (11 / 6)


# The mean over worlds of the set of waves.


def shells(length: float, chains: int = 16, octaves: int = 12, spectrum: str = "dryden", dilations: int = 8) -> Any:
    """Return wavenumbers [rad/m] and shares of the variance of a component, (D, M) each, for D dilations."""
    number = np.arange(chains) + 0.5
    groups = np.arange(chains) * 2 // chains
    centre = (groups + 0.5) / 2.0
    square = 2.0 ** (centre - number / chains)
    square /= np.array([square[groups == g].mean() for g in (0, 1)])[groups]
    turn = 2.0 ** ((np.arange(dilations) + 0.5) / dilations / chains)[:, None, None]
    octave = 2.0 ** np.arange(octaves)[:, None]
    k, middle = LOWEST * octave * 2.0 ** (number / chains) * turn, LOWEST * octave * 2.0**centre * turn
    share = 2.0 * energy(middle, length, spectrum) * middle * math.log(2.0) / chains * square / 3.0
    return k.reshape(dilations, -1), share.reshape(dilations, -1)


def shell_along(k: Floats, share: Floats, r: Any) -> Floats:
    """Return f at separations (R,) of shells: a shell has 3 j1(k r)/(k r)."""
    x = k[..., None] * np.asarray(r, float)
    return np.mean(np.sum(share[..., None] * 3.0 * (np.sin(x) - x * np.cos(x)) / x**3, axis=-2), axis=0)


def shell_across(k: Floats, share: Floats, r: Any) -> Floats:
    """Return g at separations (R,) of shells, f + r f'/2."""
    x = k[..., None] * np.asarray(r, float)
    of = 1.5 * (np.sin(x) / x - (np.sin(x) - x * np.cos(x)) / x**3)
    return np.mean(np.sum(share[..., None] * of, axis=-2), axis=0)


def shell_spectra(k: Floats, share: Floats, o: Any) -> tuple[Floats, Floats]:
    """Return the spectra along and across a line at wavenumbers (R,), one-sided, of shells."""
    ratio = np.asarray(o) / k[..., None]
    inside, of = ratio < 1.0, share[..., None] / k[..., None]
    found = (np.where(inside, 1.5 * (1.0 - ratio**2), 0.0), np.where(inside, 0.75 * (1.0 + ratio**2), 0.0))
    return tuple(np.mean(np.sum(of * part, axis=-2), axis=0) for part in found)  # type: ignore[return-value]


# The component.


def component(dtype: Any = np.float32, **settings: Any) -> DrydenField:
    """Return a field in a wind of SPEED_20FT, with its numbers as arrays."""
    given = {"speed_20ft": SPEED_20FT, **settings}
    if given.get("convection_ned") is not None:
        given["convection_ned"] = np.array(given["convection_ned"])
    return jax.tree.map(jnp.asarray, cast(DrydenField(**given), dtype))


@partial(quick_jit, static_argnames="dtype")
def _drawn(turbulence: DrydenField, seed: Any, worlds: Any, dtype: str) -> FieldWaves:
    ids = jnp.arange(turbulence.field_ids, dtype=jnp.uint32)
    wind = jax.tree.map(jnp.asarray, cast(LogShear(SPEED_20FT, WIND_FROM), dtype))  # type: ignore[arg-type]

    def one(world: Any) -> FieldWaves:
        stream = Key.root(seed, world).stream("/turbulence", ids)
        return turbulence.draw_field(Draw(stream, jnp.int32(0), jnp.zeros((), dtype)), wind)

    return jax.vmap(one)(worlds)


def draws(turbulence: DrydenField, seed: int = 5, dtype: str = "float32") -> FieldWaves:
    """Return what each of WORLDS worlds draws."""
    return _drawn(turbulence, jnp.array([seed, 0], jnp.uint32), jnp.arange(WORLDS, dtype=jnp.uint32), dtype)


def draw(turbulence: DrydenField, seed: int = 5, world: int = 0, dtype: str = "float32") -> FieldWaves:
    """Return what a world draws."""
    return jax.tree.map(lambda part: part[world], draws(turbulence, seed, dtype))


def gust(turbulence: DrydenField, field: FieldWaves, place: Any, seconds: int = 0, fraction: float = 0.0) -> Any:
    """Return gusts (n, 3) and rates (n, 3) of the component at places (n, 3) NED, heights -down."""
    like = field.dilation.dtype
    found = _compiled(turbulence, field, jnp.asarray(place, like), jnp.int32(seconds), jnp.asarray(fraction, like))
    return tuple(np.asarray(part, np.float64) for part in found)


def gust_at(turbulence: DrydenField, field: FieldWaves, place: Any, seconds: Any, fraction: Any) -> Any:
    """Return gusts (n, 3) and rates (n, 3) of the component; to be traced."""
    where = Vec3(*place.T)
    given = {"seconds": seconds, "fraction": fraction, "field": field}
    state = turbulence.init(None)  # type: ignore[arg-type]
    found = turbulence.gust_ned(state, -where.z, where, **given)
    rates = turbulence.gust_rates_ned(state, -where.z, where, **given)
    return found.stack(), rates.stack()


_compiled = quick_jit(gust_at)


@quick_jit
def series(turbulence: DrydenField, fields: FieldWaves, place: Any, seconds: Any, fraction: Any) -> Any:
    """Return gusts and rates (W, T, 3) in worlds (W,) at places (T, 3), each with a time of its own (T,)."""

    def one(world: FieldWaves, at: Any, whole: Any, rest: Any) -> Any:
        return tuple(part[0] for part in gust_at(turbulence, world, at[None], whole, rest))

    return jax.vmap(jax.vmap(one, (None, 0, 0, 0)), (0, None, None, None))(fields, place, seconds, fraction)


def sampled(turbulence: DrydenField, worlds: int, place: Any, time: Any = 0.0, seed: int = 5) -> tuple[Floats, Floats]:
    """Return gusts and rates (W, T, 3) in the first worlds of a seed at places (T, 3) and times (T,) [s]."""
    fields = jax.tree.map(lambda part: part[:worlds], draws(turbulence, seed))
    time = np.broadcast_to(np.asarray(time, float), (len(place),))
    whole = np.floor(time)
    found = series(
        turbulence,
        fields,
        jnp.asarray(place, jnp.float32),
        jnp.asarray(whole, jnp.int32),
        jnp.asarray(time - whole, jnp.float32),
    )
    return tuple(np.asarray(part, np.float64) for part in found)  # type: ignore[return-value]


class Waves(NamedTuple):
    """The waves of a world one by one, in NED and double precision, (M,) or (M, 3).

    Attributes:
        k: wave vectors [rad/m].
        size: complex vectors: the velocity is the real part of size exp(i phase), times a weight.
        rate: (M,) whole numbers, frequency in turns per second times 2^32; times the octave.
        frequency: turns per second, the octave included.
        octave: 2^j of each.
        centre: wavenumber of its weight [rad/m].
        share: variance at its centre over E k.
    """

    k: Floats
    size: Any
    rate: Any
    frequency: Floats
    octave: Any
    centre: Floats
    share: float


def waves(turbulence: DrydenField, field: FieldWaves) -> Waves:
    """Return the waves that a world has drawn."""
    of = modes(turbulence.chains, turbulence.octaves)
    turned = np.array([[float(x) for x in (row.x, row.y, row.z)] for row in field.turned])
    d = float(field.dilation)
    parts: list[tuple[Any, ...]] = []
    for j in range(of.octaves):
        parts.append(
            (
                (2.0**j * of.first[:, :, None] * of.directions * d).reshape(-1, 3) @ turned,
                (of.cosine[j] - 1j * of.sine[j]).reshape(-1, 3) @ turned,
                np.asarray(field.advance).astype(object),
                2.0**j * np.asarray(field.frequency, float),
                np.full(of.first.size, 2**j, object),
                np.repeat(of.centre[j], of.first.shape[1]) * d,
            )
        )
    return Waves(
        *(np.concatenate([part[i] for part in parts]) for i in range(6)), 2.0 * math.log(2.0) / turbulence.chains
    )


def hashed(word: int) -> int:
    """Return fmix32 of MurmurHash3 of a word of 32 bits."""
    word = (word ^ word >> 16) * 0x85EBCA6B % 2**32
    word = (word ^ word >> 13) * 0xC2B2AE35 % 2**32
    return word ^ word >> 16


def chains_at(chains: int, field: FieldWaves, seconds: int, fraction: float) -> tuple[list[int], Floats]:
    """Return the phases of the chains in their present lifetimes, turns times 2^32, and their amplitudes (K,)."""
    phases = [int(phase) for phase in np.asarray(field.phase)]
    if field.ages is None:
        return phases, np.ones(len(phases))
    start, rate = int(field.ages.start), int(field.ages.rate)
    amplitudes = np.zeros(len(phases))
    for number in range(len(phases)):
        segment, chain = divmod(number, chains)
        ahead = (0.0, 0.5, 0.25, 0.75)[chain % 4] + (chain // 4 + segment / 2) / chains
        age = ((start + rate * seconds) % 2**32 + round(ahead * 2**20)) / 2**20 + rate * fraction / 2**20
        lifetime = math.floor(age)
        phases[number] = hashed((phases[number] + 0x9E3779B9 * (lifetime % 4096)) % 2**32)
        amplitudes[number] = math.sqrt(8.0 / 3.0) * math.sin(math.pi * (age - lifetime)) ** 2
    return phases, amplitudes


def reference(
    turbulence: DrydenField, field: FieldWaves, place: Any, seconds: int = 0, fraction: float = 0.0
) -> tuple[Floats, Floats]:
    """Return gusts (n, 3) [m/s] and their gradient (n, 3, 3) [1/s] (component, axis) at places (n, 3), wave by wave.

    The weights' own change with height is left out of the gradient.
    """
    of, place = waves(turbulence, field), np.asarray(place, float)
    scales = mil(-place[:, 2], float(turbulence.speed_20ft), 1750.0 if turbulence.spectrum == "dryden" else 2500.0)
    phases, amplitudes = chains_at(turbulence.chains, field, seconds, fraction)
    octaves = len(of.octave) // len(phases)
    # In whole numbers of any size: exact at any time.
    whole = np.array(
        [
            float(octave * (p - r * seconds) % 2**32)
            for p, r, octave in zip(phases * octaves, of.rate, of.octave, strict=True)
        ]
    )
    phase = 2.0 * np.pi * (whole / 2.0**32 - of.frequency * fraction) + place @ of.k.T
    wave = np.tile(amplitudes, octaves) * np.exp(1j * phase)
    value, slope = np.zeros_like(place), np.zeros((len(place), 3, 3))
    for axis, (length, sigma) in enumerate(
        [(scales.length_h, scales.sigma_h)] * 2 + [(scales.length_w, scales.sigma_w)]
    ):
        energies = np.array([energy(of.centre, float(each), turbulence.spectrum) for each in length])
        weight = sigma[:, None] * np.sqrt(of.share * energies * of.centre)
        part = weight * wave * of.size[:, axis]
        value[:, axis] = part.real.sum(axis=1)
        slope[:, axis] = (1j * part @ of.k).real
    return value, slope


def half_curl(slope: Floats) -> Floats:
    """Return half the curl (n, 3) of gradients (n, 3, 3)."""
    return 0.5 * np.stack(
        [slope[:, 2, 1] - slope[:, 1, 2], slope[:, 0, 2] - slope[:, 2, 0], slope[:, 1, 0] - slope[:, 0, 1]], axis=1
    )
