"""Random draws of a world's turbulent field: phases, frequencies and lifetimes of its chains of waves.

A sum of a few hundred permanent waves is a set of tones for a vehicle that hovers. With a lifetime T the
amplitude of each chain goes with sin^2 of half a turn in T. At each zero the chain's phase is replaced by a hash of its
first phase and the number of the lifetime. The field remains a function of place and time, without divergence and with
continuous first derivatives. Chains are staggered evenly, in an order in which groups of four neighbours have the same
variance at any time. In the frame that moves with the field, gusts are uncorrelated after T.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array, lax

from qrsim.core.fastmath import sincos_turns
from qrsim.core.noise import Draw
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.field_modes import SEGMENTS

TURN = 2.0**32
# Ages are counted in 2^-20 lifetimes, in words of 32 bits: hashes repeat after 4096 lifetimes.
AGE_BITS = 20
LIFETIME = 1 << AGE_BITS
# 2^32 over the golden ratio, odd: consecutive lifetimes are far apart for the hash.
_STRIDE = 0x9E3779B9
# sqrt(2/3) (1 - cos(2 pi x)) has a mean square of 1.
_AMPLITUDE = math.sqrt(2.0 / 3.0)


@record
class Ages:
    """Ages of the lifetimes of a world at time 0, and the rate at which they grow."""

    start: Array = quantity(unit="1", doc="() uint32: lifetimes times 2^20")
    rate: Array = quantity(unit="1/s", doc="() uint32: lifetimes a second times 2^20")


@record
class FieldWaves:
    """Random draws of a world's field, once an episode: K chains of waves, and the rotation of all waves."""

    phase: Array = quantity(unit="1", doc="(K,) uint32: first of each chain at the origin at time 0, turns times 2^32")
    advance: Array = quantity(unit="1", doc="(K,) uint32: frequency, turns per second times 2^32, whole turns left out")
    frequency: Array = quantity(unit="1/s", doc="(K,) turns per second, whole turns included")
    turned: tuple[Vec3, Vec3, Vec3] = quantity(unit="1", doc="rows of the rotation or reflection from NED to the waves")
    handedness: Array = quantity(unit="1", doc="() determinant of ``turned``, 1 or -1")
    dilation: Array = quantity(unit="1", doc="() what wavenumbers are multiplied by")
    ages: Ages | None = quantity(default=None, doc="progress of the waves' lifetimes; None: waves are permanent")


def whole_turns(frequency: Array) -> Array:
    """Return frequencies [1/s], any shape, less whole turns, as uint32 in units of 2^-32 turns per second."""
    # To take the nearest whole number off is exact, and so is the product.
    part = jnp.round((frequency - jnp.round(frequency)) * TURN)
    signed = jnp.where(part >= 0.5 * TURN, part - TURN, part).astype(jnp.int32)
    return lax.bitcast_convert_type(signed, jnp.uint32)


def waves_at(field: FieldWaves, seconds: Array, fraction: Array) -> tuple[Array, Array | None]:
    """Return the phases (K,) [turns] of all K wave chains at the origin at a time, and amplitudes (K,), None for 1.

    Whole seconds are multiplied modulo 2^32, exactly; the fraction is multiplied by the whole frequency.
    """
    phase, amplitude = field.phase, None
    if field.ages is not None:
        phase, amplitude = lived(field.ages, phase, field.frequency, seconds, fraction)
    whole = phase - field.advance * seconds.astype(jnp.uint32)
    signed = lax.bitcast_convert_type(whole, jnp.int32).astype(field.frequency.dtype)
    return signed * (1.0 / TURN) - field.frequency * fraction, amplitude


def draw_ages(draw: Draw, index: int, lifetime: Array) -> Ages:
    """Return the random ages at time 0 of waves with a lifetime () [s], from draw number ``index``."""
    rate = jnp.round(float(LIFETIME) / lifetime).astype(jnp.int32)
    return Ages(draw.stream.words(draw.tick, index)[0][0], lax.bitcast_convert_type(rate, jnp.uint32))


def stagger(chains: int) -> npt.NDArray[np.uint32]:
    """Return the age offset (SEGMENTS * chains,) uint32 of each chain in 2^-20 lifetimes; ``chains``: multiple of 4."""
    number = np.arange(chains)
    share = np.array([0, 2, 1, 3])[number % 4] / 4.0 + (number // 4) / chains
    every = [share + segment / (SEGMENTS * chains) for segment in range(SEGMENTS)]
    return np.round(np.concatenate(every) * LIFETIME).astype(np.uint32)


def lived(ages: Ages, phase: Array, like: Array, seconds: Array, fraction: Array) -> tuple[Array, Array]:
    """Return each chain's phase (K,) uint32 in its present lifetime, and its amplitude (K,) relative to the rms.

    Args:
        ages: of the world.
        phase: (K,) uint32, first phases.
        like: (K,) of the run's precision.
        seconds, fraction: () time in whole seconds, int32, and the rest.
    """
    at = ages.start + ages.rate * seconds.astype(jnp.uint32) + jnp.asarray(stagger(phase.size // SEGMENTS))
    part = (at & np.uint32(LIFETIME - 1)).astype(jnp.int32).astype(like.dtype)
    part = part + ages.rate.astype(jnp.int32).astype(part.dtype) * fraction
    over = part >= float(LIFETIME)
    # The number wraps as the age does.
    number = ((at >> np.uint32(AGE_BITS)) + over.astype(jnp.uint32)) & np.uint32(2 ** (32 - AGE_BITS) - 1)
    part = jnp.where(over, part - float(LIFETIME), part)
    _, cosine = sincos_turns(part * (1.0 / LIFETIME))
    return mixed(phase + number * np.uint32(_STRIDE)), _AMPLITUDE * (1.0 - cosine)


def mixed(word: Array) -> Array:
    """Return a hash of uint32 words of any shape, one to one: the last step of MurmurHash3 (A. Appleby)."""
    word = (word ^ (word >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    word = (word ^ (word >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    return word ^ (word >> np.uint32(16))
