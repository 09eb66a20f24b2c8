"""Sticks: MANUAL_CONTROL and RC_CHANNELS_OVERRIDE, and the modes that are flown by them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.landing import LANDED_AFTER
from qrsim.links.mavlink.stack.lifting import Lift
from qrsim.links.mavlink.stack.modes import Mode

# PX4's MPC_HOLD_DZ and MPC_XY_MAN_EXPO (of height and heading too): around the middle a stick does nothing, and farther
# out its cube counts by this share.
DEAD, CUBIC = 0.1, 0.6
# A throttle stick that is higher takes off (FlightTaskManualAltitude), and below the second, standing, is idle.
TAKES_OFF, IDLES = 0.3, -0.9
# Least thrust in the air (MPC_MANTHR_MIN).
LEAST = 0.08
# A stick that moves by more takes over from automatic modes (COM_RC_STICK_OV).
TAKES_OVER = 0.3
# The wanted heading is at most so far from that of the vehicle [rad].
TURNS_AHEAD = 0.8


class Sticks:
    """The sticks of one vehicle: roll to the right, pitch forwards, throttle up and yaw to the right, each -1 to 1.

    Attributes:
        heard: when they were told last [s]; None before the first time.
        lands: whether they ask a vehicle that flies to come down.
    """

    def __init__(self) -> None:
        self.heard: float | None = None
        self.lands = False
        self._values = [0.0, 0.0, 0.0, 0.0]
        self._lift = Lift()

    def take(self, values: Sequence[float], craft: Craft) -> bool:
        """Store stick positions roll, pitch, throttle, yaw, -1 to 1 (NaN keeps the last); return whether one has moved
        far."""
        if all(map(math.isnan, values)):
            return False
        before = list(self._values)
        for axis, value in enumerate(values):
            if not math.isnan(value):
                self._values[axis] = min(max(value, -1.0), 1.0)
        known, self.heard = self.heard is not None, craft.seen.time
        return known and any(abs(a - b) > TAKES_OVER for a, b in zip(before, self._values, strict=True))

    def fresh(self, craft: Craft, limit: float) -> bool:
        """Return whether stick positions arrived within the last ``limit`` [s]."""
        return self.heard is not None and craft.seen.time - self.heard < limit + 0.01 * craft.facts.time_step

    def begin(self, craft: Craft) -> None:
        """Reset flight by sticks, when such a mode begins."""
        craft.begin_path()
        craft.yaw = craft.seen.attitude[2]
        self._lift.begin(craft)

    def fly(self, craft: Craft, mode: Mode) -> tuple[Order | None, bool]:
        """Return the order that the sticks give in POSITION, ALTITUDE or STABILIZED mode, and whether the vehicle has
        landed."""
        self._turn(craft)
        if mode is Mode.STABILIZED:
            return self._stabilized(craft)
        throttle = _shaped(self._values[2])
        self.lands = craft.flies and throttle < 0.0
        stands = self._lift.stands(craft, self._values[2] > TAKES_OFF, self.lands)
        if stands is not None:
            return stands
        order = self._position(craft, throttle) if mode is Mode.POSITION else self._altitude(craft, throttle)
        return order, False

    def _turn(self, craft: Craft) -> None:
        """Turn the commanded heading at the yaw stick's rate; on the ground, set it to the vehicle's heading."""
        yaw = craft.seen.attitude[2]
        if not craft.flies:
            craft.yaw = yaw
            return
        rate = math.radians(craft.parameters["MPC_MAN_Y_MAX"]) * _shaped(self._values[3])
        ahead = math.remainder(craft.yaw + rate * craft.facts.time_step - yaw, 2.0 * math.pi)
        craft.turn_to(yaw + min(max(ahead, -TURNS_AHEAD), TURNS_AHEAD) if rate else craft.yaw)

    def _speeds(self, craft: Craft) -> Triple:
        """Return the speeds [m/s] at full stick deflection: horizontal, up, down."""
        values, facts = craft.parameters.values, craft.facts
        return (
            min(values["MPC_VEL_MANUAL"], facts.speed_limit),
            min(values["MPC_Z_VEL_MAX_UP"], facts.climb_limit),
            min(values["MPC_Z_VEL_MAX_DN"], facts.sink_limit),
        )

    def _position(self, craft: Craft, throttle: float) -> Order:
        """Return the order to fly at the sticks' velocity along and across the heading; centred sticks hold the
        position."""
        level, up, down = speeds = self._speeds(craft)
        right, forward = _in_circle(_shaped(self._values[0]), _shaped(self._values[1]))
        sine, cosine = math.sin(craft.yaw), math.cos(craft.yaw)
        along = (
            level * (forward * cosine - right * sine),
            level * (forward * sine + right * cosine),
            -throttle * (up if throttle > 0.0 else down),
        )
        return craft.go(craft.path.position, speeds, along=along)

    def _altitude(self, craft: Craft, throttle: float) -> Order:
        """Return the order to tilt by the sticks and climb by the throttle stick; horizontal motion is not braked."""
        _, up, down = speeds = self._speeds(craft)
        roll, pitch = self._tilt(craft, shaped=True)
        return craft.lean(roll, pitch, self._lift.throttle(craft, -throttle * (up if throttle > 0.0 else down), speeds))

    def _stabilized(self, craft: Craft) -> tuple[Order | None, bool]:
        """Return the order to tilt by the sticks with the throttle stick as thrust, and whether the vehicle has
        landed."""
        self.lands = False
        throttle = self._values[2]
        if craft.seen.on_ground and throttle < IDLES:
            return craft.idle(), self._lift.touchdown.seconds(craft, craft.seen.position_ned[2]) >= LANDED_AFTER
        self._lift.touchdown.clear()
        thrust = max(0.5 * (throttle + 1.0), LEAST)
        hover = craft.facts.hover_throttle
        lift = hover * 2.0 * thrust if throttle <= 0.0 else hover + (1.0 - hover) * throttle
        roll, pitch = self._tilt(craft, shaped=False)
        return craft.lean(roll, pitch, lift), False

    def _tilt(self, craft: Craft, shaped: bool) -> tuple[float, float]:
        """Return the roll and pitch [rad] that the sticks command; ``shaped``: by the exponential curve."""
        most = math.radians(craft.parameters["MPC_MAN_TILT_MAX"]) * craft.freedom
        right, forward = (_shaped(value) if shaped else value for value in self._values[:2])
        right, forward = _in_circle(right, forward)
        return most * right, -most * forward


def _shaped(value: float) -> float:
    """Apply dead zone and exponential curve to a stick position, -1 to 1, as PX4's ``expo_deadzone`` does."""
    beyond = math.copysign(max(abs(value) - DEAD, 0.0) / (1.0 - DEAD), value)
    return (1.0 - CUBIC) * beyond + CUBIC * beyond**3


def _in_circle(right: float, forward: float) -> tuple[float, float]:
    """Limit the deflection of a stick, right and forward, to the unit circle."""
    size = math.hypot(right, forward)
    return (right / size, forward / size) if size > 1.0 else (right, forward)
