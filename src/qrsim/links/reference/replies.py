"""Replies of ``qrsim serve`` as the client returns and raises them; for Python 3.8 and later, as ``client``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from qrsim.errors import RunError

if TYPE_CHECKING:
    Array = np.ndarray[Any, Any]


class ConnectionFailed(RunError):  # noqa: N818 (it is what has happened)
    """The server is unreachable, gone or too slow, or its answer is invalid; the client is closed."""


class Refused(RunError):  # noqa: N818
    """The server refused a request; the message gives the reason."""


class InvalidState(Refused):
    """A vehicle is invalid after the step; ``reset`` or ``set_state`` make it fly again."""


@dataclass(frozen=True)
class State:
    """State of n vehicles as the server reports it.

    Attributes:
        time: simulated time [s].
        state: (n, 13) true position NED [m], Euler angles [rad], body velocity [m/s], body rates [rad/s], thrust [N].
        measured: (n, 20) GNSS position; Euler angles; 0, 0, 0; body rates; 0; specific force; barometric height; GNSS
            velocity north, east; height rate; heights positive up; NaN where there is no reading.
        reasons: why each vehicle is invalid, "" where it flies; empty where ``hello`` was not called.
    """

    time: float
    state: Array
    measured: Array
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Session:
    """A session started by ``open`` or restarted by ``restart``.

    Attributes:
        number: its id, for those who want to watch it.
        scenario: name.
        seed: of all randomness of this episode, which flies it again.
        vehicles: names of the n vehicles.
        time_step: simulation step [s].
        state: at the start.
    """

    number: int
    scenario: str
    seed: int
    vehicles: tuple[str, ...]
    time_step: float
    state: State


@dataclass(frozen=True)
class Axis:
    """One number of an action; -1, 0 and 1 of the action mean ``low``, ``neutral`` and ``high`` in ``unit``."""

    name: str
    unit: str
    low: float
    high: float
    neutral: float


@dataclass(frozen=True)
class Episode:
    """An episode of a task at its start, begun by ``play``, with n agents.

    Attributes:
        session: its number, for those who want to watch it.
        scenario: name.
        seed: of all randomness.
        number: which episode of the seed's series it is, from 0.
        agents: names of the n vehicles that are commanded.
        axes: what the A numbers of an action are.
        period: simulated time of a step [s].
        steps: after which the episode is truncated.
        answer_shape: of what each agent hands in with its last action; () where nothing is handed in.
        say_size: numbers of a message that an agent may say over the radio; 0: there is none.
        observation: what the agents see, (n, O), or by name, (n, ...).
        info: what is really the case, by name, (n, ...).
    """

    session: int
    scenario: str
    seed: int
    number: int
    agents: tuple[str, ...]
    axes: tuple[Axis, ...]
    period: float
    steps: int
    answer_shape: tuple[int, ...]
    observation: Array | dict[str, Array]
    info: dict[str, Array]
    say_size: int = 0


@dataclass(frozen=True)
class Outcome:
    """Result of a step for n agents.

    Attributes:
        step: steps done.
        time: simulated time [s].
        observation: what the agents see, (n, O), or by name, (n, ...).
        reward: (n,).
        terminated: a vehicle has stopped, and the episode has ended.
        truncated: the last step is done, and the episode has ended.
        info: what is really the case, by name, (n, ...).
    """

    step: int
    time: float
    observation: Array | dict[str, Array]
    reward: Array
    terminated: bool
    truncated: bool
    info: dict[str, Array]


@dataclass(frozen=True)
class Claim:
    """What a client has claimed of a world that it shares with others.

    Attributes:
        client: its number, by which others know it.
        vehicles: names of all that it has now.
        scenario, seed: of the episode that is flown.
        pace: "barrier" or "free".
        factor: simulated seconds per second of the wall clock; 0: as fast as the clients ask.
        time_step: simulation step [s].
        tick: now.
        on_silence, hold: what the vehicles do without this client, and after how many seconds (0: never).
    """

    client: int
    vehicles: tuple[str, ...]
    scenario: str
    seed: int
    pace: str
    factor: float
    time_step: float
    tick: int
    on_silence: str
    hold: float


@dataclass(frozen=True)
class Heard:
    """A message that a vehicle has heard over the radio.

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
    payload: Array


