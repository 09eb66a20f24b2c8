"""A block of worlds in flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.engine.backend import Extent, Function, Worlds
from qrsim.interface.metrics import FLIGHT_METRICS
from qrsim.simulation.block_parts import Carry, Setup, begin_world, tick_of_world
from qrsim.world.state import WorldKeys


class Flight(Worlds):
    """Some worlds between two ticks, each with its Carry.

    Args:
        setup: what the rollout is made of.
        fixed: leaves of the World that all worlds share.
        own: leaves (B, ...) that they do not.
        keys: of all randomness, each leaf (B, ...).
        vehicles: of one world.
        devices: that B is a multiple of.
    """

    def __init__(
        self, setup: Setup, fixed: list[NumpyArray], own: list[NumpyArray], keys: WorldKeys, vehicles: int, devices: int
    ):
        count = len(jax.tree.leaves(keys)[0])
        dtype = next((leaf.dtype for leaf in [*fixed, *own] if leaf.dtype.kind == "f"), np.dtype(np.float32))
        extent = Extent(vehicles, np.dtype(dtype), count, devices, setup.mesh)
        super().__init__(begin_function(setup), _function("advance", _tick, setup), fixed, extent, own)
        self.begin(keys)


def begin_function(setup: Setup) -> Function:
    """Return the function that starts one world, in the form that the compiler maps over many worlds."""
    return _function("begin", _begin, setup)


def _begin(setup: Setup, fixed: Sequence[object], own: tuple[list[object], WorldKeys]) -> Carry:
    """Return one world's state before its first tick, for the compiler; ``own``: the world's varying arrays and random
    keys."""
    return begin_world(setup, fixed, own[1], own[0])


def _tick(setup: Setup, fixed: Sequence[object], own: tuple[list[Any], Any], carry: Carry, tick: object) -> Carry:
    """Return one world's state and memories after one tick, for the compiler; ``own``: its varying arrays, and
    host-computed actions."""
    return tick_of_world(setup, fixed, own[0], carry, tick, own[1])


def _function(name: str, call: Callable[..., object], setup: Setup) -> Function:
    """Return a function of one world (``call``) for the compiler, with the key of its compiled program."""
    # Only setups of this package's own code can be identified by their structure in another process.
    measured = () if setup.metrics is FLIGHT_METRICS else (type(setup.metrics).__name__,)
    text = (setup.types, setup.varied, *measured) if setup.plain else None
    return Function(name, partial(call, setup), setup.key, text)
