"""Agents with radios: what they say beside what they do, and what they hear beside what they see.

See docs/howto/use_environments.md.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import replace
from qrsim.models.radio.contracts import Outbox
from qrsim.tasks.agents import number_of
from qrsim.world.radio import heard
from qrsim.world.state import Action, Saying, State, World, period_ticks

# Parts of an action and of an observation, where there is a radio.
ACT, SAY, SEE = "act", "say", "see"
HEARD, SENDER, AGE, RSSI, MASK = "heard", "sender", "age", "rssi", "mask"


def message_size(world: World) -> int:
    """Return the size D of the messages that agents can send by radio; 0 if the world has no radio."""
    return 0 if world.radio is None else world.radio.size


def spoken(world: World, name: str, actions: tuple[Action, ...], words: Array) -> tuple[Action, ...]:
    """Add the radio messages ``words`` (n, D) of a fleet's agents to that fleet's action.

    Args:
        world: with a radio.
        name: of the fleet.
        actions: one for each fleet.
        words: (n, D); who has NaN there says nothing and leaves its radio to the beacon, if there is one.
    """
    says = jnp.all(jnp.isfinite(words), axis=1)
    to = jnp.full(says.shape, -1, jnp.int32)
    outbox = Outbox(jnp.where(says[None], words.T, 0.0), says, to, beacons=~says)
    number = number_of(world, name)
    return (*actions[:number], Saying(actions[number], outbox), *actions[number + 1 :])


def at_first_period(world: World, actions: tuple[Action, ...], tick: Array, number: Array) -> tuple[Action, ...]:
    """Return actions that send their radio messages only in the first radio period of a step, not again.

    That is the first tick of a step at which a period of the radio begins: so every message is sent once, and of steps
    within one period those that cannot be sent do not crowd the queue.

    Args:
        world, actions: see ``spoken``.
        tick: () int32 now, by which the radio's periods count.
        number: () int32 of the tick in its step.
    """
    if world.radio is None:
        return actions
    ticks = period_ticks(world.radio.period, world.time_step)
    first = (tick % ticks == 0) & (number < ticks)

    def of(action: Action) -> Action:
        """Return the action of a fleet with its messages sent only in the first radio period."""
        if not isinstance(action, Saying):
            return action
        return replace(action, outbox=replace(action.outbox, send=action.outbox.send & first))

    return tuple(of(action) for action in actions)


def overheard(world: World, state: State, name: str, seen: object, tick: Array) -> dict[str, object]:
    """Join observations with the radio messages that a fleet's agents have received by this tick.

    Returns:
        see; heard (n, K, D); sender (n, K) int32 number of a vehicle in the world, -1 for none; age (n, K) [s];
        rssi (n, K) [dBm]; mask (n, K) bool: there is a message.
    """
    own, inbox = world.rows_of(name), heard(world, state, tick)
    there = inbox.mask[own]
    return {
        SEE: seen,
        HEARD: inbox.payload[own],
        SENDER: inbox.sender[own],
        AGE: jnp.where(there, inbox.age[own], 0.0),
        RSSI: jnp.where(there, inbox.rssi[own], 0.0),
        MASK: there,
    }
