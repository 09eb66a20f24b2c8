"""Failsafes: battery, fence, link to the ground and offboard; each says what a vehicle is to do, and why."""

from __future__ import annotations

import math

from qrsim.control.failsafes import (
    DISARM,
    HOLD,
    LAND,
    NOTHING,
    RETURN,
    TERMINATE,
    battery_action,
    battery_level,
    graver,
    is_lost,
    link_action,
)
from qrsim.links.mavlink.stack.codes import FIXED_WING, Breach, Severity
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.mavlink.stack.offboard import Offboard
from qrsim.links.mavlink.stack.orbits import can_turn
from qrsim.links.mavlink.stack.path import VERTICAL, braking_way
from qrsim.links.mavlink.stack.statuses import FenceStatus

MODE_OF = {HOLD: Mode.HOLD, RETURN: Mode.RTL, LAND: Mode.LAND}
GRAVITY_OF = {mode: gravity for gravity, mode in MODE_OF.items()}
# By the parameters' numbers.
_FENCE = {0: NOTHING, 1: NOTHING, 2: HOLD, 3: RETURN, 4: TERMINATE, 5: LAND}
_OFFBOARD = {0: HOLD, 1: HOLD, 2: HOLD, 3: RETURN, 4: LAND, 5: HOLD, 6: TERMINATE, 7: DISARM}
_BATTERY = (
    ("", Severity.INFO, ""),
    ("Low battery level", Severity.WARNING, "BAT_LOW_THR"),
    ("Critical battery level", Severity.CRITICAL, "BAT_CRIT_THR"),
    ("Dangerous battery level", Severity.EMERGENCY, "BAT_EMERGEN_THR"),
)
# The fence is looked at so often [s].
FENCE_EVERY = 0.1
# A vehicle answers so late that it shall stop [s].
REACTS = 0.5


class Failsafes:
    """The failsafes of one vehicle.

    Attributes:
        breached: whether it is outside the fence.
        link_lost: whether a ground station that was heard is heard no more.
    """

    def __init__(self) -> None:
        self.breached = self.link_lost = False
        self._battery = 0
        self._fence_due = 0.0
        self._breaches, self._breach, self._breached_at = 0, Breach.NONE, 0.0
        self._ground_heard: float | None = None

    def heard_ground(self, craft: Craft) -> None:
        """Note the time of a ground station's heartbeat, for the data-link failsafe."""
        self._ground_heard = craft.seen.time
        if self.link_lost:
            self.link_lost = False
            craft.say(Severity.INFO, "Link to the ground regained")

    def armed(self) -> None:
        """Forget the battery level and fence breach of the last flight; called when the vehicle is armed."""
        self._battery, self.breached, self._fence_due = 0, False, 0.0

    def fence(self) -> FenceStatus:
        """Return the fields of FENCE_STATUS: whether the fence is breached, how often, and how."""
        return FenceStatus(self.breached, self._breaches, self._breach, self._breached_at)

    def look(self, craft: Craft, mode: Mode, offboard: Offboard, factor: float) -> int:
        """Check battery, fence, data link and set-points in flight; return the failsafe action that begins now, or
        NOTHING."""
        values = craft.parameters.values
        stretch = max(1.0, factor)
        asked = self._look_at_battery(craft)
        if craft.seen.time >= self._fence_due:
            self._fence_due = craft.seen.time + FENCE_EVERY - 0.5 * craft.facts.time_step
            asked = graver(asked, self._look_at_fence(craft))
        heard, after = self._ground_heard, values["COM_DL_LOSS_T"] * stretch
        if heard is not None and not self.link_lost and is_lost(craft.seen.time - heard, after):
            self.link_lost = True
            action = int(link_action(True, int(values["NAV_DLL_ACT"])))
            craft.say(Severity.CRITICAL if action else Severity.INFO, "Link to the ground lost")
            asked = graver(asked, action)
        if mode is Mode.OFFBOARD and not offboard.fresh(craft, values["COM_OF_LOSS_T"] * stretch):
            if not offboard.keeps_places:
                # ArduPilot's GUIDED holds then, which is no failsafe.
                craft.say(Severity.CRITICAL, "Failsafe: no offboard set-points")
            asked = graver(asked, _OFFBOARD[int(values["COM_OBL_RC_ACT"])])
        return asked

    def look_at_sticks(self, craft: Craft, fresh: bool) -> int:
        """Return the failsafe action in a mode flown by sticks if stick positions are stale (not ``fresh``), else
        NOTHING."""
        if fresh:
            return NOTHING
        craft.say(Severity.CRITICAL, "Failsafe: no manual control input")
        # To fly on without them is no choice.
        return int(link_action(True, int(craft.parameters.values["NAV_RCL_ACT"]))) or HOLD

    def _look_at_battery(self, craft: Craft) -> int:
        """Return the failsafe action for a battery level newly reached, and warn clients; NOTHING without one."""
        charge, values = craft.seen.charge, craft.parameters.values
        if not charge <= values["BAT_LOW_THR"]:
            return NOTHING
        level = battery_level(charge, *(values[name] for _, _, name in _BATTERY[1:]))
        if level <= self._battery:
            return NOTHING
        self._battery = level
        text, severity, _ = _BATTERY[level]
        asked = int(battery_action(level, int(values["COM_LOW_BAT_ACT"])))
        word = {RETURN: ", return", LAND: ", land"}.get(asked, "")
        craft.say(severity, f"{text}{word}: {100.0 * charge:.0f} %")
        return asked

    def _look_at_fence(self, craft: Craft) -> int:
        """Return the failsafe action for a fence breach that begins now, and warn clients; NOTHING without one."""
        seen, values = craft.seen, craft.parameters.values
        action = int(values["GF_ACTION"])
        breach, why = beyond(craft) if seen.valid else (Breach.NONE, "")
        if not breach:
            if self.breached:
                craft.tell("fence")
            self.breached = False
            return NOTHING
        if self.breached or action == 0 or not craft.flies:
            return NOTHING
        self.breached, self._breaches = True, self._breaches + 1
        self._breach, self._breached_at = breach, seen.time
        craft.tell("fence")
        craft.say(Severity.CRITICAL, f"Geofence breached: {why}")
        return _FENCE[action]


