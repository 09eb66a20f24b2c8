"""Vehicles as other nodes fly them: what was asked of each last, as orders of every tick, and what silence does."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from qrsim.errors import UsageError
from qrsim.links.contracts import Order
from qrsim.links.ros2.commands import Motion, Place, Thrust, Tilt, Wish
from qrsim.links.shared.failsafe import believed_of, failsafe
from qrsim.links.shared.latches import Latches
from qrsim.simulation.simulation import Simulation


@dataclass
class Pilot:
    """What one vehicle was asked last.

    Attributes:
        wish: motion or attitude that each tick makes an order of; None: the latched order stays.
        tick, at: of the world and of the wall clock [s], at which it was heard.
        mode: by what the vehicle flies: "guidance", "velocity", "position", "attitude" or "hold".
        yaw: heading that it is to have [rad].
        throttle: of an attitude.
        told: what was said of it, until something is flown again.
    """

    wish: Motion | Tilt | None = None
    tick: int = 0
    at: float = 0.0
    mode: str = "guidance"
    yaw: float | None = None
    throttle: float | None = None
    told: str = ""


class Pilots:
    """All vehicles of a world.

    A vehicle goes by its scenario's guidance until it is asked for something. Motions and attitudes hold until nothing
    is heard for ``hold`` seconds; then, and where it is asked for what it cannot fly, the vehicle holds its place. A
    place holds until something else is asked.

    Args:
        simulation: reset.
        hold: silence [s] after which a vehicle holds its place; of the wall clock where the world runs faster.
        factor: simulated seconds per second of the wall clock.
        say: told one line of what is not flown.
        by_wall: whether silence is of the wall clock, because the world has no pace.
    """

    def __init__(
        self, simulation: Simulation, hold: float, factor: float, say: Callable[[str], None], by_wall: bool = False
    ):
        self._simulation, self._say, self._wall = simulation, say, hold if by_wall else None
        self._limit = math.ceil(hold * max(1.0, factor) / simulation.world.time_step - 1e-9)
        self.latches = Latches(simulation.world.fleets, simulation.dtype)
        self._names = self.latches.names
        self.restart()

    def restart(self) -> None:
        """Start an episode: all vehicles fly by their scenario's guidance until they receive commands."""
        self._pilots = [Pilot() for _ in self._names]
        self._home = np.asarray(self._simulation.truth.position_ned, np.float64).copy()
        for name in self._names:
            self.latches.clear(name)

    @property
    def modes(self) -> list[str]:
        """Return for each vehicle the kind of command that it flies, such as "position"."""
        return [pilot.mode for pilot in self._pilots]

    def ask(self, row: int, wish: Wish) -> None:
        """Store the command that a ROS node requests for the vehicle at ``row``; a position takes effect at once."""
        pilot = self._pilots[row]
        pilot.tick, pilot.at = self._simulation.tick, time.monotonic()
        if isinstance(wish, Thrust):
            pilot.throttle = wish.throttle
            return
        if isinstance(wish, Place):
            pilot.wish = None
            yaw = self._estimated_heading(row) if wish.yaw is None else wish.yaw
            self._fly_order(row, Order(self._names[row], "waypoint", (*wish.position_ned, yaw)), "position")
            return
        if not (isinstance(wish, Motion) and isinstance(pilot.wish, Motion)):
            pilot.yaw = None
        pilot.wish = wish

    def refuse(self, row: int, why: str) -> None:
        """Let the vehicle at ``row`` hold its position after an invalid command, and report the reason ``why`` once."""
        self._hold_position(row, why)

    def actions(self) -> object:
        """Return the action of each fleet in the next tick, for ``Simulation.advance``."""
        self._update_orders()
        return self.latches.actions()

    def advance(self) -> None:
        """Advance the simulation by one tick with what was asked of the vehicles."""
        self._update_orders()
        self.latches.advance(self._simulation)

    @property
    def waited_for(self) -> bool:
        """Return whether a vehicle that is flown by velocities or attitudes lacks its command for the present tick."""
        tick = self._simulation.tick
        return any(
            pilot.wish is not None and pilot.tick < tick and not self._is_silent(pilot) for pilot in self._pilots
        )

    def _is_silent(self, pilot: Pilot) -> bool:
        """Return whether the vehicle's last command is older than the timeout."""
        if self._wall is not None:
            return time.monotonic() - pilot.at >= self._wall
        return self._simulation.tick - pilot.tick >= self._limit

    def _update_orders(self) -> None:
        """Convert the last motions and attitudes to orders; vehicles without recent ones hold their position."""
        rows = [row for row, pilot in enumerate(self._pilots) if pilot.wish is not None]
        if not rows:
            return
        believed = believed_of(self._simulation)
        for row in rows:
            pilot = self._pilots[row]
            if self._is_silent(pilot):
                silent = (self._simulation.tick - pilot.tick) * self._simulation.world.time_step
                self._hold_position(row, f"nothing is heard for {silent if self._wall is None else self._wall:.10g} s")
            elif isinstance(pilot.wish, Motion):
                self._fly_motion(row, pilot, pilot.wish, float(believed[row, 3]))
            elif isinstance(pilot.wish, Tilt) and pilot.throttle is not None:
                numbers = (*pilot.wish.angles, pilot.throttle)
                self._fly_order(row, Order(self._names[row], "attitude", numbers), "attitude")

    def _fly_motion(self, row: int, pilot: Pilot, wish: Motion, heading: float) -> None:
        """Give the vehicle at ``row`` a velocity order from a Motion, with its yaw rate integrated to a yaw near the
        present ``heading`` [rad]."""
        yaw = heading if pilot.yaw is None else pilot.yaw
        # The heading that is asked for runs ahead of the vehicle by no more than a quarter turn.
        step = wish.yaw_rate * self._simulation.world.time_step
        ahead = math.remainder(yaw + step - heading, 2.0 * math.pi)
        pilot.yaw = yaw = math.remainder(heading + max(-math.pi / 2, min(math.pi / 2, ahead)), 2.0 * math.pi)
        north, east, down = wish.velocity
        if wish.of_heading:
            forward, right = north, east
            cosine, sine = math.cos(heading), math.sin(heading)
            north, east = cosine * forward - sine * right, sine * forward + cosine * right
        self._fly_order(row, Order(self._names[row], "velocity", (north, east, down, yaw)), "velocity")

    def _fly_order(self, row: int, order: Order, mode: str) -> None:
        """Give the vehicle at ``row`` an order, or let it hold its position if the order is invalid."""
        try:
            self.latches.put(self.latches.checked(order))
        except UsageError as error:
            self._hold_position(row, str(error))
            return
        pilot = self._pilots[row]
        pilot.mode, pilot.told = mode, ""

    def _hold_position(self, row: int, why: str) -> None:
        """Let the vehicle at ``row`` hold its position, and report the reason ``why`` once."""
        pilot, name = self._pilots[row], self._names[row]
        pilot.wish, pilot.throttle = None, None
        if pilot.mode != "hold":
            order = failsafe(
                "hold", name, believed_of(self._simulation)[row], self._home[row], self.latches.kinds(name)
            )
            if order is not None:
                self.latches.put(order)
                pilot.mode = "hold"
        if why != pilot.told:
            pilot.told = why
            what = "holds its place" if pilot.mode == "hold" else "goes on by its guidance"
            self._say(f"t = {self._simulation.time:.10g} s, '{name}': {why}; it {what}")

    def _estimated_heading(self, row: int) -> float:
        """Return the estimated heading [rad] of the vehicle at ``row``."""
        return float(believed_of(self._simulation)[row, 3])
