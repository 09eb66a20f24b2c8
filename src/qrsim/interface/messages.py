"""Messages over the radio, as users send and receive them (docs/howto/radio.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.noise import Stream, threefry2x32
from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.arrays import Library, library_for
from qrsim.models.radio.contracts import Outbox
from qrsim.models.radio.tables import NOBODY, Heard
from qrsim.world.radio import vehicle_ids
from qrsim.world.state import State, World

ALL = -1
# Messages are in single precision.
_LARGEST = float(np.finfo(np.float32).max)
# Key of the users' random numbers: the first two words of sha256("qrsim/user").
_USER = (0x71E1A68C, 0x5E3CBE24)


@dataclass(frozen=True)
class Say:
    """Messages of vehicles together with their command; a policy returns it in place of the command alone.

    Attributes:
        payload: (n, D) numbers of each vehicle; if D is less than the radio's ``size``, zeros follow.
        command: as for ``Simulation.step``; None: the vehicles follow their guidance.
        send: whether each vehicle sends its message now, one bool or (n,).
        to: receiver of the message, by number in the world or by name, one for all or n of them; -1: every vehicle.
    """

    payload: object
    command: object = None
    send: object = True
    to: object = ALL


@dataclass(frozen=True)
class Message:
    """A message that a vehicle has received.

    Attributes:
        sender: name of the vehicle that sent it.
        sent: time at which the sender's radio was given it [s].
        received: time at which it was received [s].
        rssi: received signal strength [dBm].
        payload: (D,) numbers.
    """

    sender: str
    sent: float
    received: float
    rssi: float
    payload: npt.NDArray[np.floating]


def outboxes(say: Say, world: World, names: Sequence[Sequence[str]], dtype: object, traced: bool) -> list[Outbox]:
    """Check a user's radio messages for all vehicles, and return an outbox for each group of vehicles in ``names``.

    Raises:
        UsageError: no radio, a wrong shape, a payload that is too long, or an unknown receiver.
    """
    radio = world.radio
    if radio is None:
        raise UsageError("say: the scenario has no world.radio")
    library = library_for(traced)
    n = sum(len(group) for group in names)
    try:
        payload = library.asarray(say.payload, dtype)
        send = library.broadcast_to(library.asarray(say.send, bool), (n,))
    except (TypeError, ValueError):
        raise UsageError(
            f"say: expected a payload of numbers ({n}, {radio.size}) and send ({n},), found {say.payload!r} and "
            f"{say.send!r}"
        ) from None
    if payload.ndim != 2 or payload.shape[0] != n:
        raise UsageError(f"say: payload: expected shape ({n}, {radio.size}), found {payload.shape}")
    if payload.shape[1] > radio.size:
        raise UsageError(
            f"say: payload: {payload.shape[1]} numbers are more than a message has, {radio.size}; world.radio.size says"
            " how many"
        )
    rows = library.concatenate([payload.T, library.zeros((radio.size - payload.shape[1], n), dtype)])
    to = _receivers(say.to, n, world, library, traced)
    found, first = [], 0
    for group in names:
        last = first + len(group)
        found.append(
            Outbox(
                _owned(rows[:, first:last], traced), _owned(send[first:last], traced), _owned(to[first:last], traced)
            )
        )
        first = last
    return found


def _owned(part: Array, traced: bool) -> Array:
    """Return an array in contiguous memory; a traced array is returned unchanged."""
    return part if traced else cast(Array, np.ascontiguousarray(part))


def _receivers(to: object, n: int, world: World, library: Library, traced: bool) -> Array:
    """Return the receiver's vehicle number for each message, (n,), -1 for all; raises UsageError for unknown
    receivers."""
    names = [name for fleet in world.fleets for name in fleet.vehicle_names]
    if isinstance(to, str):
        to = [receiver_number(to, names)] * n
    elif isinstance(to, list | tuple) and any(isinstance(one, str) for one in to):
        to = [receiver_number(one, names) for one in to]
    try:
        numbers = library.broadcast_to(library.asarray(to, np.int32), (n,))
    except (TypeError, ValueError, OverflowError):
        raise UsageError(f"say: to: expected numbers or names of vehicles, one or {n} of them, found {to!r}") from None
    beyond = [] if traced else [number for number in numbers.tolist() if not ALL <= number < len(names)]
    for wrong in beyond:
        raise UsageError(f"say: to: {wrong} is nobody; allowed: 0 to {len(names) - 1}, or -1 for all")
    return numbers


def receiver_number(name: object, names: Sequence[str], what: str = "say: to") -> int:
    """Return a vehicle's number in the world for its name or number, -1 for None (all); raises UsageError, beginning
    with ``what``, for unknown ones.

    Raises:
        UsageError: no vehicle has this name or number.
    """
    if name is None:
        return ALL
    if isinstance(name, str):
        if name not in names:
            raise UsageError(f"{what}: no vehicle is called '{name[:60]}'{did_you_mean(name[:60], names)}")
        return list(names).index(name)
    if isinstance(name, bool) or not isinstance(name, int | np.integer):
        raise UsageError(f"{what}: expected the name or the number of a vehicle, found {name!r}")
    number = int(name)
    if not ALL <= number < len(names):
        raise UsageError(f"{what}: {number} is nobody; allowed: 0 to {len(names) - 1}, or -1 for all")
    return number


def checked_message(
    world: World, names: Sequence[str], vehicle: object, numbers: Sequence[float], to: object
) -> tuple[int, list[float], int]:
    """Check a radio message; return sender's number, numbers (D,), and receiver's number (-1: all); raises UsageError.

    Raises:
        UsageError: no radio, no vehicle of that name, or a message that is too long or not finite.
    """
    if world.radio is None:
        raise UsageError("say: the scenario has no world.radio")
    sender, receiver = receiver_number(vehicle, names, "say: vehicle"), receiver_number(to, names)
    if len(numbers) > world.radio.size:
        raise UsageError(
            f"say: '{vehicle}': {len(numbers)} numbers are more than a message has, {world.radio.size} "
            "(world.radio.size)"
        )
    if not all(abs(number) <= _LARGEST for number in numbers):
        raise UsageError(f"say: '{vehicle}': a number is not finite, or larger than {_LARGEST:.4g}")
    return sender, [*numbers, *[0.0] * (world.radio.size - len(numbers))], receiver


def messages(world: World, state: State, tick: int, vehicles: Sequence[int]) -> list[list[Message]]:
    """Return the radio messages that each vehicle in ``vehicles`` has received by a tick, newest first."""
    assert world.radio is not None
    names = [name for fleet in world.fleets for name in fleet.vehicle_names]
    heard = world.radio.heard(state.radio, cast(Array, np.int32(tick)), world.time_step)
    return [_heard_by(vehicle, heard, names, world.time_step) for vehicle in vehicles]


def _heard_by(vehicle: int, heard: Heard, names: Sequence[str], dt: float) -> list[Message]:
    """Return the radio messages that one vehicle has received, with times in seconds."""
    senders, sent, arrives, rssi = (
        cast(list[float], column[:, vehicle].tolist())
        for column in (heard.sender, heard.sent, heard.arrives, heard.rssi)
    )
    payloads = np.array(heard.payload[:, :, vehicle], np.float64)
    return [
        Message(names[int(sender)], sent[row] * dt, arrives[row] * dt, rssi[row], payloads[row])
        for row, sender in enumerate(senders)
        if sender != NOBODY
    ]


def user_key(state: State, tick: object) -> Array:
    """Return a JAX random key (2,) uint32 for users' functions, different in every world and at every tick."""
    keys = state.sky_keys
    traced = isinstance(tick, Array) or isinstance(keys.high, jax.core.Tracer)
    library = library_for(traced)
    # Arrays of one element: NumPy warns of overflow in scalars, not in arrays.
    high, low = (
        library.reshape(library.asarray(keys.high), (-1,))[:1],
        library.reshape(library.asarray(keys.low), (-1,))[:1],
    )
    now = library.reshape(library.asarray(tick).astype(np.uint32), (1,))
    counter = (library.asarray([_USER[0]], np.uint32), now ^ np.uint32(_USER[1]))
    first, second = threefry2x32((high, low), counter, 20)
    return library.concatenate([library.asarray(first), library.asarray(second)])


def user_normals(world: World, state: State, tick: object, count: int) -> Array:
    """Return standard normal numbers (n, count) for users' functions; a vehicle's do not depend on the other
    vehicles."""
    key = user_key(state, tick)
    ids = jnp.concatenate([jnp.asarray(vehicle_ids(fleet)) for fleet in world.fleets])
    dtype = jnp.asarray(world.fleets[0].start.position_ned.x).dtype
    stream = Stream(jnp.asarray(key[0]), jnp.asarray(key[1]), ids)
    drawn = jnp.stack(stream.normals(jnp.uint32(0), count, dtype), axis=-1)
    return drawn if isinstance(key, Array) else cast(Array, np.asarray(drawn))
