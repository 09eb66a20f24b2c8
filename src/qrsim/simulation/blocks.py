"""A rollout block by block, from start to end, with records on the way."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.noise import Key
from qrsim.engine.backend import state_bytes
from qrsim.engine.layout import Packer, layout_of_each
from qrsim.engine.settings import threads, uses_llvm
from qrsim.errors import UsageError
from qrsim.interface.actions import ActionChecker
from qrsim.interface.mission_metrics import MissionMetrics
from qrsim.interface.policies import UserFunction
from qrsim.interface.readings import Reading
from qrsim.simulation.block_parts import Carry, Setup
from qrsim.simulation.many_worlds import Flight, begin_function
from qrsim.world.draws import keys_of
from qrsim.world.episode import refuse_unplaced
from qrsim.world.state import State, World

# Largest number of ticks in one call of a program: progress is reported between calls.
TICKS_PER_CALL = 500
# Fields of a state, and of a fleet's state, that readings use.
_TOLD = ("sky", "sky_keys")
_TOLD_OF_FLEETS = ("readings", "violation", "passed_on", "fitted", "estimate", "belief")


@dataclass(frozen=True)
class Schedule:
    """Length of the flight and ticks of records; record_every 0: no records."""

    ticks: int
    record_every: int

    @property
    def records(self) -> list[int]:
        """Ticks at which states are recorded, the start included."""
        return list(range(0, self.ticks + 1, self.record_every)) if self.record_every else []

    def stops(self, asked_every: int) -> list[int]:
        """Return the ticks after which the compiled loop returns to the host; ``asked_every``: period of lock-step
        functions, or 0."""
        found = {self.ticks, *self.records}
        for period in (TICKS_PER_CALL, asked_every):
            if period:
                found |= set(range(period, self.ticks, period))
        return sorted(found - {0})


class Engine:
    """Flies the worlds of a rollout, block after block.

    Args:
        setup: structure of the rollout.
        example: one of the worlds.
        fixed: leaves that are equal in all worlds.
        varied: leaves (W, ...) that vary.
        schedule: number of ticks, and the ticks that are recorded.
        record: returns the part of a state that is recorded; None: nothing is.
        sink: called with each record; None: records are kept.
        progress: called with the number of world-ticks done.
    """

    def __init__(
        self,
        setup: Setup,
        example: World,
        fixed: list[Any],
        varied: list[Any],
        schedule: Schedule,
        record: Callable[[State], Any] | None,
        sink: Callable[[NumpyArray, int, Any], None] | None,
        progress: Callable[[int], None],
    ):
        self.setup, self.example, self.fixed, self.varied = setup, example, fixed, varied
        self.schedule, self.record, self.sink, self.progress = schedule, record, sink, progress
        self.names = [name for fleet in example.fleets for name in fleet.vehicle_names]
        self.devices = threads() if uses_llvm() else 1 if setup.mesh is None else setup.mesh.size
        self.checker = ActionChecker(example, np.dtype(example.fleets[0].start.position_ned.x.dtype), "finite")

    def bytes_per_world(self) -> int:
        """Return the size [bytes] of the state that one world carries from tick to tick."""
        keys = jax.tree.map(lambda leaf: np.asarray(leaf)[None], keys_of(self.example, Key.root(0)))
        fixed = Packer([np.asarray(leaf) for leaf in self.fixed])
        return state_bytes(begin_function(self.setup.compiled), fixed, layout_of_each((self.varied, keys)))

    def fly(self, rows: NumpyArray, seeds: NumpyArray, numbers: NumpyArray) -> tuple[dict[str, NumpyArray], Any]:
        """Fly the worlds ``rows`` (B,) from their start; return the metrics and records of the distinct ones."""
        real = len(np.unique(rows))
        own = [part[rows] for part in self.varied]
        # On the host: in the program, the keys' own rounds would be compiled into everything that draws.
        keys = keys_of(self.example, Key.roots(seeds[rows], numbers[rows]))
        flight = Flight(self.setup.compiled, self.fixed, own, keys, len(self.names), self.devices)
        placed = jax.tree.map(np.asarray, flight.get(lambda carry: carry.state.placed))
        refuse_unplaced(self.example, placed)
        lock_step = LockStep(self, rows[:real])
        found: list[object] = []
        self._keep(flight, 0, rows[:real], found)
        tick = 0
        for after in self.schedule.stops(lock_step.asked_every):
            given = lock_step.ask(flight, tick, len(rows))
            flight.advance(tick, after - tick, given)
            if self.setup.policy is not None:
                self._refuse(np.asarray(flight.get(lambda carry: carry.wrong_tick)), rows)
            self._keep(flight, after, rows[:real], found)
            self.progress(real * (after - tick))
            tick = after
            if self._ended(flight):
                self.progress(real * (self.schedule.ticks - tick))
                found += found[-1:] * (len(self.schedule.records) - len(found))
                break
        metrics, state = jax.tree.map(
            lambda leaf: np.asarray(leaf)[:real], flight.get(lambda carry: (carry.flight, carry.state))
        )
        recorded = jax.tree.map(lambda *parts: np.stack(parts, axis=1), *found) if found else None
        return self.setup.metrics.finish(metrics, self.example, state), recorded

    def _ended(self, flight: Flight) -> bool:
        """Return whether metrics say that every world of the block has ended; only metrics of missions ever do."""
        metrics = self.setup.metrics
        if not isinstance(metrics, MissionMetrics):
            return False
        return bool(np.all(flight.get(lambda carry: metrics.ended(carry.flight))))

    def _keep(self, flight: Flight, tick: int, rows: NumpyArray, found: list[object]) -> None:
        """At ticks with a record due, append the record to ``found``, or pass it to the user's sink."""
        if self.record is None or tick % self.schedule.record_every:
            return
        found_now = flight.map(self.record, lambda carry: carry.state)
        recorded = jax.tree.map(lambda leaf: np.asarray(leaf)[: len(rows)], found_now)
        if self.sink is None:
            found.append(recorded)
        else:
            self.sink(rows, tick, recorded)

    def _refuse(self, wrong_tick: NumpyArray, rows: NumpyArray) -> None:
        """Raise UsageError for the first vehicle whose policy returned a command that is not finite; ``wrong_tick``:
        when, or -1."""
        if (wrong_tick < 0).all():
            return
        world, vehicle = np.argwhere(wrong_tick >= 0)[0]
        assert self.setup.policy is not None
        raise UsageError(
            f"policy {self.setup.policy.name}: what it asks of vehicle {vehicle} ('{self.names[vehicle]}') is not "
            f"finite at tick {wrong_tick[world, vehicle]} of world {rows[world]}"
        )


