"""The compiled part of a rollout: a block of worlds from its start to its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec

from qrsim import world as ticks_of
from qrsim.actions import ActionChecker
from qrsim.configuration import FEW_VEHICLES, QUICK_TO_COMPILE
from qrsim.core.noise import Key
from qrsim.errors import UsageError
from qrsim.models.site import Site
from qrsim.policies import UserFunction
from qrsim.readings import Reading
from qrsim.world import State, World, WorldKeys

Array = np.ndarray[Any, Any]
AXIS = "worlds"
# Ticks between two looks at the progress, where nothing else stops the loop.
TICKS_PER_CALL = 500
# What JAX raises where a program that is being compiled would have to know a number.
NEEDS_VALUES = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)


@dataclass(frozen=True)
class Setup:
    """What a rollout is made of beside the numbers.

    Attributes:
        policy, estimator: the user's, None without.
        metrics: what sums up a flight.
        policy_ticks: the policy is asked at every so-many-th tick.
        site: origin of the local frame.
        structure: of a World as a PyTree.
        varied: for each leaf of a World, whether every world has its own.
        mesh: the devices, None for a single one.
    """

    policy: UserFunction | None
    estimator: UserFunction | None
    metrics: Any
    policy_ticks: int
    site: Site = field(compare=False)
    structure: Any
    varied: tuple[bool, ...]
    mesh: Mesh | None

    @property
    def compiled(self) -> Setup:
        """The part that programs depend on: whom they ask. Who is asked in lock-step does not change them."""
        policy, estimator = (
            function if function is not None and function.compiled else None
            for function in (self.policy, self.estimator)
        )
        return replace(
            self, policy=policy, estimator=estimator, policy_ticks=1 if policy is None else self.policy_ticks
        )

    def world(self, fixed: list[Any], own: list[Any]) -> World:
        """Return the world of leaves that all worlds share and leaves that are this world's own."""
        shares, owns = iter(fixed), iter(own)
        world: World = jax.tree.unflatten(self.structure, [next(owns if v else shares) for v in self.varied])
        return world


@dataclass(frozen=True)
class Schedule:
    """How long the worlds fly, and at which ticks something is looked at; record_every 0: nothing is recorded."""

    ticks: int
    record_every: int

    @property
    def records(self) -> list[int]:
        """Ticks at which something is recorded, the start included."""
        return list(range(0, self.ticks + 1, self.record_every)) if self.record_every else []

    def stops(self, asked_every: int) -> list[int]:
        """Return the ticks at which the loop comes back; ``asked_every`` is 0 where nobody is asked in lock-step."""
        found = {self.ticks, *self.records}
        for period in (TICKS_PER_CALL, asked_every):
            if period:
                found |= set(range(period, self.ticks, period))
        return sorted(found - {0})


class Carry(NamedTuple):
    """What a world takes from tick to tick."""

    state: State
    policy_memory: Any
    estimator_memory: Any
    held: Any  # the last answer of a compiled policy that is not asked at every tick
    flight: Any
    wrong_tick: Any  # (n,) int32 first tick at which the policy's answer for a vehicle was not finite, or -1


def _begin(setup: Setup, fixed: list[Any], keys: WorldKeys, own: list[Any]) -> Carry:
    """Return the start of one world."""
    world = setup.world(fixed, own)
    state = ticks_of.reset(world, keys)
    reading = Reading(world, state, 0, setup.site)
    memories = [_first_memory(function, reading) for function in (setup.policy, setup.estimator)]
    held: Any = ()
    # All are asked here too, so that a wrong answer is found before anything is compiled.
    if setup.policy is not None:
        shapes, _ = jax.eval_shape(partial(_answer, setup.policy, world, reading, memories[0]))
        if setup.policy_ticks > 1:
            held = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    if setup.estimator is not None:
        jax.eval_shape(partial(_answer, setup.estimator, world, reading, memories[1]))
    size = sum(fleet.size for fleet in world.fleets)
    wrong = jnp.full(size, -1, jnp.int32)
    return Carry(state, memories[0], memories[1], held, setup.metrics.init(world, state), wrong)


