"""Commands of the vehicles of a fleet in a tick: a user's, or those of the fleet's guidance and controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.control import Estimate
from qrsim.control.failsafe_flight import FailsafeState
from qrsim.control.failsafes import NOTHING
from qrsim.control.teams import Mates, TeamGuidance, mates_heard, mates_of, mates_wanted
from qrsim.core.tree import concatenated, map_tree, replace, select
from qrsim.core.vectors import Vec3
from qrsim.world.failing import by_failsafe
from qrsim.world.sensing import estimate_of, with_airspeed
from qrsim.world.standing import ground_argument, on_ground
from qrsim.world.state import Action, Fleet, FleetState, Piloted, Some, State, World

T = TypeVar("T")
# Commands (n,) of one kind each, and which vehicles (n,) fly them; the first is for all others, and has None.
Commands = list[tuple[Array | None, object]]


class Commanded(NamedTuple):
    """New states of guidance and controller of a fleet (n,), and the commands of its vehicles."""

    guidance: object
    setpoint: object
    controller: object
    estimate: Estimate
    commands: Commands
    # Logged command, if it differs from the flown one; None: it does not.
    shown: object | None = None
    failsafe: FailsafeState | None = None


def command_fleet(
    world: World, whole: State, fleet: Fleet, state: FleetState, tick: Array, action: Action, believed: Estimate | None
) -> Commanded:
    """Return a fleet's set-points and commands for a tick, with the new states of its guidance and controller."""
    if isinstance(action, Some):
        return _command_some(world, whole, fleet, state, tick, action, believed)
    if isinstance(action, Piloted):
        found = command_fleet(world, whole, fleet, state, tick, None, believed)
        return found._replace(commands=[(None, action.command)], shown=found.commands[0][1])
    if isinstance(action, fleet.vehicle.actions):
        return Commanded(
            state.guidance,
            state.setpoint,
            state.controller,
            state.estimate,
            [(None, action)],
            failsafe=state.failsafe,
        )
    guidance, failsafe = state.guidance, state.failsafe
    fed = with_airspeed(fleet, state, estimate_of(fleet, state) if believed is None else believed)
    standing = on_ground(fleet, state)
    alone = replace(fed, position_low_ned=None)
    estimate = map_tree(lambda new, old: jnp.where(jnp.isfinite(new), new, old), alone, state.estimate)
    setpoint = action
    if setpoint is None:
        others = _others(world, whole, fleet) | ground_argument(fleet, standing)
        motion: dict[str, Any] = {}
        if fleet.guidance.sees_motion:
            motion = {"velocity_ned": estimate.velocity_ned, "dt": world.time_step}
        if fleet.guidance.sees_mates:
            motion |= {"mates": _mates(world, whole, fleet, state, estimate, tick)}
        guidance, setpoint = fleet.guidance.step(guidance, fleet.route, estimate.position_ned, **others, **motion)
        if fleet.failsafes is not None:
            failsafe, setpoint = by_failsafe(world, whole, fleet, state, estimate, setpoint, tick)
            # A guidance waits while a failsafe flies.
            guidance = select(failsafe.action == NOTHING, guidance, state.guidance)
    known = replace(estimate, position_low_ned=fed.position_low_ned)
    controller = state.controller
    if standing is not None:
        # On the ground its integrals would wind up, so it restarts at every tick until the vehicle flies.
        controller = select(standing, fleet.controller.init(known), controller)
    controller, wanted = fleet.controller.step(controller, known, setpoint, world.time_step)
    return Commanded(
        guidance, fleet.controller.shown(setpoint), controller, estimate, [(None, wanted)], failsafe=failsafe
    )


def _command_some(
    world: World, whole: State, fleet: Fleet, state: FleetState, tick: Array, some: Some, believed: Estimate | None
) -> Commanded:
    """Return the result of ``command_fleet`` where a user commands some vehicles, and guidance the others."""
    # The estimate of the controllers continues also for vehicles that fly a user's commands.
    found = command_fleet(world, whole, fleet, state, tick, None, believed)
    for which, action in some.parts:
        theirs = command_fleet(world, whole, fleet, state, tick, action, believed)
        found = Commanded(
            select(which, theirs.guidance, found.guidance),
            select(which, theirs.setpoint, found.setpoint),
            select(which, theirs.controller, found.controller),
            found.estimate,
            _joined(found.commands, which, theirs.commands[0][1]),
            failsafe=None if found.failsafe is None else select(which, theirs.failsafe, found.failsafe),
        )
    return found


def _joined(commands: Commands, which: Array, command: object) -> Commands:
    """Return ``commands`` with ``command`` added for the vehicles ``which`` (n,), merged into one of the same type."""
    for number, (theirs, other) in enumerate(commands):
        if _alike(command, other):
            both = (None if theirs is None else theirs | which, select(which, command, other))
            return [*commands[:number], both, *commands[number + 1 :]]
    return [*commands, (which, command)]


def _alike(one: object, other: object) -> bool:
    """Return whether two commands have the same type and tree structure."""
    # To JAX, records that differ in nothing but their type are alike.
    return type(one) is type(other) and str(jax.tree.structure(one)) == str(jax.tree.structure(other))


def by_kind(commands: Sequence[tuple[Array | None, object, Array]], function: Callable[[object, Array], T]) -> T:
    """Return ``function(command, clipped)`` for each type of command, merged by the masks (n,) of its vehicles."""
    merged: T | None = None
    for which, command, clipped in commands:
        result = function(command, clipped)
        merged = result if merged is None or which is None else select(which, result, merged)
    assert merged is not None
    return merged


def _mates(world: World, whole: State, fleet: Fleet, state: FleetState, estimate: Estimate, tick: Array) -> Mates:
    """Return the neighbour lists of a fleet's vehicles (n,), heard or known; stopped vehicles send nothing new."""
    guidance = cast(TeamGuidance, fleet.guidance)
    if guidance.knows == "heard":
        assert world.radio is not None
        own = world.rows_of(fleet.name)
        heard = world.radio.heard(whole.radio, tick, world.time_step)
        sender = heard.sender[:, own]
        number = jnp.where((sender >= own.start) & (sender < own.stop), sender - own.start, -1)
        age = (tick - heard.sent[:, own]).astype(estimate.position_ned.x.dtype) * world.time_step
        return mates_heard(number, heard.payload[:, :, own], age, estimate.position_ned, guidance.reach)
    position = _flying(estimate.position_ned, state)
    return mates_of(position, estimate.velocity_ned, guidance.reach, mates_wanted(guidance.mates, fleet.size))


def _flying(position_ned: Vec3, state: FleetState) -> Vec3:
    """Return positions (n,), with NaN for vehicles that have been stopped."""
    flies = state.violation.code == 0
    return position_ned.map(lambda axis: jnp.where(flies, axis, jnp.nan))


def _others(world: World, whole: State, fleet: Fleet) -> dict[str, Any]:
    """Return {"others_ned": estimated positions (m,) of all other fleets, NaN if stopped}, or {} if ignored."""
    if not fleet.guidance.sees_others:
        return {}
    positions = []
    for other, state in zip(world.fleets, whole.fleets, strict=True):
        if other.name != fleet.name:
            positions.append(_flying(estimate_of(other, state).position_ned, state))
    if not positions:
        return {}
    return {"others_ned": concatenated(positions)}
