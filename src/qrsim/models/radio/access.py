"""When in a period each vehicle begins to send: what a MAC decides."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw
from qrsim.models.radio.parameters import Mac
from qrsim.models.scene.uniform import uniform


def starts(mac: Mac, air: float, draw: Draw, wants: Array, audible: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return when vehicles (n,) begin to send, in seconds of the period, and who sends at all.

    Args:
        mac: what says so.
        air: time of a packet on the air [s].
        draw: of the period, for each vehicle.
        wants: (n,) who has something to say.
        audible: (K, n) numbers of those whom each vehicle hears well enough to wait, and which of them count.
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
    """Return the same for who listens first, and tries again some time after who was heard has ended.

    All choose a time. Whoever hears somebody who has begun earlier and not ended yet chooses a later one, at random in
    what is left of the period, and so on. Who finds no free time in the end waits for the next period.
    """
    neighbour, hears = audible
    last = max(mac.period - air, 0.0)
    begin = uniform(draw, 0, 0.0, last)
    number = jnp.arange(wants.shape[0], dtype=jnp.int32)

    def busy(begin: Array) -> Array:
        theirs = begin.at[neighbour].get(mode="promise_in_bounds")
        sends = hears & wants.at[neighbour].get(mode="promise_in_bounds")
        # Of two at the very same time, the one of the lower number is heard by the other.
        before = (theirs < begin[None]) | ((theirs == begin[None]) & (neighbour < number[None]))
        return jnp.any(sends & before & (theirs + air > begin[None]), axis=0)

    for attempt in range(1, mac.attempts):
        later = uniform(draw, attempt, jnp.minimum(begin + air, last), jnp.full_like(begin, last))
        begin = jnp.where(busy(begin), later, begin)
    return begin, wants & ~busy(begin)
