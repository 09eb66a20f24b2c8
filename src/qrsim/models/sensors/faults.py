"""Faults of sensors, at given times or by an injection in flight.

A ``Fault`` is part of a scenario: its kind is compiled. A ``FaultSlot`` is compiled without a kind: kind, times and
numbers of each vehicle are data, so that faults begin and end in flight without another compilation. Both change a
reading in the same way, to the bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import jax
import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.fastmath import rounded
from qrsim.core.noise import Draw
from qrsim.core.tree import field_info, map_tree, quantity, record, replace, select, setting
from qrsim.models.sensors.uniforms import uniforms

T = TypeVar("T")
Kind = Literal["off", "stuck", "wrong", "drift", "noisy", "garbage", "slow", "delayed", "intermittent"]
KINDS: tuple[Kind, ...] = get_args(Kind)
# Earlier names, which scenarios may still use.
OLD_NAMES: dict[str, Kind] = {"lost": "off", "frozen": "stuck", "biased": "wrong"}
RANDOM = ("noisy", "garbage", "intermittent")
# Kinds that deliver their last output again.
_REPEATING = ("stuck", "slow")
LAST_TICK = 2**31 - 1


@record
class FaultNumbers:
    """Numbers of a fault, each () for all vehicles or (n,); tuples have an entry for each field of the reading."""

    amounts: tuple[Array, ...] = quantity(
        doc="of each field: offset (wrong), its rate [1/s] (drift), standard deviation (noisy), range of "
        "random values (garbage)"
    )
    scales: tuple[Array, ...] = quantity(doc="of each field: factor; 0 for garbage")
    limit: Array = quantity(doc="largest offset (drift)")
    share: Array = quantity(doc="share of the readings that is lost (intermittent)")
    every: Array = quantity(doc="int32: number of readings of which the first is delivered (slow)")
    readings: Array = quantity(doc="int32: delay in readings (delayed)")
    on_ticks: Array = quantity(doc="int32 ticks with readings (intermittent); 0: by share")
    off_ticks: Array = quantity(doc="int32 ticks without (intermittent)")


@record
class FaultMemory:
    """State of a fault."""

    passed_on: Any = quantity(doc="its output at the tick before; None where its kind needs none")
    came_in: Any = quantity(default=None, doc="the reading that came in last; None where no delay needs it")
    past: tuple[Any, ...] = quantity(default=(), doc="the readings that came in before it, the last one first")


class Late(NamedTuple):
    """The readings of vehicles (n,) at a tick, of a sensor that delivers them later.

    Attributes:
        taken: int32 tick at which each was taken.
        comes: bool, it arrives at this tick.
    """

    taken: Array
    comes: Array


@record
class _Fault:
    """Base of scenario faults and slots, for the n vehicles of a fleet.

    Attributes:
        remembered: number of readings that it keeps, for delays.
    """

    start_tick: Array = quantity(doc="() or (n,) int32 first tick of the fault")
    end_tick: Array = quantity(doc="() or (n,) int32 first tick after it")
    affected: Array = quantity(doc="(n,) bool: vehicles with the fault")
    numbers: FaultNumbers = quantity(doc="how large it is")
    sensor: str = setting(doc="name of the sensor")
    fields: tuple[str, ...] = setting(doc="dotted fields of the reading that amounts and scales are of")
    ticks: int = setting(default=1, doc="ticks between two readings")
    time_step: float = setting(default=0.02, unit="s", doc="of the simulation")
    remembered: int = setting(default=0, doc="readings that it keeps, for delays")
    only: tuple[str, ...] | None = setting(default=None, doc="fields that it changes; None: those with amounts")

    def active(self, tick: Array) -> Array:
        """Return (n,) bool: the fault acts on a vehicle's sensor at a tick."""
        return self.affected & (tick >= self.start_tick) & (tick < self.end_tick)

    def begin(self, reading: T) -> FaultMemory | None:
        """Return the fault's memory at the start, filled with the first reading; None for kinds without memory."""
        if not (self._repeats or self.remembered):
            return None
        return FaultMemory(
            reading if self._repeats else None, reading if self.remembered else None, (reading,) * self.remembered
        )

    @property
    def _repeats(self) -> bool:
        """True if this kind of fault can repeat an earlier reading, so that past ones must be stored."""
        raise NotImplementedError

    def _delivered(
        self,
        reading: T,
        memory: FaultMemory | None,
        tick: Array,
        late: Late | None,
        choose: Callable[[FaultMemory | None], T],
    ) -> tuple[T, FaultMemory | None]:
        """Return the faulty reading from ``choose(memory)``, and the fault's memory with this reading added."""
        if memory is None:
            return choose(None), None
        if memory.past:
            comes = tick % self.ticks == 0 if late is None else late.comes
            older = (memory.came_in, *memory.past[:-1])
            memory = replace(memory, past=tuple(select(comes, *pair) for pair in zip(older, memory.past, strict=True)))
        delivered, came_in = choose(memory), None
        if memory.past:
            # A delayed output is one of the past readings already, so the new reading is kept in its place.
            came_in = select(self.active(tick) & self._is("delayed"), reading, delivered)
        return delivered, FaultMemory(delivered if self._repeats else None, came_in, memory.past)

    @property
    def _order(self) -> int:
        """Number of the fault among its sensor's faults, to keep their random numbers independent."""
        return 0

    # ---- output while it is active ----

    def _is(self, kind: Kind) -> bool | Array:
        """Return whether the fault is of a kind: a Python bool, or (n,) bool in a slot with a kind per vehicle."""
        raise NotImplementedError

    def _output(self, reading: T, memory: FaultMemory | None, tick: Array, draw: Draw | None) -> T:
        """Return the faulty reading at a tick, by kind: changed, delayed, repeated, or NaN if lost."""
        numbers, output = self.numbers, reading
        if memory is not None and self._is("delayed") is not False:
            for number, old in enumerate(memory.past, 1):
                output = select(self._is("delayed") & (numbers.readings >= number), old, output)
        output = self._changed(output, tick, draw)
        if memory is not None and memory.passed_on is not None:
            first = (self.start_tick + (self.ticks - 1)) // self.ticks
            skipped = (tick // self.ticks - first) % jnp.maximum(numbers.every, 1) != 0
            output = select(self._is("stuck") | (self._is("slow") & skipped), memory.passed_on, output)
        lost = self._is("off")
        if self._is("intermittent") is not False:
            whole = numbers.on_ticks + numbers.off_ticks
            timed = (tick - self.start_tick) % jnp.maximum(whole, 1) >= numbers.on_ticks
            chance = uniforms(self._of_reading(draw, tick), 1)[0]
            lost = lost | (self._is("intermittent") & jnp.where(whole > 0, timed, chance < numbers.share))
        return output if lost is False else map_tree(lambda x: jnp.where(lost, jnp.nan, x), output)

    def _changed(self, reading: T, tick: Array, draw: Draw | None) -> T:
        """Return the reading with its fields scaled and offset, for the kinds wrong, drift, noisy and garbage."""
        drift, noisy, garbage = (self._is(kind) for kind in ("drift", "noisy", "garbage"))
        if all(kind is False for kind in (drift, noisy, garbage, self._is("wrong"))):
            return reading
        normals = chances = None
        if noisy is not False:
            normals = self._of_reading(draw, tick).normals(len(self.fields))
        if garbage is not False:
            chances = uniforms(self._of_reading(draw, tick), len(self.fields), 1)
        # A late reading may have been taken before the fault began.
        seconds = rounded(jnp.maximum(tick - self.start_tick, 0).astype(_dtype(reading)) * self.time_step)

        def change(x: Array, i: int) -> Array:
            """Return the values ``x`` of field number ``i``, scaled and offset by the fault."""
            times = _pick(drift, seconds, 1.0)
            if normals is not None:
                times = _pick(noisy, normals[i], times)
            if chances is not None:
                times = _pick(garbage, 2.0 * chances[i] - 1.0, times)
            # Each product is rounded on its own, so that faults and slots agree to the bit in every program.
            added = rounded(self.numbers.amounts[i] * times)
            limit = self.numbers.limit
            added = _pick(drift, jnp.clip(added, -limit, limit), added)
            return rounded(x * self.numbers.scales[i]) + added

        places = {name: i for i, name in enumerate(self.fields) if self.only is None or name in self.only}
        return _at_fields(reading, "", places, change)

    def _of_reading(self, draw: Draw | None, tick: Array) -> Draw:
        """Return the random draw for a reading, the same at all ticks at which that reading is held.

        Faults that begin at different times draw independently, so do scenario faults of different ``order``.
        """
        assert draw is not None
        begun = jnp.asarray(self.start_tick).astype(jnp.uint32)
        stream = replace(draw.stream, high=draw.stream.high ^ begun)
        if self._order:
            stream = replace(stream, low=stream.low ^ jnp.uint32(self._order << 24))
        return replace(draw, stream=stream, tick=(tick - tick % self.ticks).astype(draw.tick.dtype))


@record
class Fault(_Fault):
    """One fault of a scenario, of one sensor of some vehicles during [start, end)."""

    kind: Kind = setting(default="off", doc="kind of the fault")
    order: int = setting(default=0, doc="number among the faults of its kind that begin at the same time")

    @property
    def _order(self) -> int:
        """Number of the fault among its sensor's faults, as given."""
        return self.order

    @property
    def _repeats(self) -> bool:
        """True if this kind of fault can repeat an earlier reading, so that past ones must be stored."""
        return self.kind in _REPEATING

    @property
    def random(self) -> bool:
        """True for kinds of fault that draw random numbers."""
        return self.kind in RANDOM

    def _is(self, kind: Kind) -> bool | Array:
        """Return whether the fault is of a kind, as a Python bool."""
        return self.kind == kind

    def kinds_of(self, count: int) -> list[Kind]:
        """Return the fault's kind for each of ``count`` vehicles: a list with one entry repeated."""
        return [self.kind] * count

    def apply(
        self,
        reading: T,
        memory: FaultMemory | None,
        tick: Array,
        draw: Draw | None = None,
        late: Late | None = None,
    ) -> tuple[T, FaultMemory | None]:
        """Return a sensor's reading with the fault applied at a tick, and the fault's new memory.

        Args:
            reading: of the sensor at ``tick``, or the output of the fault before this one.
            memory: state by ``begin`` or of the tick before.
            tick: () int32 at which the reading is delivered or held.
            draw: random stream of the sensor's faults, if the kind is ``random``.
            late: of a sensor with a delay; None: it delivers at once.
        """
        active = self.active(tick)
        of = tick if late is None else late.taken
        return self._delivered(
            reading,
            memory,
            tick,
            late,
            lambda known: select(active, self._output(reading, known, of, draw), reading),
        )


@record
class FaultSlot(_Fault):
    """Room for one fault of one sensor of each vehicle; its kind is data."""

    kinds: Array = quantity(default=0, doc="(n,) int32: places in KINDS")

    random = True
    _repeats = True

    def _is(self, kind: Kind) -> bool | Array:
        """Return (n,) bool: the fault in the vehicle's slot is of a kind."""
        if kind == "delayed" and not self.remembered:
            return False
        return self.kinds == KINDS.index(kind)

    def kinds_of(self, count: int) -> list[Kind]:
        """Return the kind of fault in the slot of each of ``count`` vehicles."""
        return [KINDS[int(number)] for number in self.kinds]

    def apply(
        self,
        reading: T,
        memory: FaultMemory | None,
        tick: Array,
        draw: Draw | None = None,
        late: Late | None = None,
    ) -> tuple[T, FaultMemory | None]:
        """Return reading and memory as ``Fault.apply`` does, with almost no cost while no vehicle has a fault."""
        active, of = self.active(tick), tick if late is None else late.taken

        def choose(known: FaultMemory | None) -> T:
            """Return the faulty reading, computed only if any vehicle has a fault."""
            output = lambda: select(active, self._output(reading, known, of, draw), reading)  # noqa: E731
            chosen: T = lax.cond(jnp.any(active), output, lambda: reading)
            return chosen

        return self._delivered(reading, memory, tick, late, choose)


def _dtype(reading: object) -> Any:
    """Return the dtype of the first array in a sensor's reading."""
    return jax.tree.leaves(reading)[0].dtype


def _pick(condition: bool | Array, yes: Any, no: Any) -> Any:
    """Return ``yes`` or ``no``, elementwise for an array condition; a Python bool costs no operation."""
    if isinstance(condition, bool):
        return yes if condition else no
    return jnp.where(condition, yes, no)


def _at_fields(item: Any, path: str, places: dict[str, int], change: Callable[[Array, int], Array]) -> Any:
    """Return a record with ``change(values, index)`` applied to fields in ``places``; a tuple's parts share a name."""
    if isinstance(item, tuple):
        return tuple(_at_fields(part, path, places, change) for part in item)
    if item is None:
        return None
    if not dataclasses.is_dataclass(item):
        return change(item, places[path]) if path in places else item
    parts = {
        field.name: _at_fields(getattr(item, field.name), f"{path}.{field.name}".lstrip("."), places, change)
        for field in dataclasses.fields(item)
        if not field_info(field).static
    }
    return replace(item, **parts)
