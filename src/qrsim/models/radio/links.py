"""The links of one period: how strong, and what becomes of the packet on each."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.neighbours import Neighbours
from qrsim.core.tree import quantity, record
from qrsim.models.radio.channel import Channel
from qrsim.models.radio.contracts import Surfaces
from qrsim.models.radio.propagation import (
    ShadowField,
    air_to_ground_loss,
    bpsk_bit_error,
    db,
    fsk_bit_error,
    packet_error,
    path_loss,
    ratio,
    threshold_error,
    two_ray_loss,
)
from qrsim.models.scene.rays import walls_between

# As many obstacles in the way count as one has to go around.
_MOST_WALLS = 2
# A packet that would be lost with more than this probability without interference is out of range.
OUT_OF_RANGE = 0.9
# Power in place of zero [mW]: far below all noise, and a normal number for both compilers.
_NOTHING = 1e-30


class Outcome:
    """Outcome of a packet at a receiver."""

    NOTHING, HEARD, WEAK, NOISE, COLLISION = range(5)


@record
class Links:
    """The links of the last period to each vehicle (n,), from the nearest first (K)."""

    sender: Array = quantity(doc="(K, n) int32 number of the sender; -1: none")
    rssi: Array = quantity(unit="dBm", doc="(K, n)")
    error: Array = quantity(unit="", doc="(K, n) chance that the packet is lost without interference")
    outcome: Array = quantity(doc="(K, n) int32 what became of the packet, see Outcome")

    @staticmethod
    def nothing(rows: int, like: Array) -> Links:
        """Return a table of ``rows`` empty links for each vehicle (n,), in the dtype of ``like``."""
        zero = jnp.zeros((rows, *like.shape), like.dtype)
        none = jnp.full((rows, *like.shape), -1, jnp.int32)
        return Links(none, zero, zero, jnp.zeros_like(none))


def powers(network: Channel, field: ShadowField, near: Neighbours, surfaces: Surfaces) -> Array:
    """Return the power (K, n) [dBm] that each vehicle would receive from each of its K neighbours."""
    way = network.path_loss
    there = jnp.maximum(near.index, 0)
    here = surfaces.position_ned.map(lambda axis: jnp.broadcast_to(axis[None], there.shape))
    other = surfaces.position_ned.map(lambda axis: axis.at[there].get(mode="promise_in_bounds"))
    squared = jnp.where(near.index >= 0, near.squared, 1.0)
    power, gain = network.power_dbm + network.gain_db, network.gain_db
    if network.own is not None:
        own = network.own
        sent = own.power(network.power_dbm) + own.gain(network.gain_db)
        power = sent.at[there].get(mode="promise_in_bounds")
        gain = own.gain(network.gain_db)[None]
    lost = path_loss(squared, 1e6 * network.frequency_mhz, way.exponent)
    if way.ground == "two_ray" and surfaces.height is not None:
        ends = (surfaces.height.at[there].get(mode="promise_in_bounds"), surfaces.height[None])
        lost = jnp.maximum(lost, two_ray_loss(squared, 1e6 * network.frequency_mhz, ends))
    if way.air_to_ground != "none":
        lost = _over_land(network, near, surfaces, squared, other.z - here.z, lost)
    shadow = way.shadowing_db * field.between(here, other, way.correlation_distance)
    received = power + gain - lost - shadow
    if surfaces.obstacles is not None:
        walls = jnp.minimum(walls_between(surfaces.obstacles, other, here), _MOST_WALLS)
        received = received - way.blocked_db * walls.astype(received.dtype)
    return received


def _over_land(
    network: Channel, near: Neighbours, surfaces: Surfaces, squared: Array, apart: Array, lost: Array
) -> Array:
    """Return the path loss (K, n) [dB]: by land use between ground and air, ``lost`` for other links.

    Args:
        network: the radio.
        near: the neighbours of each vehicle.
        surfaces: with heights above the ground.
        squared: (K, n) lengths squared [m^2].
        apart: (K, n) heights of one end above the other [m].
        lost: (K, n) path loss of links that the land does not change [dB].
    """
    way = network.path_loss
    assert surfaces.height is not None
    low = surfaces.height <= way.ground_height
    other = low.at[jnp.maximum(near.index, 0)].get(mode="promise_in_bounds")
    upright = jnp.abs(apart)
    elevation = jnp.arctan2(upright, jnp.sqrt(jnp.maximum(squared - upright * upright, 0.0)))
    over = air_to_ground_loss(squared, 1e6 * network.frequency_mhz, elevation, way.air_to_ground)
    return jnp.where(low[None] != other, over, lost)


def outcomes(
    network: Channel, near: Neighbours, power: Array, begin: Array, sends: Array, to: Array, chance: Array
) -> Links:
    """Return the links (K, n) of a radio period from each vehicle's K neighbours, with each packet's outcome.

    Args:
        network: the radio.
        near: who is near each vehicle.
        power: (K, n) [dBm] at which it receives them.
        begin: (n,) when each vehicle begins to send [s].
        sends: (n,) whether it does.
        to: (n,) who alone is to hear it; -1: all.
        chance: (K, n) a uniform number for each packet.
    """
    packet = network.packet
    there = jnp.maximum(near.index, 0)
    comes = (near.index >= 0) & sends.at[there].get(mode="promise_in_bounds")
    floor = jnp.broadcast_to(network.noise_dbm, begin.shape)
    alone = error_rate(network, power - floor[None], near.squared)
    lost, collides = alone, jnp.zeros(comes.shape, bool)
    if network.mac.type != "ideal":
        others, deaf = _disturbance(network, power, begin, sends, there, comes)
        below = jnp.maximum(others, _NOTHING)
        disturbed = others > _NOTHING
        captured = power - db(below) >= packet.capture_db
        both = db(jnp.maximum(ratio(floor)[None] + others, _NOTHING))
        lost = jnp.where(disturbed, error_rate(network, power - both, near.squared), alone)
        collides = deaf | (disturbed & ~captured)
    receiver = to.at[there].get(mode="promise_in_bounds")
    itself = jnp.arange(begin.shape[0], dtype=jnp.int32)[None]
    # Others neither hear a packet for one vehicle nor miss it.
    meant = comes & ((receiver < 0) | (receiver == itself))
    missed = chance <= lost
    outcome = jnp.where(missed, jnp.where(alone > OUT_OF_RANGE, Outcome.WEAK, Outcome.NOISE), Outcome.HEARD)
    # What would have come through alone is lost to the others.
    by_others = collides | (missed & ~(chance <= alone))
    outcome = jnp.where(by_others & ~(alone > OUT_OF_RANGE), Outcome.COLLISION, outcome)
    return Links(
        sender=jnp.where(comes, near.index, -1),
        rssi=jnp.where(comes, power, 0.0),
        error=jnp.where(comes, alone, 0.0),
        outcome=jnp.where(meant, outcome, Outcome.NOTHING).astype(jnp.int32),
    )


def error_rate(network: Channel, snr_db: Array, squared: Array) -> Array:
    """Return the probability that a packet is lost, by signal-to-noise ratio [dB] or squared distance [m^2]."""
    packet = network.packet
    bits = 8.0 * packet.bytes
    if packet.model == "threshold":
        return threshold_error(snr_db, packet.snr50_db, packet.width_db)
    if packet.model == "probability":
        return jnp.where(squared <= packet.range * packet.range, 1.0 - packet.probability, 1.0)
    per_bit = ratio(snr_db) * (network.bandwidth_khz / network.rate_kbps)
    bit_error = fsk_bit_error if packet.model == "fsk" else bpsk_bit_error
    return packet_error(bit_error(per_bit), bits)


def _disturbance(
    network: Channel, power: Array, begin: Array, sends: Array, there: Array, comes: Array
) -> tuple[Array, Array]:
    """Return the interfering power (K, n) [mW] during each packet, and (K, n) bool: its receiver sends meanwhile."""
    air, period = network.air_time, network.mac.period
    theirs = begin.at[there].get(mode="promise_in_bounds")

    def together(one: Array, other: Array) -> Array:
        """Return whether packets that begin at these times [s] overlap."""
        apart = jnp.abs(one - other)
        # What goes on at the end of a period disturbs the beginning of the next, which is as any other.
        apart = jnp.minimum(apart, period - apart) if network.mac.type == "aloha" else apart
        # Slots that follow each other may touch.
        return apart < air - 1e-6

    strength = jnp.where(comes, ratio(power), 0.0)
    row = jnp.arange(there.shape[0], dtype=jnp.int32)
    other = row[:, None, None] != row[None, :, None]
    at_once = together(theirs[:, None], theirs[None, :]) & other
    total = jnp.sum(jnp.where(at_once, strength[:, None], 0.0), axis=0)
    return total, sends[None] & together(theirs, begin[None])