def _leaves(craft: Craft) -> Breach:
    """Return which limit of the flight area the vehicle would cross before it could stop: boundary, ceiling or none."""
    (north, east, down), (vn, ve, vd) = craft.seen.position_ned, craft.seen.velocity_ned
    speed = math.hypot(vn, ve)
    if abs(vd) > 0.5:
        down += REACTS * vd + math.copysign(braking_way(abs(vd), VERTICAL), vd)
        if down < craft.facts.z_min or (vd < 0.0 and not craft.area.inside(north, east, down)):
            return Breach.CEILING
    if craft.facts.mav_type == FIXED_WING:
        return Breach.NONE if can_turn(craft) else Breach.BOUNDARY
    if speed < 0.5:
        return Breach.NONE
    seconds = REACTS + braking_way(speed, craft.parameters["MPC_ACC_HOR"]) / speed
    return Breach.NONE if craft.area.inside(north + seconds * vn, east + seconds * ve, down) else Breach.BOUNDARY


def beyond(craft: Craft) -> tuple[Breach, str]:
    """Return which limit of fence or flight area the vehicle breaches or is about to, and a text; (NONE, "") without
    one."""
    here, values = craft.seen.position_ned, craft.parameters.values
    if not craft.fence.inside(*here):
        return Breach.BOUNDARY, "outside the area"
    leaves = _leaves(craft)
    if leaves:
        return leaves, "about to leave the area of the scenario"
    far, high = values["GF_MAX_HOR_DIST"], values["GF_MAX_VER_DIST"]
    if craft.home is None or not (far or high):
        return Breach.NONE, ""
    home = craft.home.position_ned
    if far and math.hypot(here[0] - home[0], here[1] - home[1]) > far:
        return Breach.BOUNDARY, f"farther than {far:g} m from home"
    if high and home[2] - here[2] > high:
        return Breach.CEILING, f"higher than {high:g} m over home"
    return Breach.NONE, ""
