"""Simulation: the stateful object over world/tick.py."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np

from qrsim.control import Estimate, WaypointSetpoint
from qrsim.core.noise import Key
from qrsim.core.tables import Table, Tabled, number_text
from qrsim.engine.layout import Buffers, Packer
from qrsim.engine.settings import use_compilation_cache
from qrsim.errors import UsageError
from qrsim.interface.actions import ActionChecker
from qrsim.interface.crowds import warn_of_overfull
from qrsim.interface.readings import Reading
from qrsim.interface.seen import Seen, StateOffsets
from qrsim.interface.truth import Truth
from qrsim.models.scene.area import reason_text
from qrsim.models.site import Site
from qrsim.simulation.alone import alone
from qrsim.simulation.arguments import checked_number, checked_seed, checked_ticks
from qrsim.simulation.history import History
from qrsim.simulation.injecting import Injecting
from qrsim.simulation.one_world import Again, OneWorld
from qrsim.simulation.pickling import with_files
from qrsim.simulation.placing import checked_rows, refuse_misplaced
from qrsim.simulation.radios import Radios, no_seen_state
from qrsim.simulation.snapshot import SavedState, fingerprint, write
from qrsim.world.draws import keys_of
from qrsim.world.episode import refuse_unplaced
from qrsim.world.state import State, World

# Ticks that a program of ``record`` is for where the user does not say.
CAPACITY = 50
# Of a simulation, what a copy makes for itself.
_MADE_AGAIN = ("_checker", "_ticks", "_offsets", "_now", "_lock", "_changes")


class Simulation(Radios, Injecting, Tabled):
    """A world in flight.

    One thread at a time may fly it: where another is in a call that changes its state, ``reset``, ``step`` and the like
    raise a ``BusyError`` at once, and the first goes on undisturbed. Looking at it is allowed at any time, and shows it
    between two steps. It can be pickled and deep-copied at any time, and a copy has the same future.

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
        super().__init__()
        if not isinstance(world, World):
            kind = type(world).__name__
            raise UsageError(f"world: expected a World, found {kind}; qrsim.load(...) makes a simulation of a scenario")
        use_compilation_cache()
        self.world = world
        self.name = name
        self.site = site or Site()
        self.dtype = np.dtype(world.fleets[0].start.position_ned.x.dtype)
        self.vehicle_names = tuple(name for fleet in world.fleets for name in fleet.vehicle_names)
        self.tick = 0
        self.seed = checked_seed(seed)
        self.number = checked_number(number)
        self._checker = ActionChecker(world, self.dtype)
        with self.precision_context():
            self._ticks = OneWorld(world)
        self._layout: Packer | None = None
        self._offsets: StateOffsets | None = None
        self._state: Buffers | None = None
        # The present state, as long as somebody sees it.
        self._now: Callable[[], Seen | None] = no_seen_state
        # Whether vehicles may come to have more others around them than they look at.
        self._crowded = True

    def __reduce_ex__(self, protocol: Any) -> Any:
        return with_files(self, self.world, protocol) or super().__reduce_ex__(protocol)

    def __getstate__(self) -> dict[str, object]:
        # Programs follow from the world and are made again; locks cannot be shared with a copy.
        with self._lock:
            kept = {name: value for name, value in vars(self).items() if name not in _MADE_AGAIN}
            return kept | {"_state": None if self._state is None else tuple(map(np.array, self._state))}

    def __setstate__(self, kept: Mapping[str, object]) -> None:
        self.__init__(kept["world"], seed=kept["seed"], number=kept["number"])  # type: ignore[misc]
        vars(self).update(kept)
        if self._state is not None and self._layout is not None:
            with self.precision_context():
                self._state = self._ticks.adopt(self._state)

    def _table(self) -> Table:
        """Return the vehicles as a table for display: position, velocity and state of each."""
        where = f"at {number_text(self.time, 9)} s, tick {self.tick}" if self._state is not None else "not started"
        title = f"simulation '{self.name}' {where}, seed {self.seed}, {self.precision}"
        if self._state is None:
            return Table(f"{title}: reset() starts it", (), ())
        truth, reasons = self.truth, self.reasons
        rows = [
            (name, number_text(place), number_text(velocity), why or "flies")
            for name, place, velocity, why in zip(
                self.vehicle_names, truth.position_ned, truth.velocity_ned, reasons, strict=True
            )
        ]
        return Table(title, ("vehicle", "position NED [m]", "velocity NED [m/s]", "state"), rows)

    @property
    def precision(self) -> str:
        """Floating-point type of the simulation: "float32" or "float64"."""
        return self.dtype.name

    @property
    def size(self) -> int:
        """Number n of vehicles in all fleets together."""
        return len(self.vehicle_names)

    @property
    def time(self) -> float:
        """Simulated time since the reset [s]."""
        return self.tick * self.world.time_step

    @alone
    def reset(self, seed: int | None = None) -> Reading:
        """Start an episode and return its first reading; a new ``seed`` makes another episode."""
        if seed is not None:
            self.seed = checked_seed(seed)
        self._clear_all()
        with self.precision_context():
            self._layout, self._state = self._ticks.reset(keys_of(self.world, Key.root(self.seed, self.number)))
            self.tick, self._now = 0, no_seen_state
            refuse_unplaced(self.world, cast(State, self._seen()).placed)
        return self.reading

    # Here and in ``advance`` what ``alone`` does is written out: called so often, its own call counts.
    def step(self, command: object = None, ticks: int = 1, estimate: Estimate | None = None) -> Reading:
        """Advance by ``ticks`` ticks with a command (None: the scenario's guidance), and return the reading at the end.

        Args:
            command: None lets every fleet's own guidance and controller fly; an array (n, 5) of SI commands (pitch,
                roll, throttle, yaw rate, battery) or a Command is flown as it is; a set-point (``WaypointSetpoint``,
                ``VelocitySetpoint``, ...) is handed to the controllers, which must take its kind. A dict has one of
                these for some fleets, or vehicles, by name; all others fly by their own guidance.
            ticks: how many steps the command is held.
            estimate: what the controllers are fed with in place of the sensors, for all n vehicles: the output of
                your own filter.

        Raises:
            UsageError: wrong shape, a value for a vehicle that flies that is not finite, one outside its range (field,
                value and range are named), or a number of ticks that is not a positive integer.
        """
        if not self._lock.acquire(False):
            self._wait_or_refuse("step")
        self._changes = True
        try:
            self._advance(command, ticks, estimate)
            if self._crowded:
                self._crowded = warn_of_overfull(self.world, cast(State, self._seen()))
            return Reading(self.world, cast(State, self._seen()), self.tick, self.site)
        finally:
            self._changes = False
            self._lock.release()

    def advance(
        self, command: object = None, ticks: int = 1, estimate: Estimate | None = None, again: Again = ""
    ) -> None:
        """Advance without a reading; ``again``: the last command, "same", or "renewed" in place (not checked again)."""
        if not self._lock.acquire(False):
            self._wait_or_refuse("advance")
        self._changes = True
        try:
            self._advance(command, ticks, estimate, again)
        finally:
            self._changes = False
            self._lock.release()

    def _advance(self, command: object, ticks: int, estimate: Estimate | None, again: Again = "") -> None:
        """Fly ``ticks`` ticks with a command and, for controllers that take one, a user's estimate."""
        if estimate is None and self._state is not None and self._ticks.taken(command, again):
            count = checked_ticks(ticks, self.tick)
            self._detach_seen()
            self._state = self._ticks.advance_bound(self._state, self.tick, count)
            self.tick += count
            return
        actions = self._checker.actions(command, lambda: self.valid)
        estimates = self._checker.estimates(estimate)
        count = checked_ticks(ticks, self.tick)
        layout, state = self._running()
        self._detach_seen()
        with self.precision_context():
            self._state = self._ticks.advance(layout, state, self.tick, count, (actions, estimates))
            self.tick += count
        if estimate is None:
            self._ticks.bind(command, actions, self._checker)

    @alone
    def record(
        self, ticks: int, command: object = None, capacity: int | None = None, estimate: Estimate | None = None
    ) -> History:
        """Advance as ``step`` does, and return the state of every tick on the way.

        Args:
            ticks: how many, at most ``capacity``.
            command: as in ``step``.
            estimate: as in ``step``.
            capacity: for how many ticks the program is compiled and its memory held; calls of different ``ticks`` and
                the same capacity share a program. None: 50, or ``ticks`` where these are more.

        Raises:
            UsageError: more ticks than the capacity, and what ``step`` refuses.
        """
        actions = self._checker.actions(command, lambda: self.valid)
        estimates = self._checker.estimates(estimate)
        count = checked_ticks(ticks, self.tick)
        if capacity is None:
            capacity = max(CAPACITY, count)
        if count > capacity:
            raise UsageError(f"ticks: {count} is more than the capacity, {capacity}; give capacity={count}, or none")
        layout, state = self._running()
        self._detach_seen()
        with self.precision_context():
            self._state, rows = self._ticks.record(layout, state, self.tick, count, (actions, estimates), capacity)
            numbers = np.arange(self.tick + 1, self.tick + count + 1)
            self.tick += count
        return History(numbers, self.world.time_step, layout, rows)

    @alone
    def set_state(self, state: object, new_battery: bool = False) -> Reading:
        """Place vehicles in given states, where stopped ones fly again; return the reading there.

        All that belongs to such a vehicle is as at a start at that place: its sensors (GNSS, barometer, attitude, and
        what they deliver later), what its controller is fed with, its control loops, and the gusts around it. It keeps
        its way along its route, and its battery. Time, mean wind, satellites, faults and the other vehicles go on.
        First errors are drawn from the numbers of this tick, so that the same state set at the same tick of an episode
        brings the same reading.

        Args:
            state: (n, 13) position NED [m], roll, pitch, yaw [rad], body velocity [m/s], body rates [rad/s] and thrust
                [N]; (n, 12) without thrust, which is then the weight; (n, 6) at rest; or (n, 3) level and facing north
                too. A row of NaN leaves its vehicle as it is.
            new_battery: give each vehicle that is placed a battery as at the start of an episode.

        Raises:
            UsageError: another shape, a row that is partly NaN, or a state beyond area and limits or in collision.
        """
        layout, before = self._running()
        rows, chosen = checked_rows(state, self.vehicle_names, self.dtype)
        with self.precision_context():
            changed = self._ticks.place(layout, before, self.tick, (rows, chosen, chosen & new_battery))
            fleets = layout.unpack(changed).fleets
            refuse_misplaced([fleet.violation for fleet in fleets], chosen, self.vehicle_names)
            self._state, self._now = changed, no_seen_state
        return self.reading

    @alone
    def save(self, path: str | Path | None = None) -> bytes:
        """Return the whole state as bytes; with a path, also write them to a file.

        Raises:
            UsageError: the simulation has not started.
            RunError: the file cannot be written.
        """
        _, state = self._running()
        floats, integers = (np.array(buffer) for buffer in state)
        where = (self.tick, self.seed, self.number)
        data = SavedState(floats, integers, *where, self.name, self._fingerprint(), self._injections_text()).to_bytes()
        if path is not None:
            write(path, data)
        return data

    @alone
    def load(self, source: bytes | str | Path) -> Reading:
        """Continue from a saved state of the same scenario and parameters, bit for bit as the original would.

        What is read is checked first, and where it is refused, nothing has changed.

        Raises:
            UsageError: it is no saved state, a damaged one, or one of another scenario or version.
        """
        saved = SavedState.of(source)
        saved.check(self.name, self._fingerprint())
        with self.precision_context():
            keys = keys_of(self.world, Key.root(saved.seed, saved.number))
            layout, own = self._running() if self._layout is not None else self._ticks.reset(keys)
            buffers = saved.buffers(layout, own)
            saved.check_state(self.world, layout.unpack(buffers), keys)
            self._inject_again(saved.injections)
            self._state = self._ticks.adopt(buffers)
            self._layout, self._now = layout, no_seen_state
            self.tick, self.seed, self.number = saved.tick, saved.seed, saved.number
        return self.reading

    def _fingerprint(self) -> str:
        """Return a digest of the world's parameters, without injected changes, which saved states hold for a check."""
        first = self._first_world
        ticks = self._ticks if first is self.world else OneWorld(first)
        return fingerprint(ticks.layout, ticks.parameters)

    @property
    def compiled_by(self) -> tuple[str, str]:
        """Compiler of the program that flew the last ticks ("llvm" or "xla"), and the reason if it is not "llvm".

        The compiler is "llvm" (machine code by qrsim) or "xla"; the reason is "" if "llvm" compiled it or was not
        tried.
        """
        self._running()
        program = self._ticks.flown_by
        return program.compiler, program.refused

    @property
    def packed(self) -> tuple[Packer, Buffers]:
        """Layout and flat buffers of the present state; copy the buffers before the next step overwrites them."""
        return self._running()

    @property
    def state(self) -> State:
        """Whole present state as NumPy arrays."""
        with self._lock:
            return self._seen().whole()

    def _seen(self) -> Seen:
        """Return the present state, unpacked on demand; the same object while a caller holds it."""
        seen = self._now()
        if seen is None:
            layout, state = self._running()
            if self._offsets is None or self._offsets.layout is not layout:
                self._offsets = StateOffsets(self.world, layout)
            seen = Seen(self._offsets, state)
            self._now = weakref.ref(seen)
        return seen

    def _detach_seen(self) -> None:
        """Copy the present state for callers that hold it, before the next tick overwrites its buffers."""
        seen = self._now()
        if seen is not None:
            seen.keep()
            self._now = no_seen_state

    @property
    def history(self) -> History:
        """Present state as a History of one tick."""
        with self._lock:
            layout, state = self._running()
            ticks, (floats, integers) = np.array([self.tick]), (np.array(buffer)[None] for buffer in state)
        return History(ticks, self.world.time_step, layout, (floats, integers))

    @property
    def reading(self) -> Reading:
        """Present sensor readings and estimates of all fleets."""
        with self._lock:
            return Reading(self.world, cast(State, self._seen()), self.tick, self.site)

    @property
    def truth(self) -> Truth:
        """Present true state of all vehicles, in the order of the fleets."""
        with self._lock:
            return Truth(self.world, self._seen())

    @property
    def valid(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Which vehicles still fly, (n,) bool."""
        with self._lock:
            return np.concatenate([fleet.violation.code == 0 for fleet in cast(State, self._seen()).fleets])

    @property
    def reasons(self) -> list[str]:
        """Why each of the n vehicles has stopped, as text (kind, field and value); "" while it flies."""
        with self._lock:
            found = [fleet.violation for fleet in cast(State, self._seen()).fleets]
        return [reason_text(int(code), float(x)) for one in found for code, x in zip(one.code, one.value, strict=True)]

    def waypoint(self, position_ned: Any, yaw_rad: Any = 0.0) -> WaypointSetpoint:
        """Return a set-point for ``step``: positions (n, 3) or (3,) [m] and headings (n,) or one [rad]."""
        return self._checker.waypoint(position_ned, yaw_rad)

    def _running(self) -> tuple[Packer, Buffers]:
        """Return the layout and buffers of the present state; raises UsageError before the first reset."""
        if self._layout is None or self._state is None:
            raise UsageError("the simulation has not started: call reset() first")
        return self._layout, self._state

    def precision_context(self) -> contextlib.AbstractContextManager[Any]:
        """Return a context in which JAX computes in this simulation's precision."""
        return jax.enable_x64(self.dtype == np.float64)
