"""A world that several controllers share: whose orders each vehicle flies by, and what happens in silence."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.messages import checked_message
from qrsim.links.contracts import ON_SILENCE, Order, Silence, Words
from qrsim.links.shared.claims import Claims
from qrsim.links.shared.failsafe import believed_of, failsafe
from qrsim.links.shared.latches import Latches
from qrsim.links.shared.spoken import Spoken
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Some

# By what a vehicle flies, by number in a recording.
FLIES = ("guidance", "command", "hold", "return", "stop")
_DOES = {
    "guidance": "flies by its guidance, as it takes no such order",
    "hold": "holds its place",
    "return": "returns to above its start",
    "stop": "stops its motors",
}
_ON = {"guidance": "by its guidance", "command": "by its last order"}
# Silence is worth a line after so long, where nothing else comes of it [s].
SAID_AFTER_S = 0.5


@dataclass
class Controlled:
    """What is known of a vehicle's controller.

    Attributes:
        flies: by what, one of FLIES.
        silence: what it does without its controller.
        source_tick: of the last order, of the readings that it was computed from; None: unknown, or no order.
        arrival_tick: at which the last order arrived; None: there was none.
        heard: tick until which nothing more was to be heard.
        misses: how often a barrier went on without its controller.
        silent_since: tick of the last order, once nothing was heard for too long.
        lost: its controller has gone.
        waiting: order that the next tick flies.
    """

    flies: str = "guidance"
    silence: Silence = field(default_factory=Silence)
    source_tick: int | None = None
    arrival_tick: int | None = None
    heard: int = 0
    misses: int = 0
    silent_since: int | None = None
    lost: bool = False
    waiting: Order | None = None


class Plant:
    """Claims, orders and silence of one simulation. Nothing here waits or knows of connections.

    Args:
        simulation: reset; who has it calls ``begin`` before the ticks that it flies.
        silence: of claims that say nothing else.
        factor: simulated seconds per second of the wall clock; 0: unknown.
        note: told what happened: kind, vehicle and one line.

    Attributes:
        claims: who may command which vehicle.
        latches: what they fly by.
        controlled: by vehicle.
        now: the tick at which what arrives now arrives.
        spoken: what is said over the radio; None: there is none.
        flown: what the ticks since the last ``begin`` are flown by, (n,) or (n, V) each, by name.
    """

    def __init__(
        self,
        simulation: Simulation,
        silence: Silence | None = None,
        factor: float = 0.0,
        note: Callable[[str, str, str], None] = lambda kind, vehicle, text: None,
    ):
        self.simulation, self._default, self._note = simulation, silence or Silence(), note
        self.keep_pace(factor)
        self.spoken = None if simulation.world.radio is None else Spoken(simulation)
        self.latches = Latches(simulation.world.fleets, simulation.dtype)
        names = self.latches.names
        self.claims = Claims(names, [name for name in names if not self.latches.kinds(name)])
        self.controlled: dict[str, Controlled] = {}
        self.restart()

    def keep_pace(self, factor: float) -> None:
        """Set the real-time factor by which a client's silence is converted to simulated time; 0: unknown."""
        self._stretch = max(1.0, factor)

    def restart(self) -> None:
        """Reset for a new episode: all vehicles fly by their scenario's guidance, and clients keep their claims."""
        before = self.controlled
        self.controlled = {name: Controlled() for name in self.latches.names}
        for name, now in self.controlled.items():
            self.latches.clear(name)
            if name in before and self.claims.holder(name):
                now.silence = before[name].silence
        if self.spoken is not None:
            self.spoken = Spoken(self.simulation)
        self._home = self.simulation.truth.position_ned.copy()
        self.now = self.simulation.tick
        # Of all vehicles at a tick, where somebody has to know it.
        self._believed: NumpyArray | None = None
        self._store_flown()

    # ---- what controllers ask ----

    def claim(self, holder: int, names: Sequence[str] = (), silence: Silence | None = None) -> tuple[str, ...]:
        """Claim vehicles for client number ``holder`` (no names: all free ones); return the newly claimed names.

        Args:
            holder: number of the controller.
            names: of vehicles; those that it has already stay its own.
            silence: of all of them; None: the default for those that are new.

        Raises:
            UsageError: see ``Claims.take``.
        """
        found = self.claims.take(holder, names)
        for name in found:
            now = self.controlled[name]
            now.silence, now.lost = self._default, False
            now.heard, now.silent_since, now.misses = self.now, None, 0
            now.source_tick = now.arrival_tick = None
        if silence is not None:
            for name in (*found, *names):
                self.controlled[name].silence = silence
        return found

    def release(self, holder: int, names: Sequence[str] = ()) -> tuple[str, ...]:
        """Return vehicles of client number ``holder`` to their scenario's guidance; return their names; raises
        UsageError."""
        found = self.claims.give_back(holder, names)
        for name in found:
            self.controlled[name] = Controlled()
            self.latches.clear(name)
        return found

    def lose(self, holder: int) -> tuple[str, ...]:
        """Free the vehicles of client number ``holder``, which has left; they do what is set for silence. Return their
        names."""
        found = self.claims.give_back(holder)
        for name in found:
            now = self.controlled[name]
            now.lost, now.waiting = True, None
        return found

    def check(self, holder: int, orders: Sequence[Order]) -> None:
        """Raise UsageError if client number ``holder`` may not give one of these orders.

        Raises:
            UsageError: one is for a vehicle that it has not claimed, or cannot be flown.
        """
        for order in orders:
            self.claims.check_own(holder, order.vehicle, "COMMAND")
            self.latches.checked(order)

    def order(self, orders: Sequence[Order], source_tick: int | None = None) -> None:
        """Queue checked orders, which take effect at the next ``begin``; ``source_tick``: tick of the readings they are
        based on."""
        for order in orders:
            now = self.controlled[order.vehicle]
            now.waiting, now.source_tick, now.arrival_tick = order, source_tick, self.now
            now.heard = max(now.heard, self.now)

    def say(self, holder: int, words: Sequence[Words]) -> None:
        """Queue radio messages of vehicles of client number ``holder``, all or none; the next ``begin`` sends them.

        Raises:
            UsageError: one is of a vehicle that it has not claimed, or cannot be said.
        """
        checked = []
        for each in words:
            self.claims.check_own(holder, each.vehicle, "SAY")
            world = self.simulation.world
            checked.append(checked_message(world, self.latches.names, each.vehicle, each.numbers, each.to))
        for sender, numbers, receiver in checked:
            assert self.spoken is not None
            self.spoken.waiting[sender] = numbers, receiver

    def heard_until(self, holder: int, tick: int) -> None:
        """Do not count client number ``holder`` as silent before a tick, since it waits for that tick at the
        barrier."""
        for name in self.claims.of(holder):
            self.controlled[name].heard = max(self.controlled[name].heard, tick)

    def missed(self, holder: int) -> None:
        """Count a tick that was flown without waiting for client number ``holder``."""
        for name in self.claims.of(holder):
            self.controlled[name].misses += 1

    # ---- ticks ----

    def begin(self) -> dict[str, Some]:
        """Apply queued orders and failsafes of silent vehicles, and return the action of each fleet for the next
        ticks."""
        self.now, self._believed = self.simulation.tick, None
        if self.spoken is not None:
            self.spoken.hand_over(self.simulation)
        for name, now in self.controlled.items():
            if now.waiting is not None:
                self._apply_order(name, now, now.waiting)
            elif now.lost or self.claims.holder(name):
                self._check_silence(name, now)
        self._store_flown()
        return self.latches.actions()

    def _store_flown(self) -> None:
        """Store each vehicle's present order, its source tick and its client in ``flown``, for the recording."""
        controlled, latches = self.controlled.values(), self.latches
        self.flown = {
            "kind": latches.codes.copy(),
            "numbers": latches.numbers.copy(),
            "flies": np.array([FLIES.index(now.flies) for now in controlled]),
            "client": np.array([self.claims.holder(name) for name in latches.names]),
            "source_tick": np.array([-1 if now.source_tick is None else now.source_tick for now in controlled]),
            "arrival_tick": np.array([-1 if now.arrival_tick is None else now.arrival_tick for now in controlled]),
        }
        if self.spoken is not None:
            self.flown |= self.spoken.columns()

    def _apply_order(self, name: str, now: Controlled, order: Order) -> None:
        """Let a vehicle (``now``: its state of control) fly a queued order, and end its silence."""
        self.latches.put(order)
        now.flies, now.waiting = "command", None
        if now.silent_since is not None:
            since = now.silent_since * self._dt
            self._note("controller_back", name, f"commanded again, after silence since {since:.10g} s")
            now.silent_since = None

    def _check_silence(self, name: str, now: Controlled) -> None:
        """Start a vehicle's silence behaviour (hold, return, stop) if its client has been silent too long; ``now``: its
        state of control."""
        lost, now.lost = now.lost, False
        silent, after = self.simulation.tick - now.heard, now.silence.after
        limit = math.ceil((after or SAID_AFTER_S) * self._stretch / self._dt - 1e-9)
        overdue = silent >= limit and now.silent_since is None
        if now.flies not in ("guidance", "command") or not (lost or overdue):
            return
        now.silent_since = now.heard
        why = "its controller has gone" if lost else "nothing is heard from its controller"
        since = f"{why}; last order at {now.heard * self._dt:.10g} s" if now.arrival_tick is not None else why
        if not lost and not after:
            self._note("controller_silent", name, f"{since}; it flies on {_ON[now.flies]}")
            return
        row = self.latches.row(name)
        if self._believed is None:
            self._believed = believed_of(self.simulation)
        order = failsafe(now.silence.does, name, self._believed[row], self._home[row], self.latches.kinds(name))
        if order is None:
            self.latches.clear(name)
            now.flies = "guidance"
        else:
            self.latches.put(order)
            now.flies = now.silence.does
        self._note("controller_silent", name, f"{since}; it {_DOES[now.flies]}")

    @property
    def _dt(self) -> float:
        """Return the simulation's time step [s]."""
        return self.simulation.world.time_step

    def age(self, vehicle: str) -> float | None:
        """Return the age [s] of a vehicle's last order, None if it has none."""
        arrived = self.controlled[vehicle].arrival_tick
        return None if arrived is None else (self.simulation.tick - arrived) * self._dt


def checked_silence(does: str, after: float, what: str) -> Silence:
    """Return a checked reaction to silence, ``does``, and the time ``after`` [s] of silence before it.

    Raises:
        UsageError: one of them is not allowed.
    """
    if does not in ON_SILENCE:
        hint = did_you_mean(does[:60], ON_SILENCE)
        raise UsageError(f"{what} '{does[:60]}': expected {' or '.join(ON_SILENCE)}{hint}")
    if not (math.isfinite(after) and 0.0 <= after <= 1e6):
        raise UsageError(f"hold {after:g} s: expected a number of seconds, or 0 for never")
    return Silence(does, after)  # type: ignore[arg-type]