def _first_memory(function: UserFunction | None, reading: Reading) -> Any:
    """Return the memory that a function starts with."""
    if function is None:
        return ()
    with function.blamed():
        return jax.tree.map(jnp.asarray, function.init(reading))


def _answer(function: UserFunction, world: World, reading: Reading, memory: Any) -> tuple[Any, Any]:
    """Return what a compiled function asks for, actions or estimates for each fleet, and its memory."""
    checker = ActionChecker(world, world.fleets[0].start.position_ned.x.dtype, "traced")
    with function.blamed():
        result, memory = call_compiled(function, reading, memory)
        return (checker.actions if function.what == "policy" else checker.estimates)(result), memory


def call_compiled(function: UserFunction, reading: Reading, memory: Any) -> tuple[Any, Any]:
    """Call a user's function in a program that is being compiled."""
    try:
        result, after = function(reading, memory)
    except NEEDS_VALUES as error:
        raise UsageError(
            f"it cannot be compiled, because it needs the value of a reading ({type(error).__name__}); write it with "
            "jax.numpy, or as a function of a reading without jax.jit, which is called at every tick"
        ) from error
    _check_memory(memory, after)
    return result, after


def _check_memory(before: Any, after: Any) -> None:
    """Refuse a memory that a loop cannot carry from tick to tick."""
    old: Any = jax.tree.structure(before)
    new: Any = jax.tree.structure(after)
    if old != new:
        raise UsageError(f"step must return a memory like that of init: expected {old}, found {new}")
    for was, now in zip(map(jax.typeof, jax.tree.leaves(before)), map(jax.typeof, jax.tree.leaves(after)), strict=True):
        if was.shape != now.shape or (was.dtype != now.dtype and not was.weak_type):
            raise UsageError(
                f"step must return a memory like that of init: expected an array of {was.dtype} {was.shape}, "
                f"found {now.dtype} {now.shape}"
            )


def _tick(setup: Setup, fixed: list[Any], own: list[Any], carry: Carry, tick: Any, given: tuple[Any, Any]) -> Carry:
    """Advance one world by one tick; ``given`` holds the actions and estimates that were asked for in lock-step."""
    world = setup.world(fixed, own)
    reading = Reading(world, carry.state, tick, setup.site)
    actions, estimates = given
    memory, believed_memory, held, wrong = carry.policy_memory, carry.estimator_memory, carry.held, carry.wrong_tick
    if setup.policy is not None:
        if setup.policy_ticks == 1:
            actions, memory = _answer(setup.policy, world, reading, memory)
        else:
            due = tick % setup.policy_ticks == 0
            ask = partial(_answer, setup.policy, world, reading, memory)
            actions, memory = held, memory = lax.cond(due, ask, lambda: (carry.held, carry.policy_memory))
        flying = jnp.concatenate([fleet.violation.code for fleet in carry.state.fleets]) == 0
        wrong = jnp.where((wrong < 0) & flying & ~_finite(world, actions), tick, wrong)
    if setup.estimator is not None:
        estimates, believed_memory = _answer(setup.estimator, world, reading, believed_memory)
    state = ticks_of.step(world, carry.state, tick, actions or (None,) * len(world.fleets), estimates or None)
    flight = setup.metrics.update(carry.flight, world, state, tick + 1)
    return Carry(state, memory, believed_memory, held, flight, wrong)


def _finite(world: World, actions: tuple[Any, ...]) -> Any:
    """Return whether all that is asked of each vehicle (n,) is finite."""
    parts = []
    for fleet, action in zip(world.fleets, actions, strict=True):
        leaves = jax.tree.leaves(action)
        fine = jnp.ones(fleet.size, bool)
        for leaf in leaves:
            fine = fine & jnp.isfinite(leaf)
        parts.append(fine)
    return jnp.concatenate(parts)


def _advance(
    setup: Setup, fixed: list[Any], own: list[Any], carry: Carry, tick: Any, count: Any, given: tuple[Any, Any]
) -> Carry:
    """Advance a block of worlds by ``count`` ticks; the tick is the same for all, so that slow sensors are skipped."""
    one = jax.vmap(partial(_tick, setup), in_axes=(None, 0, 0, None, 0))
    return lax.fori_loop(jnp.int32(0), count, lambda i, now: one(fixed, own, now, tick + i, given), carry)


