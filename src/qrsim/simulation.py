"""Simulation: the stateful, friendly object over world.py, and the only place where worlds are compiled."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from qrsim import world as ticks_of
from qrsim.actions import ActionChecker
from qrsim.configuration import FEW_VEHICLES, QUICK_TO_COMPILE, use_compilation_cache
from qrsim.control import Estimate, WaypointSetpoint
from qrsim.core.noise import Key
from qrsim.core.pack import Buffers, Packer
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.area import reason_text
from qrsim.models.site import Site
from qrsim.placing import placed
from qrsim.readings import Reading, Truth
from qrsim.saved import SavedState, fingerprint, write
from qrsim.world import State, World, WorldKeys, keys_of

FloatArray = np.ndarray[Any, Any]
LARGEST_TICK = 2**31 - 2


class _Program:
    """A function compiled with the code generator that suits the number of vehicles."""

    def __init__(self, function: Callable[..., Any], **options: Any):
        self._few = jax.jit(function, compiler_options=QUICK_TO_COMPILE, **options)
        self._many = jax.jit(function, **options)

    def __call__(self, vehicles: int, *arguments: Any) -> Any:
        return (self._few if vehicles <= FEW_VEHICLES else self._many)(*arguments)


def _reset_world(world_layout: Packer, world: Buffers, keys: WorldKeys) -> State:
    return ticks_of.reset(world_layout.unpack(world), keys)


def _advance_world(
    world_layout: Packer,
    layout: Packer,
    world: Buffers,
    state: Buffers,
    tick: Any,
    count: Any,
    actions: Any,
    estimates: Any,
) -> Buffers:
    """Run ``count`` ticks and return the packed state."""
    parameters = world_layout.unpack(world)

    def body(i: Any, current: State) -> State:
        return ticks_of.step(parameters, current, tick + i, actions, estimates)

    return layout.pack(lax.fori_loop(jnp.int32(0), count, body, layout.unpack(state)))


def _record_world(
    world_layout: Packer,
    layout: Packer,
    world: Buffers,
    state: Buffers,
    tick: Any,
    count: Any,
    actions: Any,
    estimates: Any,
    capacity: int,
) -> tuple[Buffers, Buffers]:
    """Run ``count`` <= capacity ticks; return the packed state and every packed state on the way."""
    parameters = world_layout.unpack(world)
    rows = tuple(jnp.zeros((capacity, buffer.shape[0]), buffer.dtype) for buffer in state)

    def body(i: Any, carry: tuple[State, Buffers]) -> tuple[State, Buffers]:
        current = ticks_of.step(parameters, carry[0], tick + i, actions, estimates)
        packed = layout.pack(current)
        kept = tuple(lax.dynamic_update_index_in_dim(r, p, i, 0) for r, p in zip(carry[1], packed, strict=True))
        return current, kept

    final, kept = lax.fori_loop(jnp.int32(0), count, body, (layout.unpack(state), rows))
    return layout.pack(final), kept


_reset = _Program(_reset_world, static_argnums=0)
_advance = _Program(_advance_world, static_argnums=(0, 1), donate_argnums=3)
_record = _Program(_record_world, static_argnums=(0, 1, 8), donate_argnums=3)


class History:
    """The states of consecutive ticks, as NumPy arrays with the tick as first axis.

    Attributes:
        ticks: (T,) tick numbers.
        time: (T,) simulated time [s].
        state: the State, each leaf with a leading axis T.
    """

    def __init__(self, ticks: FloatArray, time_step: float, state: State):
        self.ticks = ticks
        self.time = ticks * time_step
        self.state = state


class Simulation:
    """A world that flies.

    Args:
        world: its parameters, as arrays of one floating-point type.
        seed: of all randomness, 0 <= seed < 2**63.
        number: which world of a rollout with this seed it is, 0 <= number < 2**32.
        name: what to call it in messages and logs.
        site: origin of the local frame, for readings in latitude and longitude; default: the flying field of
            Symington 2014.

    Attributes:
        world: the parameters.
        seed: the seed of this episode.
        tick: steps done since the reset.
        vehicle_names: name of each of the n vehicles of all fleets.
    """

    def __init__(self, world: World, *, seed: int = 0, number: int = 0, name: str = "world", site: Site | None = None):
        use_compilation_cache()
        self.world = world
        self.name = name
        self.site = site or Site()
        self.dtype = np.dtype(world.fleets[0].start.position_ned.x.dtype)
        self.vehicle_names = tuple(name for fleet in world.fleets for name in fleet.vehicle_names)
        self.tick = 0
        self.seed = _checked_seed(seed)
        self.number = _checked_number(number)
        self._checker = ActionChecker(world, self.dtype)
        self._world_layout = Packer(world)
        with self.precision_context():
            self._world: Buffers = jax.device_put(self._world_layout.pack(world))
        self._layout: Packer | None = None
        self._state: Buffers | None = None
        self._host: State | None = None

    @property
    def precision(self) -> str:
        """float32 or float64."""
        return self.dtype.name

    @property
    def size(self) -> int:
        """Number of vehicles of all fleets, n."""
        return len(self.vehicle_names)

    @property
    def time(self) -> float:
        """Simulated time since the reset [s]."""
        return self.tick * self.world.time_step

    def reset(self, seed: int | None = None) -> Reading:
        """Start an episode and return its first reading; a new seed makes another episode."""
        if seed is not None:
            self.seed = _checked_seed(seed)
        with self.precision_context():
            keys = keys_of(self.world, Key.root(self.seed, self.number))
            # Packed on the host, because a program for it would cost more to compile than it ever saves.
            state = jax.tree.map(np.asarray, _reset(self.size, self._world_layout, self._world, keys))
            self._layout = Packer(state)
            self._state = jax.device_put(self._layout.pack(state))
        self.tick = 0
        self._host = None
        return self.reading

    def step(self, command: Any = None, ticks: int = 1, estimate: Estimate | None = None) -> Reading:
        """Advance and return the reading at the end.

        Args:
            command: None lets every fleet's own guidance and controller fly; an array (n, 5) of SI commands (pitch,
                roll, throttle, yaw rate, battery) or a Command is flown as it is; a set-point (``WaypointSetpoint``,
                ``VelocitySetpoint``, ...) is handed to the controllers, which must take its kind. A dict has one of
                these for each fleet by name.
            ticks: how many steps the command is held.
            estimate: what the controllers are fed with in place of the sensors, for all n vehicles: the output of
                your own filter.

        Raises:
            UsageError: wrong shape, a value for a vehicle that flies that is not finite, one outside its range (field,
                value and range are named), or a number of ticks that is not a positive integer.
        """
        self.advance(command, ticks, estimate)
        return self.reading

    def advance(self, command: Any = None, ticks: int = 1, estimate: Estimate | None = None) -> None:
        """Advance as ``step`` does, for those who do not look at the reading of every step."""
        actions = self._checker.actions(command, lambda: self.valid)
        estimates = self._checker.estimates(estimate)
        count = self._checked_ticks(ticks)
        layout, state = self._running()
        tick, number = np.int32(self.tick), np.int32(count)
        with self.precision_context():
            self._state = _advance(
                self.size, self._world_layout, layout, self._world, state, tick, number, actions, estimates
            )
        self.tick += count
        self._host = None

    def record(self, ticks: int, command: Any = None, capacity: int = 50, estimate: Estimate | None = None) -> History:
        """Advance as ``step`` does and return the state of every tick on the way.

        Args:
            ticks: how many, at most ``capacity``.
            command, estimate: as in ``step``.
            capacity: length the program is compiled for.
        """
        actions = self._checker.actions(command, lambda: self.valid)
        estimates = self._checker.estimates(estimate)
        count = self._checked_ticks(ticks)
        if count > capacity:
            raise UsageError(f"ticks: {count} is more than the capacity, {capacity}")
        layout, state = self._running()
        with self.precision_context():
            self._state, rows = _record(
                self.size,
                self._world_layout,
                layout,
                self._world,
                state,
                np.int32(self.tick),
                np.int32(count),
                actions,
                estimates,
                capacity,
            )
        numbers = np.arange(self.tick + 1, self.tick + count + 1)
        self.tick += count
        self._host = None
        host = tuple(np.asarray(buffer)[:count] for buffer in rows)
        return History(numbers, self.world.time_step, layout.unpack(host))  # type: ignore[arg-type]

    def set_state(self, state: Any) -> Reading:
        """Put the vehicles into given states, flying again where they had stopped; their controllers start anew.

        Sensors keep their errors and speak again at their next reading; until then they say what they last said.

        Args:
            state: (n, 13) position NED [m], roll, pitch, yaw [rad], body velocity [m/s], body rates [rad/s] and thrust
                [N]; (n, 12) without thrust, which is then the weight; (n, 6) at rest; or (n, 3) level and facing north
                too. A row of NaN leaves its vehicle as it is.

        Raises:
            UsageError: another shape, a row that is partly NaN, or a state beyond area and limits or in collision.
        """
        layout, _ = self._running()
        with self.precision_context():
            changed = placed(self.world, self.state, state, self.vehicle_names)
            self._state = jax.device_put(layout.pack(changed))
        self._host = None
        return self.reading

    def save(self, path: str | Path | None = None) -> bytes:
        """Return the whole state as bytes, and write them to a file where a path is given.

        Raises:
            UsageError: the simulation has not started.
            RunError: the file cannot be written.
        """
        _, state = self._running()
        floats, integers = (np.array(buffer) for buffer in state)
        data = SavedState(floats, integers, self.tick, self.seed, self.name, self._fingerprint()).to_bytes()
        if path is not None:
            write(path, data)
        return data

    def load(self, source: bytes | str | Path) -> Reading:
        """Continue from a saved state, of this scenario with these parameters; the future is that of the original.

        Raises:
            UsageError: it is no saved state, or one of another scenario or version.
        """
        saved = SavedState.of(source)
        saved.check(self.name, self._fingerprint())
        if self._layout is None:
            self.reset(saved.seed)
        _, state = self._running()
        if [part.shape for part in (saved.floats, saved.integers)] != [part.shape for part in state]:
            raise UsageError("saved state: its size is not that of this simulation's state: it is of another version")
        with self.precision_context():
            self._state = jax.device_put((saved.floats, saved.integers))
        self.tick, self.seed, self._host = saved.tick, saved.seed, None
        return self.reading

    def _fingerprint(self) -> str:
        return fingerprint(self._world_layout, self._world)

    @property
    def packed(self) -> tuple[Packer, Buffers]:
        """The state as programs take it, and its layout; to be copied from before the next step overwrites it."""
        return self._running()

    @property
    def state(self) -> State:
        """The whole state as NumPy arrays (read-only views)."""
        if self._host is None:
            layout, state = self._running()
            # A copy, because the buffer itself is handed back to the next step.
            self._host = layout.unpack(tuple(np.array(buffer) for buffer in state))  # type: ignore[arg-type]
        return self._host

    @property
    def history(self) -> History:
        """The present state as a History of one tick."""
        layout, state = self._running()
        host = tuple(np.array(buffer)[None] for buffer in state)
        return History(np.array([self.tick]), self.world.time_step, layout.unpack(host))  # type: ignore[arg-type]

    @property
    def reading(self) -> Reading:
        """What the sensors say now."""
        return Reading(self.world, self.state, self.tick, self.site)

    @property
    def truth(self) -> Truth:
        """What is really the case now, all fleets one after the other."""
        return Truth(self.state)

    @property
    def valid(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(n,) whether each vehicle still flies."""
        return np.concatenate([fleet.violation.code == 0 for fleet in self.state.fleets])

    @property
    def reasons(self) -> list[str]:
        """Why each of the n vehicles is invalid, "" while it is valid; kind, field and value."""
        codes = np.concatenate([fleet.violation.code for fleet in self.state.fleets])
        values = np.concatenate([fleet.violation.value for fleet in self.state.fleets])
        return [reason_text(int(code), float(value)) for code, value in zip(codes, values, strict=True)]

    def waypoint(self, position_ned: Any, yaw_rad: Any = 0.0) -> WaypointSetpoint:
        """Return a set-point for ``step``: positions (n, 3) or (3,) [m] and headings (n,) or one [rad]."""
        return self._checker.waypoint(position_ned, yaw_rad)

    def _checked_ticks(self, ticks: Any) -> int:
        if isinstance(ticks, bool) or not isinstance(ticks, int | np.integer) or ticks < 1:
            raise UsageError(f"ticks: {ticks!r} is not a positive integer")
        if self.tick + int(ticks) > LARGEST_TICK:
            raise UsageError(f"ticks: {ticks} would pass the last tick, {LARGEST_TICK}")
        return int(ticks)

    def _running(self) -> tuple[Packer, Buffers]:
        if self._layout is None or self._state is None:
            raise UsageError("the simulation has not started: call reset() first")
        return self._layout, self._state

    def precision_context(self) -> contextlib.AbstractContextManager[Any]:
        """Return a context in which JAX computes in this simulation's precision."""
        return jax.enable_x64(self.dtype == np.float64)


def _checked_number(number: Any) -> int:
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < 2**32:
        raise UsageError(f"number: {number!r} is not an integer from 0 to 2**32 - 1")
    return int(number)


def check_precision(precision: str) -> str:
    """Return a precision that exists.

    Raises:
        UsageError: it is neither float32 nor float64.
    """
    known = ("float32", "float64")
    if precision not in known:
        raise UsageError(f"precision: '{precision}' is not known{did_you_mean(str(precision), known)}")
    return precision


def _checked_seed(seed: Any) -> int:
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise UsageError(f"seed: {seed!r} is not an integer from 0 to 2**63 - 1")
    return int(seed)
