"""From a link's length to the chance that a packet is lost on it (docs/explanation/models/radio.md).

All shapes of links are allowed. Written without what one of the two compilers does not take, and with the elementary
functions that both compute in vectors.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, log, sincos_turns
from qrsim.core.noise import Draw
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.scene.uniform import uniform

SPEED_OF_LIGHT = 299_792_458.0
# Thermal noise at 290 K [dBm/Hz].
THERMAL = -174.0
_DB = 10.0 / math.log(10.0)


def db(ratio: Array) -> Array:
    """Return a positive power ratio in decibels."""
    return _DB * log(ratio)


def ratio(decibels: Array) -> Array:
    """Return decibels as a power ratio."""
    return exp(decibels * (1.0 / _DB))


def path_loss(squared: Array, frequency_hz: Array, exponent: Array) -> Array:
    """Return the log-distance path loss [dB] for squared distances [m^2]; free space in the first metre.

    Args:
        squared: lengths squared [m^2].
        frequency_hz: of the carrier.
        exponent: 2 is free space.
    """
    first = 2.0 * db(jnp.asarray(4.0 * math.pi / SPEED_OF_LIGHT * frequency_hz))
    # Half of it, because the length is squared.
    return first + 0.5 * exponent * db(jnp.maximum(squared, 1.0))


# Of average land, the height [wavelengths] of an antenna on the ground that has the same loss: 1/(2 pi sqrt(14)/15).
GROUND_WAVELENGTHS = 0.638


def two_ray_loss(squared: Array, frequency_hz: Array, heights: tuple[Array, Array]) -> Array:
    """Return the two-ray path loss [dB] of long links over flat ground, for squared distances [m^2] and heights [m].

    K. Bullington, "Radio propagation at frequencies above 30 megacycles", Proc. IRE 35, 1947: d^4/(h1 h2)^2, with
    heights that are not less than what the ground itself gives, of vertical antennas over land of permittivity 15.

    Args:
        squared: lengths squared [m^2].
        frequency_hz: of the carrier.
        heights: of both ends above the ground [m].
    """
    least = GROUND_WAVELENGTHS * SPEED_OF_LIGHT / frequency_hz
    one, other = (jnp.maximum(height, 0.0) for height in heights)
    together = (one * one + least * least) * (other * other + least * least)
    return 2.0 * db(jnp.maximum(squared, 1.0)) - db(together)


# Of built-up land: a, b of the chance of a line of sight, and what is lost beside free space with one and without [dB].
LANDS = {
    "suburban": (4.88, 0.43, 0.1, 21.0),
    "urban": (9.61, 0.16, 1.0, 20.0),
    "dense_urban": (12.08, 0.11, 1.6, 23.0),
    "high_rise": (27.23, 0.08, 2.3, 34.0),
}


def sight_chance(elevation: Array, land: str) -> Array:
    """Return the probability of a line of sight at an elevation [rad] above built-up land of a kind in ``LANDS``.

    A. Al-Hourani, S. Kandeepan, S. Lardner, "Optimal LAP altitude for maximum coverage", IEEE Wireless Communications
    Letters 3, 2014: 1/(1 + a exp(-b (elevation - a))), in degrees.
    """
    a, b, _, _ = LANDS[land]
    return 1.0 / (1.0 + a * exp(-b * (elevation * (180.0 / math.pi) - a)))


def air_to_ground_loss(squared: Array, frequency_hz: Array, elevation: Array, land: str) -> Array:
    """Return the mean path loss [dB] between ground and air: free space plus shadowing by buildings on the land.

    Args:
        squared: lengths squared [m^2].
        frequency_hz: of the carrier.
        elevation: at which who is on the ground sees the other [rad].
        land: one of LANDS.
    """
    _, _, with_sight, without = LANDS[land]
    chance = sight_chance(elevation, land)
    free = path_loss(squared, frequency_hz, jnp.asarray(2.0, squared.dtype))
    return free + without + (with_sight - without) * chance


def noise_floor(bandwidth_hz: float, noise_figure_db: Array) -> Array:
    """Return the noise power [dBm] of a receiver with a bandwidth [Hz] and a noise figure [dB]."""
    return THERMAL + db(jnp.asarray(bandwidth_hz)) + noise_figure_db


# c of the median noise c - 27.7 lg f [MHz] above thermal noise, by land.
MAN_MADE = {"city": 76.8, "residential": 72.5, "rural": 67.2, "quiet_rural": 53.6}


def with_man_made(noise_figure_db: Array, frequency_mhz: Array, land: str) -> Array:
    """Return the noise figure [dB] of receivers with the man-made noise of a kind of land added; "none" adds nothing.

    Recommendation ITU-R P.372: c - d lg f, d = 27.7, in a quiet rural land 28.6; measured up to 250 MHz.
    """
    if land == "none":
        return noise_figure_db
    slope = 2.86 if land == "quiet_rural" else 2.77
    return db(ratio(noise_figure_db) + ratio(MAN_MADE[land] - slope * db(jnp.asarray(frequency_mhz))))


@record
class ShadowField:
    """Waves that add up to the shadowing of a link over both ends: a function of the two places, without a memory."""

    here: Vec3 = quantity(doc="(M,) wave numbers of one end, in turns per correlation distance")
    there: Vec3 = quantity(doc="(M,) wave numbers of the other end")
    phase: Array = quantity(doc="(M,) phases, in turns")

    @staticmethod
    def drawn(draw: Draw) -> ShadowField:
        """Return a random shadowing field of M waves, one for each id of ``draw``.

        Wave numbers are normals over one common normal (Cauchy in six dimensions), so that the correlation of two links
        whose ends are d apart is exp(-d/correlation distance): Gudmundson, "Correlation model for shadow fading in
        mobile radio systems", Electronics Letters 27, 1991.
        """
        *waves, common = draw.normals(7)
        scale = (0.5 / math.pi) / jnp.maximum(jnp.abs(common), 1e-3)
        turns = [wave * scale for wave in waves]
        return ShadowField(Vec3(*turns[:3]), Vec3(*turns[3:]), uniform(draw, 16))

    def between(self, one: Vec3, other: Vec3, correlation_distance: Array) -> Array:
        """Return the shadowing (...), of unit variance, on links between positions [m], equal in both directions."""
        inverse = 1.0 / correlation_distance
        shape = (-1,) + (1,) * other.x.ndim
        here, there = (end.map(lambda wave: jnp.reshape(wave * inverse, shape)) for end in (self.here, self.there))
        phase = jnp.reshape(self.phase, shape)
        first, second = (end.map(lambda axis: axis[None]) for end in (one, other))
        waves = [sincos_turns((here.dot(a) + phase) + there.dot(b))[1] for a, b in ((first, second), (second, first))]
        return jnp.sum(waves[0] + waves[1], axis=0) * (1.0 / math.sqrt(self.phase.shape[0]))


def complementary_error(x: Array) -> Array:
    """Return the complementary error function erfc(x) for x >= 0, relative error below 1.2e-7.

    Chebyshev fit of W. H. Press et al., "Numerical Recipes", 2nd edition, section 6.2.
    """
    t = 1.0 / (1.0 + 0.5 * x)
    power = jnp.full_like(t, 0.17087277)
    for factor in (
        -0.82215223,
        1.48851587,
        -1.13520398,
        0.27886807,
        -0.18628806,
        0.09678418,
        0.37409196,
        1.00002368,
        -1.26551223,
    ):
        power = power * t + factor
    return t * exp(power - x * x)


def fsk_bit_error(per_bit: Array) -> Array:
    """Return the bit error rate of non-coherent binary FSK for a ratio of energy per bit to noise density."""
    return 0.5 * exp(-0.5 * per_bit)


def bpsk_bit_error(per_bit: Array) -> Array:
    """Return the bit error rate of coherent BPSK for a ratio of energy per bit to noise density."""
    return 0.5 * complementary_error(jnp.sqrt(jnp.maximum(per_bit, 0.0)))


def packet_error(bit_error: Array, bits: float) -> Array:
    """Return the probability that at least one of ``bits`` bits is wrong, for a bit error rate."""
    # What is left of one minus a small number is rounded; its logarithm is not.
    small = -bit_error * (1.0 + bit_error * (0.5 + bit_error * (1.0 / 3.0)))
    kept = jnp.where(bit_error < 0.01, small, log(1.0 - bit_error))
    return 1.0 - exp(bits * kept)


def threshold_error(snr_db: Array, snr50_db: Array, width_db: Array) -> Array:
    """Return the loss probability of a smooth threshold in SNR: 0.5 at ``snr50_db``, steeper for small ``width_db``."""
    return 1.0 / (1.0 + exp((snr_db - snr50_db) / width_db))


def lora_air_time(
    size: int,
    spreading_factor: int,
    bandwidth_hz: float,
    coding_rate: int = 1,
    preamble: int = 8,
    implicit_header: bool = False,
) -> float:
    """Return the time on air [s] of a LoRa packet of ``size`` bytes.

    Semtech, "LoRa modem designer's guide", AN1200.13, section 4: with a check sum, with the low data rate optimisation
    where a symbol lasts longer than 16 ms.
    """
    symbol = 2.0**spreading_factor / bandwidth_hz
    slow = 1 if symbol > 0.016 else 0
    bits = 8 * size - 4 * spreading_factor + 28 + 16 - (20 if implicit_header else 0)
    blocks = max(math.ceil(bits / (4 * (spreading_factor - 2 * slow))), 0)
    return (preamble + 4.25 + 8 + blocks * (coding_rate + 4)) * symbol
