"""One world of a rollout, from its start and from tick to tick."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import Mesh

from qrsim.errors import UsageError
from qrsim.interface.actions import ActionChecker
from qrsim.interface.metrics import FLIGHT_METRICS
from qrsim.interface.mission_metrics import MISSION_METRICS
from qrsim.interface.policies import UserFunction
from qrsim.interface.readings import Reading
from qrsim.models.site import Site
from qrsim.world import tick as ticks_of
from qrsim.world.radio import split_messages
from qrsim.world.state import Some, State, World, WorldKeys

# Errors of JAX for a function that needs the value of an array while it is traced.
NEEDS_VALUES = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)


@dataclass(frozen=True)
class Setup:
    """Structure of a rollout, without its numbers.

    Attributes:
        policy, estimator: the user's, None without.
        metrics: object that sums up a flight.
        measured: identity of ``metrics`` and of its attributes, which are constants of a program.
        policy_ticks: number of ticks from one call of the policy to the next.
        site: origin of the local frame.
        structure: PyTree structure of a World.
        types: ``structure`` as text: JAX treats structures as equal if only the types of their records differ.
        varied: for each leaf of a World, whether every world has its own.
        mesh: the devices, None for a single one.
        kinds: the types of all records, because a class that is defined again has the same name.
    """

    policy: UserFunction | None
    estimator: UserFunction | None
    metrics: Any = field(compare=False)
    measured: Hashable
    policy_ticks: int
    site: Site = field(compare=False)
    structure: Any
    types: str
    varied: tuple[bool, ...]
    mesh: Mesh | None
    kinds: tuple[type, ...]

    @property
    def compiled(self) -> Setup:
        """Setup as compiled programs depend on it: without the user's functions that are called in lock-step on the
        host."""
        policy, estimator = (
            function if function is not None and function.compiled else None
            for function in (self.policy, self.estimator)
        )
        return replace(
            self, policy=policy, estimator=estimator, policy_ticks=1 if policy is None else self.policy_ticks
        )

    @property
    def key(self) -> Hashable:
        """Key of the compiled programs of this setup, hashable; the user's objects count by identity."""
        asked = (None if each is None else (each.name, each.identity) for each in (self.policy, self.estimator))
        return (
            *asked,
            self.measured,
            self.policy_ticks,
            self.structure,
            self.types,
            self.varied,
            self.mesh,
            self.kinds,
        )

    @property
    def plain(self) -> bool:
        """True if the setup has no code of users, so that its structure identifies it in any process."""
        own = {kind.__module__.split(".")[0] for kind in self.kinds} <= {"builtins", "qrsim"}
        asks_nobody = self.policy is None and self.estimator is None
        return asks_nobody and own and (self.metrics is FLIGHT_METRICS or self.metrics is MISSION_METRICS)

    def world(self, fixed: Sequence[object], own: Sequence[object]) -> World:
        """Rebuild a world from the arrays that all worlds share (``fixed``) and those that vary (``own``)."""
        shares, owns = iter(fixed), iter(own)
        world: World = jax.tree.unflatten(self.structure, [next(owns if v else shares) for v in self.varied])
        return world


class Carry(NamedTuple):
    """State that a world carries from tick to tick."""

    state: State
    policy_memory: Any
    estimator_memory: Any
    held: Any  # the last answer of a compiled policy that is not asked at every tick
    flight: Any
    wrong_tick: Any  # (n,) int32 first tick at which the policy's answer for a vehicle was not finite, or -1


def begin_world(setup: Setup, fixed: Sequence[object], keys: WorldKeys, own: Sequence[object]) -> Carry:
    """Return one world's state before its first tick, with carried memories; ``fixed``, ``own``: arrays that are shared
    and that vary."""
    world = setup.world(fixed, own)
    state = ticks_of.reset(world, keys)
    reading = Reading(world, state, 0, setup.site)
    memories = [_first_memory(function, reading) for function in (setup.policy, setup.estimator)]
    held = ()
    # Trace the policy here too, so that a wrong answer is found before anything is compiled.
    if setup.policy is not None:
        shapes, _ = jax.eval_shape(partial(_answer, setup.policy, world, reading, memories[0]))
        if setup.policy_ticks > 1:
            held = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    if setup.estimator is not None:
        jax.eval_shape(partial(_answer, setup.estimator, world, reading, memories[1]))
    size = sum(fleet.size for fleet in world.fleets)
    wrong = jnp.full(size, -1, jnp.int32)
    flight = setup.metrics.init(world, state)
    if setup.metrics is not FLIGHT_METRICS:
        _check_metrics(setup.metrics, flight, world, state)
    return Carry(state, memories[0], memories[1], held, flight, wrong)