class LateRadio:
    """State of the radios of all worlds at a tick, fetched only if a user's function reads an inbox.

    Args:
        fetch: returns it, leaves (W, ...); it can be called until the next tick.

    Attributes:
        over: whether the tick is over, so that the state can no longer be fetched.
    """

    def __init__(self, fetch: Callable[[], Any]):
        self._fetch, self._host = fetch, None
        self.over = False

    def of(self, world: int) -> Any:
        """Return the radio state of one world, copied to the host on first use; raises UsageError if the tick is
        over."""
        if self._host is None:
            if self.over:
                raise UsageError(
                    "inbox: this reading is of an earlier tick, at which its inbox was not looked at; keep what you "
                    "need of reading.inbox in place of the reading"
                )
            self._host = jax.tree.map(np.asarray, self._fetch())
        return jax.tree.map(lambda leaf: leaf[world], self._host)


class _LazyTuple(Sequence[object]):
    """A tuple of one world, from leaves (W, ...) of all worlds; an entry is sliced when it is read."""

    def __init__(self, parts: Sequence[object], world: int):
        self._parts, self._world = parts, world

    def __len__(self) -> int:
        return len(self._parts)

    def __getitem__(self, number: Any) -> Any:
        return jax.tree.map(lambda leaf: leaf[self._world], self._parts[number])


class _LazyParts:
    """Parts of one world by name, from leaves (W, ...) of all worlds; a part is sliced when it is read."""

    def __init__(self, parts: Mapping[str, object], world: int):
        self._parts, self._world = parts, world

    def __getattr__(self, name: str) -> object:
        if name.startswith("_") or name not in self._parts:
            raise AttributeError(name)
        part = self._parts[name]
        found: object
        if isinstance(part, tuple) and type(part) is tuple:
            found = _LazyTuple(part, self._world)
        else:
            found = jax.tree.map(lambda leaf: leaf[self._world], part)
        setattr(self, name, found)
        return found