class Programs(NamedTuple):
    """The compiled parts of a rollout that do not depend on what is recorded."""

    begin: Any
    advance: Any


@lru_cache(maxsize=8)
def programs(setup: Setup, few: bool) -> Programs:
    """Return the programs of ``Setup.compiled``, compiled when first called; ``few`` vehicles need other options."""
    return Programs(
        _compiled(jax.vmap(partial(_begin, setup), (None, 0, 0)), "srr", setup.mesh, few),
        _compiled(partial(_advance, setup), "srrssr", setup.mesh, few, donate_argnums=2),
    )


@lru_cache(maxsize=8)
def recorder(record: Callable[[State], Any], mesh: Mesh | None, few: bool) -> Any:
    """Return the program that records a block of states."""
    return _compiled(jax.vmap(record), "r", mesh, few)


def _compiled(function: Callable[..., Any], arguments: str, mesh: Mesh | None, few: bool, **more: Any) -> Any:
    """Compile for all devices: of the arguments some are cut by world (r), the others the same for all (s)."""
    if mesh is not None:
        cut, same = PartitionSpec(AXIS), PartitionSpec()  # type: ignore[no-untyped-call]
        specs = tuple(cut if kind == "r" else same for kind in arguments)
        function = jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=cut, check_vma=False)
    return jax.jit(function, compiler_options=QUICK_TO_COMPILE if few else None, **more)


# Tracing a start only to see its size takes as long as a short flight.
_BYTES: dict[Setup, int] = {}


class Engine:
    """Flies block after block.

    Args:
        setup: what the rollout is made of.
        example: one of the worlds.
        fixed: leaves that all worlds share.
        varied: leaves (W, ...) that they do not.
        schedule: how long, and what is looked at when.
        record: what is kept of a state, None for nothing.
        sink: takes what is recorded; None: it is kept.
        progress: called with the number of world-ticks done.
    """

    def __init__(
        self, setup: Setup, example: World, fixed: list[Any], varied: list[Any], schedule: Schedule,
        record: Callable[[State], Any] | None, sink: Callable[[Array, int, Any], None] | None,
        progress: Callable[[int], None],
    ):  # fmt: skip
        self.setup, self.example, self.fixed, self.varied = setup, example, fixed, varied
        self.schedule, self.record, self.sink, self.progress = schedule, record, sink, progress
        self.names = [name for fleet in example.fleets for name in fleet.vehicle_names]
        self.devices = 1 if setup.mesh is None else setup.mesh.size
        self.checker = ActionChecker(example, np.dtype(example.fleets[0].start.position_ned.x.dtype), "finite")

    def bytes_per_world(self) -> int:
        """Return the size of what a world takes from tick to tick."""
        setup = self.setup.compiled
        if setup not in _BYTES:
            own, keys = [part[0] for part in self.varied], ticks_of.keys_of(self.example, Key.root(0))
            shapes = jax.eval_shape(partial(_begin, setup), self.fixed, keys, own)
            _BYTES[setup] = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes))
        return _BYTES[setup]

    def fly(self, rows: Array, seeds: Array, numbers: Array) -> tuple[dict[str, Array], Any]:
        """Fly the worlds ``rows`` (B,), and return their metrics and what was recorded of them."""
        real = len(np.unique(rows))
        few = len(rows) * len(self.names) <= FEW_VEHICLES * self.devices
        program = programs(self.setup.compiled, few)
        own = [part[rows] for part in self.varied]
        # On the host: in the program, the keys' own rounds would be compiled into everything that draws.
        keys = ticks_of.keys_of(self.example, Key.roots(seeds[rows], numbers[rows]))
        carry = program.begin(self.fixed, keys, own)
        lock_step = LockStep(self, rows[:real])
        kept: list[Any] = []
        self._keep(few, carry, 0, rows[:real], kept)
        tick = 0
        for after in self.schedule.stops(lock_step.asked_every):
            given = lock_step.ask(carry, tick, len(rows))
            carry = program.advance(self.fixed, own, carry, np.int32(tick), np.int32(after - tick), given)
            self._refuse(np.asarray(carry.wrong_tick), rows)
            self._keep(few, carry, after, rows[:real], kept)
            self.progress(real * (after - tick))
            tick = after
        flight, state = jax.tree.map(lambda leaf: np.asarray(leaf)[:real], (carry.flight, carry.state))
        recorded = jax.tree.map(lambda *parts: np.stack(parts, axis=1), *kept) if kept else None
        return self.setup.metrics.finish(flight, self.example, state), recorded

    def _keep(self, few: bool, carry: Carry, tick: int, rows: Array, kept: list[Any]) -> None:
        if self.record is None or tick % self.schedule.record_every:
            return
        program = recorder(self.record, self.setup.mesh, few)
        recorded = jax.tree.map(lambda leaf: np.asarray(leaf)[: len(rows)], program(carry.state))
        if self.sink is None:
            kept.append(recorded)
        else:
            self.sink(rows, tick, recorded)

    def _refuse(self, wrong_tick: Array, rows: Array) -> None:
        if (wrong_tick < 0).all():
            return
        world, vehicle = np.argwhere(wrong_tick >= 0)[0]
        assert self.setup.policy is not None
        raise UsageError(
            f"policy {self.setup.policy.name}: what it asks of vehicle {vehicle} ('{self.names[vehicle]}') is not "
            f"finite at tick {wrong_tick[world, vehicle]} of world {rows[world]}"
        )