@dataclass(frozen=True)
class SensedVehicle:
    """What one vehicle senses.

    Attributes:
        valid: it flies.
        reason: why it does not, "" where it does.
        sensors: sensor -> field -> value, a number or an array; "time" is when the reading was true [s], "fresh"
            whether it has arrived at this tick, "reason" why one is missing.
        state: (13,) true state as in ``State``, None where it was not asked for.
        heard: over the radio, the newest message of each sender, the newest first.
    """

    valid: bool
    reason: str
    sensors: dict[str, dict[str, Any]]
    state: Array | None
    heard: tuple[Heard, ...] = ()


@dataclass(frozen=True)
class Sensed:
    """What some vehicles sense at a tick.

    Attributes:
        tick, time: simulated, of the tick [s].
        sent: monotonic clock of the server when it was sent [s].
        missed: how many this client was too slow for.
        vehicles: by name.
    """

    tick: int
    time: float
    sent: float
    missed: int
    vehicles: dict[str, SensedVehicle]


@dataclass(frozen=True)
class VehicleStatus:
    """Who flies a vehicle, and how.

    Attributes:
        client: number of the client that has claimed it, 0: nobody.
        flies: by "guidance", "command", or without its controller "hold", "return" or "stop".
        source_tick: of the readings that its last order was computed from; None: unknown, or no order.
        arrival_tick, age: of that order, the latter in seconds; None: there was none.
        misses: how often a barrier went on without its client.
        silent_since: time of the last order [s], where nothing was heard for too long; else None.
    """

    client: int
    flies: str
    source_tick: int | None
    arrival_tick: int | None
    age: float | None
    misses: int
    silent_since: float | None


@dataclass(frozen=True)
class Status:
    """How a shared world goes.

    Attributes:
        pace: "barrier" or "free".
        tick, time: now [s].
        pacing: of its clock, as ``pace`` returns it: factor, steps, overruns, worst_delay, simulated, wall.
        vehicles: by name.
    """

    pace: str
    tick: int
    time: float
    pacing: dict[str, float]
    vehicles: dict[str, VehicleStatus]


def state_of(found: Any) -> State:
    """Convert a protobuf STATE to a ``State`` record."""
    return State(
        found.t,
        np.array([row.value for row in found.X]).reshape(len(found.X), -1),
        np.array([row.value for row in found.eX]).reshape(len(found.eX), -1),
        tuple(found.reason),
    )


def heard_of(found: Iterable[Any]) -> tuple[Heard, ...]:
    """Convert the radio messages that a vehicle has received from protobuf to ``Heard`` records."""
    return tuple(Heard(each.sender, each.sent, each.received, each.rssi, np.array(each.value)) for each in found)


def axes_of(found: Iterable[Any]) -> tuple[Axis, ...]:
    """Convert the protobuf description of an action's numbers."""
    return tuple(
        Axis(
            name=axis.name, unit=axis.unit, low=axis.low, high=axis.high,
            neutral=axis.neutral if axis.HasField("neutral") else 0.5 * (axis.low + axis.high),
        )
        for axis in found
    )  # fmt: skip


def arrays_of(found: Iterable[Any]) -> dict[str, Array]:
    """Convert protobuf arrays to a dict: name -> array."""
    return {part.name: np.array(part.value, np.float32).reshape(part.shape) for part in found}


def seen_of(found: Iterable[object]) -> Array | dict[str, Array]:
    """Return the agents' observation from protobuf: one array, or several by name."""
    arrays = arrays_of(found)
    return arrays[""] if list(arrays) == [""] else arrays
