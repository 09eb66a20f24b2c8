"""Received packets: those of the last periods in transit, and tables of the newest message of each sender.

Arrays have vehicles along the last axis. Works on arrays of JAX and on NumPy's.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.host import library_of
from qrsim.core.tree import quantity, record

# No message.
NOBODY = -1


@record
class Heard:
    """Messages of E senders at each of n vehicles."""

    payload: Array = quantity(doc="(E, D, n) numbers")
    sender: Array = quantity(doc="(E, n) int32; -1: no message")
    sent: Array = quantity(doc="(E, n) int32 tick at which the message was handed to the sender's radio")
    arrives: Array = quantity(doc="(E, n) int32 tick from which it is known")
    rssi: Array = quantity(unit="dBm", doc="(E, n)")

    @staticmethod
    def nothing(rows: int, size: int, like: Array) -> Heard:
        """Return a table of ``rows`` (E) empty messages with ``size`` (D) numbers each, for vehicles (n,)."""
        none = jnp.full((rows, *like.shape), NOBODY, jnp.int32)
        zero = jnp.zeros((rows, *like.shape), like.dtype)
        return Heard(jnp.zeros((rows, size, *like.shape), like.dtype), none, none, none, zero)

    def known(self, tick: Array) -> Array:
        """Return (E, n) bool: the message in the table has arrived by a tick."""
        return (self.sender != NOBODY) & (self.arrives <= tick)

    def joined(self, other: Heard) -> Heard:
        """Return one table with this table's rows first, then the other's."""
        library = library_of(self.sender)
        return jax.tree.map(lambda a, b: library.concatenate([a, b], axis=0), self, other)


def newest(heard: Heard, counts: Array, size: int) -> Heard:
    """Return the table of each sender's first message, at most ``size`` of them, in rows without gaps.

    Args:
        heard: in order, the newest first.
        counts: (E, n) which of them count.
        size: rows of the result.
    """
    library = library_of(heard.sender)
    rows = heard.sender.shape[0]
    number = library.arange(rows, dtype=library.int32)
    same = (heard.sender[:, None] == heard.sender[None, :]) & counts[:, None]
    earlier = (number[:, None] < number[None, :])[:, :, None]
    keep = counts & ~library.any(same & earlier, axis=0)
    return taken(heard, first_of(keep, size))


def first_of(which: Array, size: int) -> Array:
    """Return the indices (size, n) int32 of the first ``size`` True rows of a mask (E, n); E where there are fewer."""
    library = library_of(which)
    rows = which.shape[0]
    number = library.arange(rows, dtype=library.int32)
    place = library.cumsum(which.astype(library.int32), axis=0, dtype=library.int32)
    wanted = library.arange(1, size + 1, dtype=library.int32)
    return library.min(
        library.where(which[None] & (place[None] == wanted[:, None, None]), number[None, :, None], library.int32(rows)),
        axis=1,
    )


def taken(heard: Heard, chosen: Array) -> Heard:
    """Return the rows with indices ``chosen`` (K, n) of a message table; the index E gives an empty message."""
    library = library_of(heard.sender)
    rows = heard.sender.shape[0]
    there = chosen < rows
    row = library.minimum(chosen, rows - 1)

    vehicle = library.arange(row.shape[1], dtype=library.int32)

    def of(leaf: Array, nothing: int) -> Array:
        """Return the chosen rows (K, n) of one array of the table, ``nothing`` for rows without a message."""
        # Single elements, which both compilers take.
        place: tuple[object, ...]
        if leaf.ndim == 3:
            number = library.arange(leaf.shape[1], dtype=library.int32)[None, :, None]
            place, has = (row[:, None], number, vehicle[None, None]), there[:, None]
        else:
            place, has = (row, vehicle[None]), there
        found = leaf[place] if library is np else leaf.at[place].get(mode="promise_in_bounds")
        return library.where(has, found, library.asarray(nothing, leaf.dtype))

    return Heard(
        of(heard.payload, 0),
        of(heard.sender, NOBODY),
        of(heard.sent, NOBODY),
        of(heard.arrives, NOBODY),
        of(heard.rssi, 0),
    )