class _LazyState(_LazyParts):
    """The parts of one world's state that a ``Reading`` uses."""

    def __init__(
        self, parts: Mapping[str, object], fleets: Sequence[Mapping[str, object]], radios: LateRadio, world: int
    ):
        super().__init__(parts, world)
        self.fleets = [_LazyParts(fleet, world) for fleet in fleets]
        self._radios = radios

    @property
    def radio(self) -> Any:
        """Radio state of this world, copied to the host on first use."""
        return self._radios.of(self._world)


class LockStep:
    """Calls the user's functions that are not compiled between ticks, world by world, each with its own memory."""

    def __init__(self, engine: Engine, rows: NumpyArray):
        self.engine, self.rows = engine, rows
        setup = engine.setup
        self.policy, self.estimator = (
            function if function is not None and not function.compiled else None
            for function in (setup.policy, setup.estimator)
        )
        self.asked_every = 1 if self.estimator else setup.policy_ticks if self.policy else 0
        self.actions: list[Any] = []
        self._memories: dict[tuple[str, int], Any] = {}

    def _call(self, function: UserFunction, reading: Reading, world: int) -> object:
        """Call a user's function for one world, store its new memory, and return its answer."""
        which = (function.what, world)
        if which not in self._memories:
            self._memories[which] = function.init(reading)
        answer, self._memories[which] = function(reading, self._memories[which])
        return answer

    def _readings(self, flight: Flight, tick: int, radios: LateRadio) -> list[tuple[Reading, NumpyArray]]:
        """Return, for each world of the block, its reading and which vehicles still fly, (n,) bool."""

        def heard(carry: Carry) -> Any:
            """Return the parts of a world's state that users' functions can read."""
            fleets = [{name: getattr(fleet, name) for name in _TOLD_OF_FLEETS} for fleet in carry.state.fleets]
            return {name: getattr(carry.state, name) for name in _TOLD}, fleets

        found = []
        parts, fleets = jax.tree.map(np.asarray, flight.get(heard))
        flying = np.concatenate([fleet["violation"].code for fleet in fleets], axis=1) == 0
        for world in range(len(self.rows)):
            state: Any = _LazyState(parts, fleets, radios, world)
            found.append((Reading(self.engine.example, state, tick, self.engine.setup.site), flying[world]))
        return found

    def ask(self, flight: Flight, tick: int, count: int) -> tuple[object, object]:
        """Call the users' lock-step functions for ``count`` worlds; return actions and estimates, each (count, ...), ()
        without."""
        if not self.asked_every:
            return (), ()
        estimates: list[object] = []
        asks = self.policy is not None and tick % self.engine.setup.policy_ticks == 0
        if asks:
            self.actions = []
        radios = LateRadio(lambda: flight.get(lambda carry: carry.state.radio))
        for world, (reading, flying) in enumerate(self._readings(flight, tick, radios)):
            where = f", at tick {tick} of world {self.rows[world]}"
            if self.policy is not None and asks:
                with self.policy.blamed(where):
                    command = self._call(self.policy, reading, world)
                    self.actions.append(self.engine.checker.actions(command, partial(np.asarray, flying)))
            if self.estimator is not None:
                with self.estimator.blamed(where):
                    estimate = self._call(self.estimator, reading, world)
                    estimates.append(self.engine.checker.estimates(estimate, needed=True))
        radios.over = True
        return self._stack(self.policy, self.actions, count), self._stack(self.estimator, estimates, count)

    @staticmethod
    def _stack(function: UserFunction | None, answers: list[Any], count: int) -> object:
        """Stack the answers for all worlds to arrays (``count``, ...), repeating the last; raises UsageError if they
        differ in kind."""
        # If no fleet of any world is commanded, the program is the one without a policy.
        if not jax.tree.leaves(answers):
            return ()
        filled = answers + [answers[-1]] * (count - len(answers))
        try:
            return jax.tree.map(lambda *parts: np.stack(parts), *filled)
        except ValueError:
            assert function is not None
            raise UsageError(
                f"{function.what} {function.name}: it answers in different kinds to different worlds"
            ) from None
