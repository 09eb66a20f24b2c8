"""Messages over the radio, as users say and hear them (docs/radio.md)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.noise import Stream, threefry2x32
from qrsim.errors import RadioWarning, UsageError, did_you_mean
from qrsim.models.radio.contracts import Outbox
from qrsim.models.radio.tables import NOBODY
from qrsim.world.radio import vehicle_ids
from qrsim.world.state import State, World

ALL = -1
# What keys of users are drawn with: the first two words of sha256("qrsim/user").
_USER = (0x71E1A68C, 0x5E3CBE24)


@dataclass(frozen=True)
class Say:
    """What vehicles have to say, with what they are commanded; a policy returns it in place of its command.

    Attributes:
        payload: (n, D) numbers of each vehicle, or fewer than the radio's ``size``, which are then followed by zeros.
        command: what ``Simulation.step`` takes; None: their guidance flies.
        send: who says it now, one bool or (n,).
        to: who alone is to hear it: number of a vehicle in the world or its name, one for all or n of them; -1: all.
    """

    payload: Any
    command: Any = None
    send: Any = True
    to: Any = ALL


@dataclass(frozen=True)
class Message:
    """A message that a vehicle has heard.

    Attributes:
        sender: name of the vehicle that sent it.
        sent: when it was handed to the sender's radio [s].
        received: when it was known [s].
        rssi: strength at which it was received [dBm].
        payload: (D,) numbers.
    """

    sender: str
    sent: float
    received: float
    rssi: float
    payload: np.ndarray[Any, Any]


def outboxes(say: Say, world: World, names: Sequence[Sequence[str]], dtype: Any, traced: bool) -> list[Outbox]:
    """Return what vehicles have to say, checked, for each fleet or other group of which names are given.

    Raises:
        UsageError: no radio, another shape, a payload too long, or a receiver that nobody is.
    """
    radio = world.radio
    if radio is None:
        raise UsageError("say: the scenario has no world.radio")
    library: Any = jnp if traced else np
    n = sum(map(len, names))
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
    to = _receivers(say.to, n, world, library)
    found, first = [], 0
    for group in names:
        own = slice(first, first + len(group))
        first += len(group)
        found.append(Outbox(*(_owned(part, library) for part in (rows[:, own], send[own], to[own]))))
    return found


def _owned(part: Any, library: Any) -> Any:
    return np.ascontiguousarray(part) if library is np else part


def _receivers(to: Any, n: int, world: World, library: Any) -> Any:
    """Return the number of the receiver (n,) of each vehicle's message, -1 for all."""
    names = [name for fleet in world.fleets for name in fleet.vehicle_names]
    if isinstance(to, str) or (isinstance(to, Sequence) and any(isinstance(one, str) for one in to)):
        each = [to] * n if isinstance(to, str) else list(to)
        to = [receiver_number(one, names) for one in each]
    try:
        numbers = library.broadcast_to(library.asarray(to, np.int32), (n,))
    except (TypeError, ValueError, OverflowError):
        raise UsageError(f"say: to: expected numbers or names of vehicles, one or {n} of them, found {to!r}") from None
    if library is np and ((numbers < ALL) | (numbers >= len(names))).any():
        wrong = int(numbers[(numbers < ALL) | (numbers >= len(names))][0])
        raise UsageError(f"say: to: {wrong} is nobody; allowed: 0 to {len(names) - 1}, or -1 for all")
    return numbers


def receiver_number(name: Any, names: Sequence[str], what: str = "say: to") -> int:
    """Return the number of a vehicle in the world by its name or number; -1 for None, which is all.

    Raises:
        UsageError: nobody is called so.
    """
    if name is None:
        return ALL
    if isinstance(name, str):
        if name not in names:
            raise UsageError(f"{what}: no vehicle is called '{name}'{did_you_mean(name, names)}")
        return list(names).index(name)
    if isinstance(name, bool) or not isinstance(name, int | np.integer):
        raise UsageError(f"{what}: expected the name or the number of a vehicle, found {name!r}")
    number = int(name)
    if not ALL <= number < len(names):
        raise UsageError(f"{what}: {number} is nobody; allowed: 0 to {len(names) - 1}, or -1 for all")
    return number


def messages(world: World, state: State, tick: int, vehicle: int) -> list[Message]:
    """Return what a vehicle has heard by a tick, the newest first; ``state`` on the host."""
    assert world.radio is not None
    names = [name for fleet in world.fleets for name in fleet.vehicle_names]
    dt = world.time_step
    heard = world.radio.heard(state.radio, np.int32(tick), dt)
    return [
        Message(
            names[int(heard.sender[row, vehicle])], float(heard.sent[row, vehicle] * dt),
            float(heard.arrives[row, vehicle] * dt), float(heard.rssi[row, vehicle]),
            np.array(heard.payload[row, :, vehicle]),
        )
        for row in range(heard.sender.shape[0])
        if heard.sender[row, vehicle] != NOBODY
    ]  # fmt: skip


def warn_of_overfull(world: World, state: State) -> None:
    """Warn once if vehicles had more others around them than there was room for, so that they may have missed some.

    Args:
        world: with a radio.
        state: at the end, on the host; of many worlds, leaves (W, ...).
    """
    assert world.radio is not None
    looks = int(np.sum(world.radio.counted(state.radio)["overfull"]))
    if looks:
        warnings.warn(
            f"world.radio: {looks} times a vehicle had more others around it than were looked at, so that it may have"
            " missed the nearest; give a larger world.radio.inbox.candidates, or a smaller reach",
            RadioWarning,
            stacklevel=2,
        )


def user_key(state: State, tick: Any) -> Any:
    """Return a key (2,) uint32 for users' own random numbers: another one in every world and at every tick."""
    keys = state.sky_keys
    traced = isinstance(tick, Array) or isinstance(keys.high, jax.core.Tracer)
    library: Any = jnp if traced else np
    # Arrays of one, whose sums wrap around without a warning.
    high, low = (library.reshape(library.asarray(word), (-1,))[:1] for word in (keys.high, keys.low))
    counter = (
        library.full(1, _USER[0], library.uint32),
        library.reshape(library.asarray(tick).astype(library.uint32), (1,)) ^ library.uint32(_USER[1]),
    )
    words = threefry2x32((high, low), counter, 20)
    return library.concatenate([library.asarray(word) for word in words])


def user_normals(world: World, state: State, tick: Any, count: int) -> Any:
    """Return standard normals (n, count) for all vehicles: of each vehicle its own, whatever others there are."""
    key = user_key(state, tick)
    ids = jnp.asarray(np.concatenate([vehicle_ids(fleet) for fleet in world.fleets]))
    dtype = jnp.asarray(world.fleets[0].start.position_ned.x).dtype
    stream = Stream(jnp.asarray(key[0]), jnp.asarray(key[1]), ids)
    drawn = jnp.stack(stream.normals(jnp.uint32(0), count, dtype), axis=-1)
    return np.asarray(drawn) if isinstance(key, np.ndarray) else drawn
