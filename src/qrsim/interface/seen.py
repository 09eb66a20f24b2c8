"""A packed state as users see it: parts of its tree, and arrays by offsets that are computed once.

The buffers of a state are overwritten at every tick, so nothing here returns a view of them. Each array is copied when
it is read; the whole state is copied only if a ``Seen`` of a tick still exists when the next one is about to begin.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import cast

import jax
import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import Floats
from qrsim.core.tree import Record
from qrsim.core.vectors import Euler, Vec3
from qrsim.engine.layout import Buffers, Packer
from qrsim.world.state import FleetState, State, World

Offsets = npt.NDArray[np.intp]
_FIELDS = frozenset(field.name for field in dataclasses.fields(State))


class Leaf:
    """Stand-in for an array of a state. It has no arithmetic, so only functions that select arrays accept it."""

    __slots__ = ("number", "shape")

    def __init__(self, number: int, shape: tuple[int, ...]):
        self.number, self.shape = number, shape


class StateOffsets:
    """Offsets of readings and quantities in a packed state.

    Args:
        world: the parameters of the state's world.
        layout: the layout of the packed state.
    """

    def __init__(self, world: World, layout: Packer):
        self.layout, self._world = layout, world
        self._readings: dict[tuple[int, int], dict[str, Offsets]] = {}
        self._of_vehicles: dict[str, Offsets | None] = {}

    @cached_property
    def _tree(self) -> State:
        """State in which each array is replaced by its number in the buffers and its shape."""
        tree: State = jax.tree.unflatten(
            self.layout.structure, map(Leaf, *zip(*enumerate(self.layout.shapes), strict=True))
        )
        return tree

    @cached_property
    def in_two_parts(self) -> bool:
        """True if positions have a rounding remainder as a second part, as in single precision."""
        return self._tree.fleets[0].position_low_ned is not None

    def of_readings(self, fleet: int, sensor: int) -> Mapping[str, Offsets]:
        """Return field -> indices in the float buffer, for the fields of a sensor's reading that are float arrays."""
        offsets = self._readings.get((fleet, sensor))
        if offsets is None:
            reading: Record = self._tree.fleets[fleet].readings[sensor]
            each = {field.name: self._offsets(getattr(reading, field.name)) for field in dataclasses.fields(reading)}
            offsets = {name: where for name, where in each.items() if where is not None}
            self._readings[fleet, sensor] = offsets
        return offsets

    def of_vehicles(self, name: str, pick: Callable[[World, State, int], object]) -> Offsets | None:
        """Return the indices (n, ...) in the float buffer of a quantity that ``pick`` selects of each fleet; None if it
        is not stored.

        Args:
            name: of the quantity.
            pick: returns the quantity of a fleet from the world, a state and the number of the fleet.
        """
        if name not in self._of_vehicles:
            parts = [self._offsets_of_fleet(pick, number) for number in range(len(self._world.fleets))]
            known = [part for part in parts if part is not None]
            self._of_vehicles[name] = np.concatenate(known) if len(known) == len(parts) else None
        return self._of_vehicles[name]

    def _offsets_of_fleet(self, pick: Callable[[World, State, int], object], fleet: int) -> Offsets | None:
        """Return the indices (n, ...) in the float buffer of the quantity that ``pick`` selects of one fleet; None if
        not stored."""
        try:
            offsets = self._offsets(pick(self._world, self._tree, fleet))
        except Exception:
            # ``pick`` computes with the stand-ins and does not only select them. A component of a user may raise
            # anything then.
            return None
        # One number for all vehicles has no offset for each.
        return None if offsets is None or offsets.shape[:1] != (self._world.fleets[fleet].size,) else offsets

    def _offsets(self, value: object) -> Offsets | None:
        """Return the indices in the float buffer of an array, or of a vector or tuple of arrays stacked; None for
        others."""
        if isinstance(value, Leaf):
            layout, number = self.layout, value.number
            if not layout.is_float[number]:
                return None
            part = layout.slices[number]
            return np.arange(part.start, part.stop, dtype=np.intp).reshape(value.shape)
        if isinstance(value, Vec3 | Euler):
            axes = [self._offsets(axis) for axis in jax.tree.leaves(value)]
            return self._stacked(axes, -1)
        if isinstance(value, tuple) and value:
            return self._stacked([self._offsets(part) for part in value], 1 if isinstance(value[0], Vec3) else -1)
        return None

    @staticmethod
    def _stacked(parts: list[Offsets | None], axis: int) -> Offsets | None:
        """Stack arrays of indices along an axis; return None if any is None."""
        known = [part for part in parts if part is not None]
        return np.stack(known, axis=axis) if len(known) == len(parts) else None


