"""The radio of a world in a tick: messages and beacons to send, and messages received."""

from __future__ import annotations

import hashlib
from functools import reduce

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.noise import Draw
from qrsim.core.tree import concatenated
from qrsim.core.vectors import Vec3
from qrsim.models.radio.contracts import FIELD_STREAM, Exchange, Inbox, Outbox, Surfaces
from qrsim.models.scene.rays import any_of
from qrsim.world.sensing import estimate_of
from qrsim.world.state import Action, Fleet, FleetState, Saying, State, World, WorldKeys


def split_messages(actions: tuple[Action, ...]) -> tuple[tuple[Action, ...], tuple[Outbox | None, ...]]:
    """Return each fleet's action without its radio messages, and each fleet's messages, None without any."""
    plain = tuple(action.action if isinstance(action, Saying) else action for action in actions)
    return plain, tuple(action.outbox if isinstance(action, Saying) else None for action in actions)


def start_radio(world: World, draws: dict[str, Draw], keys: WorldKeys, fleets: tuple[FleetState, ...]) -> object:
    """Return the radio network's state at the start of an episode; None for a world without radio."""
    if world.radio is None:
        return None
    assert keys.radio is not None
    like = jnp.concatenate([fleet.vehicle.position_ned.x for fleet in fleets])
    return world.radio.init(draws[FIELD_STREAM], keys.radio, like)


def exchange(world: World, state: State, outboxes: tuple[Outbox | None, ...], tick: Array, due: Array) -> object:
    """Return the radio network's state after the messages of a tick are sent; None for a world without radio.

    Args:
        world, state: at the start of the tick.
        outboxes: messages of the vehicles of each fleet; None: no messages, so they send beacons if the radio has any.
        tick: () int32 now.
        due: () int32 the tick as ``step`` counts it, which is not batched under vmap.
    """
    radio = world.radio
    if radio is None:
        return None
    position: Vec3 = concatenated(
        [
            fleet.vehicle.pose(now.vehicle).position_ned.map(lambda axis: axis.astype(now.specific_force.x.dtype))  # noqa: B023
            for fleet, now in zip(world.fleets, state.fleets, strict=True)
        ]
    )
    works = jnp.concatenate([now.violation.code == 0 for now in state.fleets])
    if radio.own is not None:
        works = works & radio.own.works
    off, lost = _failed(world, position.x, tick)
    if off is not None:
        works = works & ~off
    obstacles = world.obstacles
    height = world.height_agl(position) if radio.asks_height else None
    surfaces = Surfaces(position, works, obstacles if any_of(obstacles) else None, height)
    spoken = None if all(part is None for part in outboxes) else _merged_outbox(world, outboxes, position.x)
    beacons = _beacons(world, state, outboxes) if radio.beacon else None
    ids = np.concatenate([vehicle_ids(fleet) for fleet in world.fleets])
    return radio.exchange(state.radio, Exchange(spoken, beacons, surfaces, ids, tick, due, world.time_step, lost))


def _failed(world: World, like: Array, tick: Array) -> tuple[Array | None, Array | None]:
    """Return (n,) bool: a fault switches the radio off, and the share (n,) of packets lost; None, None without."""
    faults = [
        (*fleet.radio_faults, *([] if fleet.radio_slot is None else [fleet.radio_slot])) for fleet in world.fleets
    ]
    if not any(faults):
        return None, None
    off, lost = [], []
    for fleet, own in zip(world.fleets, faults, strict=True):
        now = [fault.at(tick) for fault in own]
        off.append(reduce(jnp.logical_or, (each for each, _ in now), jnp.zeros(fleet.size, bool)))
        lost.append(reduce(jnp.add, (each for _, each in now), jnp.zeros(fleet.size, like.dtype)))
    return jnp.concatenate(off), jnp.concatenate(lost)


def heard(world: World, state: State, tick: Array) -> Inbox:
    """Return the messages that each vehicle (n,) of a world has received by a tick."""
    assert world.radio is not None
    return world.radio.received(state.radio, tick, world.time_step)


def vehicle_ids(fleet: Fleet) -> npt.NDArray[np.uint32]:
    """Return each vehicle's identifier (n,) uint32 for random draws, from its fleet's name and its number there.

    So draws do not change when another fleet is added.
    """
    first = int.from_bytes(hashlib.sha256(fleet.name.encode()).digest()[:4], "little")
    return ((first + np.arange(fleet.size, dtype=np.uint64)) & 0xFFFFFFFF).astype(np.uint32)


def _merged_outbox(world: World, outboxes: tuple[Outbox | None, ...], like: Array) -> Outbox:
    """Return the messages of all fleets as one outbox, with no message for fleets without an outbox."""
    assert world.radio is not None
    parts = []
    for fleet, part in zip(world.fleets, outboxes, strict=True):
        nothing = Outbox(
            jnp.zeros((world.radio.size, fleet.size), like.dtype),
            jnp.zeros(fleet.size, bool),
            jnp.full(fleet.size, -1, jnp.int32),
        )
        parts.append(part or nothing)
    return Outbox(
        jnp.concatenate([part.payload for part in parts], axis=1),
        jnp.concatenate([part.send for part in parts]),
        jnp.concatenate([part.to for part in parts]),
    )


def _beacons(world: World, state: State, outboxes: tuple[Outbox | None, ...]) -> Outbox:
    """Return the beacons (estimated position and velocity) of all vehicles, to be sent where the outboxes allow."""
    assert world.radio is not None
    size, parts, sends = world.radio.size, [], []
    for fleet, now, part in zip(world.fleets, state.fleets, outboxes, strict=True):
        estimate = estimate_of(fleet, now)
        numbers = [*estimate.position_ned.axes, *estimate.velocity_ned.axes]
        zero = jnp.zeros_like(numbers[0])
        parts.append(jnp.stack([*numbers[:size], *[zero] * (size - len(numbers))]))
        silent = jnp.full(fleet.size, part is None)
        sends.append(silent if part is None or part.beacons is None else part.beacons)
    send = jnp.concatenate(sends)
    return Outbox(jnp.concatenate(parts, axis=1), send, jnp.full(send.shape, -1, jnp.int32))
