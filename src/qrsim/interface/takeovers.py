"""When and where failsafes took over, in the metrics of a rollout."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.tree import quantity, record, replace, select
from qrsim.core.vectors import Vec3
from qrsim.world.state import State


@record
class Takeovers:
    """The first action of a failsafe of n vehicles, and the gravest one, each (n,)."""

    action: Array = quantity(doc="int32 gravest action, an index of failsafes.ACTIONS")
    tick: Array = quantity(doc="int32 tick of the first one, -1 before it")
    position_ned: Vec3 = quantity(unit="m", doc="true position then, NaN before it")

    @staticmethod
    def none(state: State, like: Array) -> Takeovers | None:
        """Return empty records of failsafes at a flight's start, shaped as ``like`` (n,); None if no fleet has
        failsafes."""
        if _actions(state) is None:
            return None
        count, nowhere = jnp.zeros(like.shape, jnp.int32), jnp.full_like(like, jnp.nan)
        return Takeovers(count, jnp.full_like(count, -1), Vec3(nowhere, nowhere, nowhere))

    def update(self, state: State, tick: Array, position_ned: Vec3, flying: Array) -> Takeovers:
        """Return the records updated by a tick, for the vehicles marked in ``flying`` (n,) bool."""
        actions = _actions(state)
        assert actions is not None
        actions = jnp.where(flying, actions, 0)
        begins = (self.tick < 0) & (actions > 0)
        return replace(
            self,
            action=jnp.maximum(self.action, actions),
            tick=jnp.where(begins, tick, self.tick),
            position_ned=select(begins, position_ned, self.position_ned),
        )


def takeover_metrics(found: Takeovers | None, like: Floats, dt: float) -> dict[str, Floats]:
    """Convert the records of failsafes (``found``) to metrics by name, each (W, n) as ``like``; NaN and 0 where none
    took over."""
    shape = np.shape(like)
    if found is None:
        nothing = np.full(shape, np.nan)
        return {
            "failsafe_action": np.zeros(shape),
            "failsafe_at_s": nothing,
            "failsafe_position_ned": np.full((*shape, 3), np.nan),
        }
    tick = np.asarray(found.tick)
    return {
        "failsafe_action": np.asarray(found.action),
        "failsafe_at_s": np.where(tick >= 0, tick * dt, np.nan),
        "failsafe_position_ned": np.stack(jax.tree.leaves(found.position_ned), axis=-1),
    }


def _actions(state: State) -> Array | None:
    """Return the number of each vehicle's failsafe action (n,), 0 without one; None if no fleet has failsafes."""
    if all(fleet.failsafe is None for fleet in state.fleets):
        return None
    return jnp.concatenate(
        [
            jnp.zeros_like(fleet.violation.code) if fleet.failsafe is None else fleet.failsafe.action
            for fleet in state.fleets
        ]
    )
