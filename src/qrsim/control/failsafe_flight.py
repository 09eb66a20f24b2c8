"""Failsafes in the compiled tick: the condition under which one replaces the guidance, and the path it flies then.

See docs/howto/failsafes.md.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from qrsim.control.failsafes import (
    DESCEND,
    HOLD,
    NOTHING,
    RETURN,
    WORDS,
    battery_action,
    battery_level,
    fix_action,
    graver,
    is_lost,
    link_action,
    position_action,
)
from qrsim.control.mission import HELD_SPEED, STEADY, TOUCHED, held
from qrsim.control.setpoints import Estimate, PathSetpoint
from qrsim.core.tree import derived, parameter, quantity, record, replace, select, setting
from qrsim.core.vectors import Vec3, root

# Phases of a flight: STAY at a place; CLIMB, FLY home, LOWER to RTL_DESCEND_ALT; DOWN to the ground.
STAY, CLIMB, FLY, LOWER, DOWN = range(5)
# A climb counts as done within this height, and a way as flown within this distance [m]; nearer to home than the last
# [m] a vehicle keeps its heading.
CLIMBED, ABOVE, TURNS = 0.5, 1.0, 2.0
# Below the ceiling of the area a return keeps so far [m].
BELOW = 3.0
# A landing slows down from the first to the second height over home [m] (PX4: MPC_LAND_ALT1, MPC_LAND_ALT2).
SLOWS_AT, SLOW_AT = 10.0, 5.0
# Vertical acceleration of the path [m/s^2].
VERTICAL = 2.0
# The path waits for a vehicle that is farther behind than the first distance [m], and stands at the second more.
WAITS_FROM, WAITS_OVER = 2.0, 3.0
# The action begins again where a vehicle is farther than this from its path [m]: a program has flown it away.
BEGINS_AGAIN = 20.0
# On the ground for so long the motors idle; for so long, it has landed [s].
IDLE_AFTER, LANDED_AFTER = 0.5, 1.0


class Watched(NamedTuple):
    """Inputs of the failsafes of vehicles (n,) at a tick; None: the fleet lacks the quantity.

    Attributes:
        estimate: position, velocity and heading.
        standing: bool, the vehicle is on the ground.
        tick: () int32 now.
        charge: charge of the battery, 0 to 1.
        fixed: bool, a GNSS receiver has a fix.
        heard: int32 tick at which the newest received message was sent; -1: none.
    """

    estimate: Estimate
    standing: Array
    tick: Array
    charge: Array | None = None
    fixed: Array | None = None
    heard: Array | None = None


@record
class FailsafeState:
    """Failsafes of vehicles (n,)."""

    action: Array = quantity(doc="int32 present action, an index of failsafes.ACTIONS")
    latched: Array = quantity(doc="int32 gravest action so far of those that last until the end of the flight")
    level: Array = quantity(doc="int32 gravest level of the battery so far, an index of failsafes.LEVELS")
    unfixed: Array = quantity(doc="int32 ticks without a fix")
    heard: Array = quantity(doc="int32 tick at which the newest received message was sent; -1: none")
    link_lost: Array = quantity(doc="bool: the link is lost")
    position_lost: Array = quantity(doc="bool: the position is lost")
    home_ned: Vec3 = quantity(unit="m", doc="the ground below the start")
    place_ned: Vec3 = quantity(unit="m", doc="scheduled point of the path")
    speed_ned: Vec3 = quantity(unit="m/s", doc="velocity of that point")
    goal_ned: Vec3 = quantity(unit="m", doc="stopping place at the begin of the action; z: height of the way home")
    yaw: Array = quantity(unit="rad", doc="heading")
    phase: Array = quantity(doc="int32 phase of the path")
    since: Array = quantity(doc="int32 ticks above home before a landing; in a landing, ticks at touchdown speed")
    waited: Array = quantity(doc="int32 ticks on the ground")
    landed: Array = quantity(doc="bool: has landed by a failsafe")
    rally_ned: Vec3 | None = quantity(
        default=None, unit="m", doc="the ground where a return lands; None: always at home"
    )

    @property
    def safe_ned(self) -> Vec3:
        """Position (n,) [m] at which a return lands: the rally point chosen, or home."""
        return self.home_ned if self.rally_ned is None else self.rally_ned

    @staticmethod
    def start(home_ned: Vec3, yaw: Array, rally: bool = False) -> FailsafeState:
        """Return the failsafe state of vehicles (n,) at the start of an episode, without any failure.

        Args:
            home_ned: home positions (n,) [m].
            yaw: headings (n,) [rad].
            rally: whether there are rally points.
        """
        count, zero = jnp.zeros(yaw.shape, jnp.int32), jnp.zeros_like(yaw)
        no, still = jnp.zeros(yaw.shape, bool), Vec3(zero, zero, zero)
        never = jnp.full_like(count, -1)
        return FailsafeState(
            count, count, count, count, never, no, no, home_ned, home_ned, still, home_ned, yaw, count, count, count,
            no, home_ned if rally else None,
        )  # fmt: skip


@record
class RallyPoint:
    """A place of each vehicle (n,) that a return may lead to instead of home; vehicles without one have it far away."""

    place_ned: Vec3 = quantity(unit="m", doc="place; a return flies there at this height or higher")
    ground_down: Array = quantity(unit="m", doc="down coordinate of the ground below it")


@record
class Failsafes:
    """Reactions of vehicles to a low battery, a lost link and lost GNSS; names and defaults are those of PX4."""

    COM_LOW_BAT_ACT: Literal["warn", "land", "return_or_land"] = setting(
        default="warn",
        doc="low battery: warn (0); land at critical (2); return at critical, land at emergency (3)",
    )
    NAV_DLL_ACT: Literal["none", "hold", "return", "land"] = setting(
        default="none", doc="link lost: none (0), hold (1), return (2) or land (3)"
    )
    COM_GNSSLOSS_ACT: Literal["warn", "return", "land"] = setting(
        default="warn", doc="no receiver has a fix: warn (0), return (1) or land (2), as long as the position is known"
    )
    link_to: str = setting(default="", doc="name of the fleet that must be heard over world.radio, for NAV_DLL_ACT")
    BAT_LOW_THR: Array = parameter(
        default=0.15, unit="1", doc="charge at which a battery is low", minimum=0.12, maximum=0.5
    )
    BAT_CRIT_THR: Array = parameter(
        default=0.07, unit="1", doc="charge at which a battery is critical", minimum=0.05, maximum=0.5
    )
    BAT_EMERGEN_THR: Array = parameter(
        default=0.05, unit="1", doc="charge at which a battery is an emergency", minimum=0.03, maximum=0.5
    )
    COM_DL_LOSS_T: Array = parameter(
        default=10.0, unit="s", doc="time without a message until the link is lost", minimum=5.0, maximum=300.0
    )
    EKF2_NOAID_TOUT: Array = parameter(
        default=5e6,
        unit="us",
        doc="time without a fix until the position is lost, and the vehicle descends",
        minimum=5e5,
        maximum=1e7,
    )
    RTL_RETURN_ALT: Array = parameter(
        default=60.0, unit="m", doc="height over home of a return", minimum=0.0, maximum=150.0
    )
    RTL_DESCEND_ALT: Array = parameter(
        default=10.0, unit="m", doc="height over home at which a return waits to land", minimum=0.0, maximum=100.0
    )
    RTL_LAND_DELAY: Array = parameter(
        default=0.0,
        unit="s",
        doc="time above home before a return lands; below 0: it does not",
        minimum=-1.0,
        maximum=100.0,
    )
    RTL_MIN_DIST: Array = parameter(
        default=10.0, unit="m", doc="distance from home within which a return climbs less", minimum=0.5, maximum=100.0
    )
    MPC_XY_CRUISE: Array = parameter(
        default=5.0, unit="m/s", doc="horizontal speed of a return", minimum=3.0, maximum=20.0
    )
    MPC_ACC_HOR: Array = parameter(
        default=3.0, unit="m/s^2", doc="largest horizontal acceleration of the path", minimum=2.0, maximum=15.0
    )
    MPC_Z_VEL_MAX_UP: Array = parameter(default=3.0, unit="m/s", doc="largest speed upwards", minimum=0.5, maximum=8.0)
    MPC_Z_VEL_MAX_DN: Array = parameter(
        default=1.5, unit="m/s", doc="largest speed downwards", minimum=0.5, maximum=4.0
    )
    MPC_LAND_SPEED: Array = parameter(
        default=0.7, unit="m/s", doc="speed of a descent, and of a landing near the ground", minimum=0.3, maximum=1.4
    )
    top: Array | None = derived(default=None, doc="down coordinate [m] of the ceiling of the area; None: no ceiling")
    rally: tuple[RallyPoint, ...] = derived(default=(), doc="rally points of the vehicles")

    def step(
        self, state: FailsafeState, seen: Watched, setpoint: PathSetpoint, dt: float
    ) -> tuple[FailsafeState, PathSetpoint]:
        """Return the new state and the set-point (n,): the guidance's own, or the failsafe's where one is active.

        Args:
            state: state of the last tick.
            seen: inputs of this tick.
            setpoint: set-point (n,) of the guidance.
            dt: step [s].
        """
        state, begins = self._decided(state, seen, dt)
        no = jnp.zeros(state.landed.shape, bool)
        idle, level = (no if flag is None else flag for flag in (setpoint.idle, setpoint.level))
        given = replace(setpoint, idle=idle, level=level, blind=no)
        acts = state.action > NOTHING

        def taken_over() -> tuple[FailsafeState, PathSetpoint]:
            """Return state and set-point with those of the failsafe for vehicles in which one is active."""
            away = acts & ((state.place_ned - seen.estimate.position_ned).norm() > BEGINS_AGAIN)
            begun = select(begins | away, self._begun(state, seen.estimate), state)
            flown, asked = self._flown(begun, seen, dt)
            return select(acts, flown, state), select(acts, asked, given)

        result: tuple[FailsafeState, PathSetpoint] = lax.cond(jnp.any(acts), taken_over, lambda: (state, given))
        return result

    def _decided(self, state: FailsafeState, seen: Watched, dt: float) -> tuple[FailsafeState, Array]:
        """Return the state with each vehicle's failsafe action decided, and (n,) bool: it begins a new action."""
        flies = ~seen.standing & ~state.landed
        latched, lost = state.latched, jnp.zeros_like(state.landed)
        if seen.charge is not None:
            now = battery_level(seen.charge, self.BAT_LOW_THR, self.BAT_CRIT_THR, self.BAT_EMERGEN_THR)
            level = jnp.maximum(state.level, jnp.where(flies, now, 0))
            state = replace(state, level=level)
            latched = graver(latched, battery_action(level, WORDS["COM_LOW_BAT_ACT"][self.COM_LOW_BAT_ACT]))
        if seen.fixed is not None:
            unfixed = jnp.where(seen.fixed, 0, state.unfixed + 1)
            on_fix = fix_action(flies & ~seen.fixed, WORDS["COM_GNSSLOSS_ACT"][self.COM_GNSSLOSS_ACT])
            latched = graver(latched, on_fix)
            # On the ground a descent goes on, so that the motors come to idle.
            lost = (flies | state.position_lost) & is_lost(_seconds(unfixed, state, dt), 1e-6 * self.EKF2_NOAID_TOUT)
            state = replace(state, unfixed=unfixed, position_lost=lost)
        if seen.heard is not None:
            heard = jnp.maximum(state.heard, seen.heard)
            silent = (heard >= 0) & is_lost(_seconds(seen.tick - heard, state, dt), self.COM_DL_LOSS_T)
            latched = graver(latched, link_action(silent & flies, WORDS["NAV_DLL_ACT"][self.NAV_DLL_ACT]))
            state = replace(state, heard=heard, link_lost=silent)
        action = graver(latched, position_action(lost))
        # A vehicle that has landed stays on the ground.
        action = jnp.where(state.landed, state.action, action)
        begins = (action != state.action) & (action > NOTHING)
        return replace(state, latched=latched, action=action), begins

    def _begun(self, state: FailsafeState, estimate: Estimate) -> FailsafeState:
        """Return the state (n,) reset to begin each vehicle's failsafe action at its estimated position now."""
        here, going, home = estimate.position_ned, estimate.velocity_ned, state.home_ned
        level = root(going.x * going.x + going.y * going.y)
        braking = 0.5 * level / self.MPC_ACC_HOR
        safe, least = self._nearest(home, here)
        distance = _level_distance(safe, here)
        height = jnp.where(
            distance < self.RTL_MIN_DIST, jnp.minimum(self.RTL_RETURN_ALT, distance), self.RTL_RETURN_ALT
        )
        high = jnp.minimum(home.z - height, least)
        if self.top is not None:
            high = jnp.maximum(high, self.top + BELOW)
        rest = here.z + 0.5 * going.z * jnp.abs(going.z) / VERTICAL
        goal = Vec3(
            here.x + braking * going.x,
            here.y + braking * going.y,
            jnp.where(state.action == RETURN, jnp.minimum(here.z, high), rest),
        )
        phase = jnp.where(state.action == HOLD, STAY, jnp.where(state.action == RETURN, CLIMB, DOWN))
        zero = jnp.zeros_like(state.since)
        return replace(
            state,
            place_ned=here,
            speed_ned=going,
            goal_ned=goal,
            yaw=estimate.attitude.yaw,
            phase=phase.astype(jnp.int32),
            since=zero,
            waited=zero,
            rally_ned=safe if self.rally else None,
        )

    def _nearest(self, home: Vec3, here: Vec3) -> tuple[Vec3, Array]:
        """Return where a return lands (n,), at home or a nearer rally point, and the lowest flight level, down [m]."""
        safe, least, distance = home, home.z, _level_distance(home, here)
        for point in self.rally:
            away = _level_distance(point.place_ned, here)
            nearer = away < distance
            safe = select(nearer, replace(point.place_ned, z=point.ground_down), safe)
            least = jnp.where(nearer, point.place_ned.z, least)
            distance = jnp.where(nearer, away, distance)
        return safe, least

    def _flown(self, state: FailsafeState, seen: Watched, dt: float) -> tuple[FailsafeState, PathSetpoint]:
        """Return the state and the set-point (n,) of the failsafe's own path, advanced by dt [s]."""
        here, going, home = seen.estimate.position_ned, seen.estimate.velocity_ned, state.safe_ned
        blind = state.action == DESCEND
        state = self._next_phase(state, here, dt)
        down, homewards = state.phase == DOWN, (state.phase == FLY) | (state.phase == LOWER)
        low = jnp.maximum(home.z - self.RTL_DESCEND_ALT, state.goal_ned.z)
        over = homewards | (down & (state.action == RETURN))
        goal = Vec3(
            jnp.where(over, home.x, state.goal_ned.x),
            jnp.where(over, home.y, state.goal_ned.y),
            jnp.where(state.phase == LOWER, low, state.goal_ned.z),
        )
        share = jnp.clip((home.z - here.z - SLOW_AT) / (SLOWS_AT - SLOW_AT), 0.0, 1.0)
        share = jnp.where(blind, 0.0, share)
        sinks = self.MPC_LAND_SPEED + share * (self.MPC_Z_VEL_MAX_DN - self.MPC_LAND_SPEED)
        speed = self._speed(state, goal, down, sinks, dt)
        # A blind vehicle follows its own drift: no horizontal error.
        speed = replace(speed, x=jnp.where(blind, 0.0, speed.x), y=jnp.where(blind, 0.0, speed.y))
        place = select(blind, replace(state.place_ned, x=here.x, y=here.y), state.place_ned)
        behind = (place - here).norm()
        rate = jnp.clip(1.0 - (behind - WAITS_FROM) / WAITS_OVER, 0.0, 1.0)
        place = place + speed * (rate * dt)
        away = jnp.where(homewards, _level_distance(home, here), 0.0) > TURNS
        yaw = jnp.where(away, jnp.arctan2(home.y - here.y, jnp.where(away, home.x - here.x, 1.0)), state.yaw)
        state = replace(state, place_ned=place, speed_ned=speed, yaw=yaw)
        state, idle, level = _on_the_ground(state, seen, down, share, dt)
        zero = jnp.zeros_like(yaw)
        along = speed * rate
        along = replace(along, x=jnp.where(blind, going.x, along.x), y=jnp.where(blind, going.y, along.y))
        return state, PathSetpoint(place, along, Vec3(zero, zero, zero), yaw, idle, level, blind)

    def _next_phase(self, state: FailsafeState, here: Vec3, dt: float) -> FailsafeState:
        """Return the state with a return's phase (n,) (climb, fly home, descend, land) advanced where complete."""
        phase, home, top = state.phase, state.safe_ned, state.goal_ned.z
        up = (phase == CLIMB) & (here.z - top < CLIMBED)
        there = (phase == FLY) & (_level_distance(home, here) < ABOVE)
        low = jnp.maximum(home.z - self.RTL_DESCEND_ALT, top)
        waits = (phase == LOWER) & (low - here.z < CLIMBED)
        lands = waits & (self.RTL_LAND_DELAY >= 0.0) & (_seconds(state.since, state, dt) >= self.RTL_LAND_DELAY)
        moved = up | there | lands
        since = jnp.where(phase == LOWER, jnp.where(waits, state.since + 1, 0), state.since)
        return replace(state, phase=jnp.where(moved, phase + 1, phase), since=jnp.where(moved, 0, since))

    def _speed(self, state: FailsafeState, goal: Vec3, down: Array, sinks: Array, dt: float) -> Vec3:
        """Return the velocity (n,) [m/s] NED at which the path's point moves to ``goal``, braking before it."""
        place, before, most = state.place_ned, state.speed_ned, self.MPC_ACC_HOR
        north, east, below = goal.x - place.x, goal.y - place.y, goal.z - place.z
        distance = root(north * north + east * east)
        # Half of the acceleration suffices to brake from this speed.
        wanted = jnp.minimum(jnp.minimum(self.MPC_XY_CRUISE, root(most * distance)), distance * (1.0 / dt))
        wanted = wanted / jnp.maximum(distance, 1e-6)
        change_north, change_east = wanted * north - before.x, wanted * east - before.y
        change = root(change_north * change_north + change_east * change_east)
        share = jnp.minimum(1.0, most * dt / jnp.maximum(change, 1e-6))
        size = jnp.abs(below)
        vertical = jnp.minimum(root(VERTICAL * size), size * (1.0 / dt))
        rising, sinking = jnp.minimum(vertical, self.MPC_Z_VEL_MAX_UP), jnp.minimum(vertical, self.MPC_Z_VEL_MAX_DN)
        vertical = jnp.where(down, sinks, jnp.where(below < 0.0, -rising, sinking))
        return Vec3(
            before.x + share * change_north,
            before.y + share * change_east,
            before.z + jnp.clip(vertical - before.z, -VERTICAL * dt, VERTICAL * dt),
        )