class Part:
    """A tuple, a state or a fleet's state with entries that are unpacked when they are read."""

    def __init__(self, seen: Seen, numbers: State | FleetState | tuple[object, ...]):
        self._seen, self._part = seen, numbers

    def __getattr__(self, name: str) -> object:
        if name.startswith("_"):
            raise AttributeError(name)
        part: object = getattr(self._part, name)
        return self._seen.opened(part)

    @property
    def _each(self) -> tuple[object, ...]:
        """Entries of the wrapped tuple, each unpacked only when used."""
        return cast(tuple[object, ...], self._part)

    def __getitem__(self, number: int) -> object:
        return self._seen.opened(self._each[number])

    def __iter__(self) -> Iterator[object]:
        return map(self._seen.opened, self._each)

    def __len__(self) -> int:
        return len(self._each)


class Seen:
    """A state at one tick. It reads like a ``State``, and its numbers stay those of that tick whatever flies on.

    The owner of the buffers calls ``keep`` before they are overwritten. Another thread may read meanwhile: it reads
    again if the buffers were exchanged during its read, because only then they may have been overwritten.

    Args:
        offsets: of such states.
        buffers: of the state.
    """

    __slots__ = ("__weakref__", "_buffers", "_kept", "_whole", "offsets")

    def __init__(self, offsets: StateOffsets, buffers: Buffers):
        own: tuple[Floats, Floats] = buffers
        self.offsets, self._buffers, self._kept = offsets, own, False
        self._whole: State | None = None

    def keep(self) -> None:
        """Copy the buffers, if that has not been done, so that later ticks cannot change this state."""
        while not self._kept:
            before = self._buffers
            copy = (np.array(before[0]), np.array(before[1]))
            if self._buffers is before:
                self._buffers, self._kept = copy, True

    def at(self, offsets: Offsets) -> Floats:
        """Return the numbers at these indices of the float buffer, in the indices' shape."""
        while True:
            buffers = self._buffers
            found: Floats = buffers[0].take(offsets)
            if self._buffers is buffers:
                return found

    def opened(self, numbers: object) -> object:
        """Return a part of the state as arrays, or, for tuples and states, as a ``Part`` that unpacks on demand;
        ``numbers``: the part with each array replaced by its number."""
        if isinstance(numbers, tuple | State | FleetState):
            return Part(self, numbers)
        part: object = jax.tree.map(self._leaf, numbers)
        return part

    def _leaf(self, number: int) -> Floats:
        """Return a copy of the state's array number ``number``, read again if a tick changed the buffers meanwhile."""
        while True:
            buffers = self._buffers
            found: Floats = np.array(self.offsets.layout.leaf(buffers, number))
            if self._buffers is buffers:
                return found

    def whole(self) -> State:
        """Return the whole state as NumPy arrays."""
        if self._whole is None:
            self.keep()
            self._whole = self.offsets.layout.unpack(self._buffers)
        return self._whole

    def __getattr__(self, name: str) -> object:
        if name not in _FIELDS:
            raise AttributeError(name)
        numbers: State = self.offsets.layout.numbers
        return self.opened(vars(numbers)[name])
