"""Sensor faults at given times: readings are lost, frozen or biased."""

from __future__ import annotations

from typing import Any, Literal, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import parameter, quantity, record, replace, setting

T = TypeVar("T")
Kind = Literal["lost", "frozen", "biased"]


@record
class Fault:
    """One fault of one sensor of some vehicles (n,) of a fleet during [start, end)."""

    start_tick: Array = quantity(doc="() int32 first tick of the fault")
    end_tick: Array = quantity(doc="() int32 first tick after it")
    affected: Array = quantity(doc="(n,) bool: the vehicles it concerns")
    bias: Array = parameter(unit="that of the field", doc="what is added, for kind biased")
    sensor: str = setting(doc="name of the sensor")
    kind: Kind = setting(doc="what happens to its readings")
    field: str = setting(doc="dotted field of the reading, for kind biased")

    def active(self, tick: Array) -> Array:
        """Return whether the fault concerns each vehicle (n,) at a tick."""
        return self.affected & (tick >= self.start_tick) & (tick < self.end_tick)

    @property
    def remembers(self) -> bool:
        """Whether it needs its output of the tick before."""
        return self.kind == "frozen"

    def apply(self, reading: T, passed_on: T, tick: Array) -> T:
        """Return its output: for the next fault of the sensor, or for the user.

        Args:
            reading: what the sensor says at ``tick``, or what the fault before this one passes on.
            passed_on: what this fault passed on at the tick before, where it ``remembers``.
            tick: () int32.
        """
        active = self.active(tick)
        if self.kind == "lost":
            return jax.tree.map(lambda leaf: jnp.where(active, jnp.nan, leaf), reading)
        if self.kind == "frozen":
            return jax.tree.map(lambda leaf, old: jnp.where(active, old, leaf), reading, passed_on)
        return _add(reading, self.field.split("."), jnp.where(active, self.bias, 0.0))


def _add(item: Any, path: list[str], amount: Array) -> Any:
    """Return a record with an amount added to one of its leaves, or to those of each part of a tuple."""
    if isinstance(item, tuple):
        return tuple(_add(part, path, amount) for part in item)
    if item is None:
        return None
    if not path:
        return item + amount
    return replace(item, **{path[0]: _add(getattr(item, path[0]), path[1:], amount)})