def _seconds(ticks: Array, state: FailsafeState, dt: float) -> Array:
    """Return tick counts (n,) as times [s], plus half a tick so that rounding never delays a comparison."""
    return (ticks.astype(state.yaw.dtype) + 0.5) * dt


def _level_distance(one: Vec3, other: Vec3) -> Array:
    """Return the horizontal distance (n,) [m] between two positions."""
    north, east = one.x - other.x, one.y - other.y
    return root(north * north + east * east)


def _on_the_ground(
    state: FailsafeState, seen: Watched, down: Array, share: Array, dt: float
) -> tuple[FailsafeState, Array, Array]:
    """Return the state with its time on the ground, and two flags (n,): the motors idle, the vehicle stays level.

    Args:
        state: state after this step.
        seen: inputs of this tick.
        down: (n,) bool, the vehicle lands or descends.
        share: (n,) 0 at touchdown speed, 1 at the fastest descent.
        dt: step [s].
    """
    above, sinking = state.place_ned.z - seen.estimate.position_ned.z, seen.estimate.velocity_ned.z
    since = jnp.where(down, jnp.where(share > 0.0, 0, state.since + 1), state.since)
    steady = _seconds(since, state, dt) > STEADY
    touched = (above > TOUCHED) & (jnp.abs(sinking) < HELD_SPEED) & steady
    waits = down & (seen.standing | held(above, sinking))
    waited = jnp.where(state.landed | waits, state.waited + 1, 0)
    on = _seconds(waited, state, dt)
    landed = state.landed | (down & seen.standing & (on >= LANDED_AFTER))
    idle = down & (landed | (on >= IDLE_AFTER))
    level = down & (seen.standing | touched)
    return replace(state, since=since, waited=waited, landed=landed), idle, level
