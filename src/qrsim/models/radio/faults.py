"""Faults of radios at given times."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.tree import parameter, quantity, record, record_of

LAST_TICK = 2**31 - 1


@record
class RadioFault:
    """A radio that is off, or that loses more packets than it should, of some vehicles (n,) of a fleet."""

    start_tick: Array = quantity(doc="() or (n,) int32 first tick of the fault")
    end_tick: Array = quantity(doc="() or (n,) int32 first tick after it")
    affected: Array = quantity(doc="(n,) bool: the vehicles it concerns")
    off: Array = quantity(doc="() or (n,) bool: it sends and receives nothing")
    share: Array = parameter(
        unit="1", doc="part of the packets, sent and received, that is lost in addition", minimum=0.0, maximum=1.0
    )

    @staticmethod
    def empty(count: int) -> RadioFault:
        """Return a fault record for the radios of ``count`` vehicles that affects none of them."""
        never, nobody = np.full(count, LAST_TICK, np.int32), np.zeros(count, bool)
        return record_of(RadioFault, never, never, nobody, nobody, np.zeros(count))

    def at(self, tick: Array) -> tuple[Array, Array]:
        """Return (n,) bool: the radio is off at a tick, and the share (n,) of packets that it loses."""
        acts = self.affected & (tick >= self.start_tick) & (tick < self.end_tick)
        return acts & self.off, jnp.where(acts & ~jnp.asarray(self.off), self.share, 0.0)