class LockStep:
    """Asks those of the user's functions that are called between two ticks, world by world; they have no memory."""

    def __init__(self, engine: Engine, rows: Array):
        self.engine, self.rows = engine, rows
        setup = engine.setup
        self.policy, self.estimator = (
            function if function is not None and not function.compiled else None
            for function in (setup.policy, setup.estimator)
        )
        self.asked_every = 1 if self.estimator else setup.policy_ticks if self.policy else 0
        self.actions: list[Any] = []

    def _readings(self, carry: Carry, tick: int) -> list[tuple[Reading, Array]]:
        """Return the reading of each world, and which of its vehicles (n,) fly."""
        state = carry.state
        heard = (state.sky, [(fleet.readings, fleet.violation, fleet.passed_on) for fleet in state.fleets])
        found = []
        host = jax.tree.map(np.asarray, heard)
        for world in range(len(self.rows)):
            sky, own = jax.tree.map(lambda leaf, world=world: leaf[world], host)
            names = ("readings", "violation", "passed_on")
            fleets = [SimpleNamespace(**dict(zip(names, fleet, strict=True))) for fleet in own]
            state = SimpleNamespace(sky=sky, fleets=fleets)  # type: ignore[assignment]
            flying = np.concatenate([fleet.violation.code for fleet in fleets]) == 0
            found.append((Reading(self.engine.example, state, tick, self.engine.setup.site), flying))
        return found

    def ask(self, carry: Carry, tick: int, count: int) -> tuple[Any, Any]:
        """Return actions and estimates, each leaf (count, ...): empty where nobody is asked."""
        if not self.asked_every:
            return (), ()
        estimates: list[Any] = []
        asks = self.policy is not None and tick % self.engine.setup.policy_ticks == 0
        if asks:
            self.actions = []
        for world, (reading, flying) in enumerate(self._readings(carry, tick)):
            where = f", at tick {tick} of world {self.rows[world]}"
            if self.policy is not None and asks:
                with self.policy.blamed(where):
                    command, _ = self.policy(reading, None)
                    self.actions.append(self.engine.checker.actions(command, partial(np.asarray, flying)))
            if self.estimator is not None:
                with self.estimator.blamed(where):
                    estimate, _ = self.estimator(reading, None)
                    estimates.append(self.engine.checker.estimates(estimate))
        return self._stack(self.policy, self.actions, count), self._stack(self.estimator, estimates, count)

    @staticmethod
    def _stack(function: UserFunction | None, answers: list[Any], count: int) -> Any:
        # Where nothing is asked of any fleet of any world, it is as without a policy.
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
