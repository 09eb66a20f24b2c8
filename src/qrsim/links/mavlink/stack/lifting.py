"""Heights that are held by throttle, where clients say how a vehicle leans, and the ground below them."""

from __future__ import annotations

import math

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.landing import IDLE_AFTER, LANDED_AFTER, Touchdown

# Speed per height error [1/s], acceleration per speed error [1/s], and per its integral [1/s^2].
HEIGHT_GAIN, CLIMB_GAIN, CLIMB_INTEGRAL, MOST_INTEGRAL, GRAVITY = 1.0, 2.5, 1.0, 3.0, 9.80665


class Lift:
    """Throttle and ground of one vehicle that is asked to climb or sink at a speed.

    Attributes:
        touchdown: tells when it has landed.
    """

    def __init__(self) -> None:
        self.touchdown = Touchdown()
        self._stood, self._integral = True, 0.0

    def begin(self, craft: Craft) -> None:
        """Forget ground contact and integral, when flight by attitude set-points begins."""
        self.touchdown.clear()
        self._stood, self._integral = not craft.flies, 0.0

    def stands(self, craft: Craft, rises: bool, lands: bool) -> tuple[Order | None, bool] | None:
        """Return, for a vehicle that stays on the ground: its idle order, and whether it has landed; None if it flies.

        Args:
            craft: vehicle.
            rises: whether it is asked to take off.
            lands: whether it flies and is asked to come down.
        """
        here = craft.seen.position_ned
        if not craft.flies and not rises:
            self._stood = True
            return craft.idle(), self.touchdown.seconds(craft, here[2]) >= LANDED_AFTER
        if self._stood:
            self._stood, self._integral = False, 0.0
            craft.path.shift(here)
        on = self.touchdown.seconds(craft, craft.path.position[2]) if lands else 0.0
        if on >= IDLE_AFTER:
            return craft.idle(), on >= LANDED_AFTER
        if not lands:
            self.touchdown.clear()
        return None

    def throttle(self, craft: Craft, sinks: float, speeds: Triple) -> float:
        """Return the throttle, 0 to 1, for a descent speed ``sinks`` [m/s], and advance the path's height by one tick;
        horizontal motion is left alone.

        Args:
            craft: vehicle.
            sinks: speed downwards that it is asked for [m/s].
            speeds: largest horizontal, upward and downward speed [m/s].
        """
        seen, path, dt = craft.seen, craft.path, craft.facts.time_step
        here, speed = seen.position_ned, seen.velocity_ned
        path.position = (here[0], here[1], path.position[2])
        path.velocity, path.acceleration = (speed[0], speed[1], path.velocity[2]), (0.0, 0.0, path.acceleration[2])
        craft.go(path.position, speeds, along=(speed[0], speed[1], sinks))
        error = speed[2] - path.velocity[2] - HEIGHT_GAIN * (path.position[2] - here[2])
        self._integral = min(max(self._integral + CLIMB_INTEGRAL * error * dt, -MOST_INTEGRAL), MOST_INTEGRAL)
        tilted = math.cos(seen.attitude[0]) * math.cos(seen.attitude[1])
        lift = max(1.0 + (CLIMB_GAIN * error + self._integral) / GRAVITY, 0.1) / max(tilted, 0.5)
        return min(craft.facts.hover_throttle * lift, 1.0)
