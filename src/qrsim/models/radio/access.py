"""When in a period each vehicle begins to send: what a MAC decides."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw
from qrsim.models.radio.parameters import Mac
from qrsim.models.scene.uniform import uniform


def starts(mac: Mac, air: float, draw: Draw, wants: Array, audible: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the start (n,) [s] of each vehicle's packet within a radio period, and (n,) bool: it is sent.

    Args:
        mac: the access to the channel.
        air: time of a packet on the air [s].
        draw: of the period, for each vehicle.
        wants: (n,) bool: the vehicle has a packet to send.
        audible: (K, n) numbers of neighbours, and (K, n) bool: the vehicle defers to this one.
    """
    like = draw.like
    if mac.type == "tdma":
        slot = jnp.arange(wants.shape[0], dtype=jnp.int32) % mac.slots
        return slot.astype(like.dtype) * (mac.period / mac.slots), wants
    if mac.type == "aloha":
        return uniform(draw, 0, 0.0, mac.period), wants
    if mac.type == "csma":
        return _listened(mac, air, draw, wants, audible)
    return jnp.zeros(wants.shape, like.dtype), wants


def _listened(mac: Mac, air: float, draw: Draw, wants: Array, audible: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the same as ``starts`` for carrier sensing (CSMA): vehicles wait for audible ones.

    Every vehicle draws a start. One that receives a transmission then draws a later one in the rest of the period.
    After ``mac.attempts`` draws it waits for the next period.
    """
    neighbour, hears = audible
    last = max(mac.period - air, 0.0)
    begin = uniform(draw, 0, 0.0, last)
    number = jnp.arange(wants.shape[0], dtype=jnp.int32)

    def busy(begin: Array) -> Array:
        """Return (n,) bool: an audible vehicle has begun before the time ``begin`` (n,) [s] and still sends."""
        theirs = begin.at[neighbour].get(mode="promise_in_bounds")
        sends = hears & wants.at[neighbour].get(mode="promise_in_bounds")
        # Of two that start at the same time, the lower number is first.
        before = (theirs < begin[None]) | ((theirs == begin[None]) & (neighbour < number[None]))
        return jnp.any(sends & before & (theirs + air > begin[None]), axis=0)

    for attempt in range(1, mac.attempts):
        later = uniform(draw, attempt, jnp.minimum(begin + air, last), jnp.full_like(begin, last))
        begin = jnp.where(busy(begin), later, begin)
    return begin, wants & ~busy(begin)