def _check_metrics(metrics: Any, flight: Any, world: World, state: State) -> None:
    """Raise an error for user metrics with accumulators that change their structure or shapes from tick to tick."""
    after = jax.eval_shape(metrics.update, flight, world, state, jnp.int32(1))
    shapes = [[jnp.shape(leaf) for leaf in jax.tree.leaves(tree)] for tree in (flight, after)]
    structures: list[object] = [jax.tree.structure(tree) for tree in (flight, after)]
    if structures[0] != structures[1] or shapes[0] != shapes[1]:
        trees = [jax.tree.map(jnp.shape, tree) for tree in (flight, after)]
        raise UsageError(
            f"metrics: {type(metrics).__name__}.update returns a memory of shapes {trees[1]}; expected those of init, "
            f"{trees[0]}"
        )


def _first_memory(function: UserFunction | None, reading: Reading) -> object:
    """Return the initial memory of a user's function from its first reading; () without a function."""
    if function is None:
        return ()
    with function.blamed():
        return jax.tree.map(jnp.asarray, function.init(reading))


def _answer(function: UserFunction, world: World, reading: Reading, memory: object) -> tuple[object, object]:
    """Call a user's compiled policy or estimator; return its checked actions or estimates for each fleet, and its new
    memory."""
    checker = ActionChecker(world, world.fleets[0].start.position_ned.x.dtype, "traced")
    with function.blamed():
        result, memory = call_compiled(function, reading, memory)
        if function.what == "policy":
            return checker.actions(result), memory
        return checker.estimates(result, needed=True), memory


def call_compiled(function: UserFunction, reading: Reading, memory: object) -> tuple[object, object]:
    """Call a user's function while a program is traced; return its result and new memory; raises UsageError if it
    cannot be traced."""
    try:
        result, after = function(reading, memory)
    except NEEDS_VALUES as error:
        raise UsageError(
            f"it cannot be compiled, because it needs the value of a reading ({type(error).__name__}); write it with "
            "jax.numpy, or as a function of a reading without jax.jit, which is called at every tick"
        ) from error
    _check_memory(memory, after)
    return result, after


def _check_memory(before: object, after: object) -> None:
    """Raise UsageError if a function's memory differs in structure, shapes or dtypes ``before`` and ``after`` a
    call."""
    old = jax.tree.structure(before)
    new = jax.tree.structure(after)
    if repr(old) != repr(new):
        raise UsageError(f"step must return a memory like that of init: expected {old}, found {new}")
    for was, now in zip(map(jax.typeof, jax.tree.leaves(before)), map(jax.typeof, jax.tree.leaves(after)), strict=True):
        if was.shape != now.shape or (was.dtype != now.dtype and not was.weak_type):
            raise UsageError(
                f"step must return a memory like that of init: expected an array of {was.dtype} {was.shape}, "
                f"found {now.dtype} {now.shape}"
            )


def tick_of_world(
    setup: Setup, fixed: Sequence[object], own: Sequence[object], carry: Carry, tick: Any, given: tuple[Any, Any]
) -> Carry:
    """Advance one world by a tick; return its state and memories. ``given``: actions and estimates computed on the
    host."""
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


def _finite(world: World, actions: tuple[object, ...]) -> jax.Array:
    """Return which vehicles have a command with only finite numbers, (n,) bool."""
    found = []
    for fleet, action in zip(world.fleets, split_messages(actions)[0], strict=True):
        fine = jnp.ones(fleet.size, bool)
        # Rows of vehicles that are not commanded are ignored: they may contain anything.
        for which, asked in action.parts if isinstance(action, Some) else [(True, action)]:
            for leaf in jax.tree.leaves(asked):
                fine = fine & (jnp.isfinite(leaf) | jnp.logical_not(which))
        found.append(fine)
    return jnp.concatenate(found)
