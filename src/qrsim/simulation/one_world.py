"""One world: start, ticks and placing of vehicles. Its state is two flat buffers."""

from __future__ import annotations

from typing import Any, Literal

import jax
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.engine.backend import Extent, Function, Program, Specialised
from qrsim.engine.layout import Buffers, Packer, Shared, aligned_copy
from qrsim.engine.settings import chosen_compiler
from qrsim.interface.actions import ActionChecker
from qrsim.interface.slots import Slot, slot_of
from qrsim.simulation.placing import place
from qrsim.world import tick as ticks_of
from qrsim.world.state import Action, State, World, WorldKeys

# How a command relates to that of the last call, see ``Simulation.advance``.
Again = Literal["", "same", "renewed"]


def _reset(world: World, own: tuple[object, WorldKeys]) -> State:
    """Return the state at the start of an episode, for the compiler; ``own``: an unused entry, and the world's random
    keys."""
    return ticks_of.reset(world, own[1])


def _tick(world: World, own: tuple[Any, Any], state: State, tick: Any) -> State:
    """Return the state after one tick, for the compiler; ``own``: an unused entry, and the actions and estimates of
    each fleet."""
    return ticks_of.step(world, state, tick, *own[1])


def _place(world: World, own: tuple[Any, Any], state: State, tick: Array) -> State:
    """Return the state with vehicles placed elsewhere, for the compiler; ``own``: an unused entry, and
    ``placing.place``'s ``given``."""
    return place(world, own[1], state, tick)


RESET, TICK, PLACE = Function("start", _reset), Function("tick", _tick), Function("place", _place)


class OneWorld:
    """The programs of one world.

    Args:
        world: the parameters.

    Attributes:
        layout: of the parameters.
        parameters: the same as two flat buffers.
    """

    def __init__(self, world: World):
        shared, compiler = Shared.of(world), chosen_compiler()
        self.layout, self.parameters = shared.layout, shared.buffers
        extent = Extent(sum(fleet.size for fleet in world.fleets), shared.layout.dtype)
        self._reset, self._tick, self._place = (
            Specialised(function, shared, extent, compiler) for function in (RESET, TICK, PLACE)
        )
        self._flown_by: Program | None = None
        self._bound: dict[type, tuple[Program, Slot | None]] = {}
        # The command that is in the inputs of the program that flew last, and what it became; None: it is not known.
        self._held: object = None
        self._given: object = None
        self._leaves: list[NumpyArray] = []

    @property
    def flown_by(self) -> Program:
        """Compiled program that ran the last tick."""
        assert self._flown_by is not None
        return self._flown_by

    def taken(self, command: object, again: Again = "") -> bool:
        """Write a command into the inputs of the program bound to its type, for ``advance_bound``; return False if none
        is bound or the command needs the full check; ``again``: see ``Simulation.advance``."""
        if again and command is not None and command is self._held:
            return again == "same" or self._renewed(command)
        program, slot = self._bound.get(type(command), (None, None))
        if program is None or not (slot is None or slot.take(command)):
            return False
        self._flown_by, self._held = program, None
        return True

    def _renewed(self, command: object) -> bool:
        """Copy the arrays of the held command into the program's inputs; return False if they are not what it reads."""
        if not self._leaves:
            self._leaves = jax.tree.leaves(self._given)
            own = {id(leaf) for leaf in jax.tree.leaves(command)}
            if not all(id(leaf) in own for leaf in self._leaves):
                self._held, self._leaves = None, []
                return False
        self.flown_by.give(self._leaves)
        return True

    def bind(self, command: object, actions: tuple[Action, ...], checker: ActionChecker) -> None:
        """Bind the type of the last flown command to the program that flew it, so that ``taken`` accepts such
        commands; the command itself is held."""
        program = self.flown_by
        # XLA computes in the precision of its context, which ``advance_bound`` does not have.
        self._held = command if program.compiler == "llvm" else None
        if program.slot is None or type(command) in self._bound:
            return
        slot = None if command is None else slot_of(command, actions, program.slot, checker)
        if command is None or slot is not None:
            self._bound[type(command)] = program, slot

    def reset(self, keys: WorldKeys) -> tuple[Packer, Buffers]:
        """Start an episode; return the layout and flat buffers of its first state."""
        program = self._reset.program(keys)
        state: Buffers = program.start()
        layout = program.layout
        assert layout is not None
        return layout, state

    def adopt(self, state: Buffers) -> Buffers:
        """Copy a state's buffers to aligned memory, as ``advance`` needs them."""
        return aligned_copy(state)

    def advance(self, layout: Packer, state: Buffers, tick: int, count: int, given: object) -> Buffers:
        """Run ``count`` ticks by actions and estimates (``given``), and return the new state's buffers; the old ones
        may be overwritten.

        Args:
            layout: of the state.
            state: from ``reset``, ``adopt`` or this method.
            tick: the first one.
            count: ticks.
            given: actions and estimates of each fleet.
        """
        self._flown_by, self._held = self._tick.program(given, layout), None
        self._given, self._leaves = given, []
        after: Buffers = self._flown_by.run(state, tick, count)
        return after

    def advance_bound(self, state: Buffers, tick: int, count: int) -> Buffers:
        """Run ``count`` ticks by the command that ``taken`` wrote last, and return the new state's buffers."""
        assert self._flown_by is not None
        after: Buffers = self._flown_by.run(state, tick, count)
        return after

    def record(
        self, layout: Packer, state: Buffers, tick: int, count: int, given: object, capacity: int
    ) -> tuple[Buffers, Buffers]:
        """Run ``count`` <= ``capacity`` ticks; return the final state's buffers, and all ticks' states, each buffer
        (count, ...)."""
        self._flown_by, self._held = self._tick.program(given, layout), None
        return self._flown_by.record(state, tick, count, capacity)

    def place(self, layout: Packer, state: Buffers, tick: int, given: object) -> Buffers:
        """Place vehicles in other states, and return the new state's buffers; ``given``: as ``placing.place`` takes
        it."""
        after: Buffers = self._place.program(given, layout).run(self.adopt(state), tick, 1)
        return after
