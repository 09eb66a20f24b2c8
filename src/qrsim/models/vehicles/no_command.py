"""Vehicles without commands: points at rest, or carried along a path."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import record
from qrsim.models.vehicles.contracts import Load, Outline, Vehicle


@record
class NoCommand:
    """A record without fields."""


class Uncommanded(Vehicle):
    """Base of points without a drive; their state has a ``heading``."""

    command_type: ClassVar[type] = NoCommand
    actions: ClassVar[tuple[type, ...]] = (NoCommand,)
    default_controller: ClassVar[str] = "none"

    def idle_command(self, like: Array) -> NoCommand:
        """Return the empty command of a vehicle that takes no commands."""
        return NoCommand()

    def clip(self, command: NoCommand, powered: bool = False) -> tuple[NoCommand, Array]:
        """Return the command unchanged, and () False: a command without fields has no limits."""
        return command, jnp.zeros((), bool)

    def load(self, state: Any) -> Load:
        """Return a battery load of NaN: the vehicle has no thrust, and no weight that thrust would carry."""
        nothing = jnp.full_like(state.heading, jnp.nan)
        return Load(nothing, nothing)

    def outline(self) -> Outline:
        """Return the outline of a mast, for pictures."""
        return Outline()
