# Written by generate.py from src/qrsim/links/reference/replies.py: change that.
"""Replies of ``qrsim serve`` as the client returns and raises them; for Python 3.8 and later, as ``client``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from qrsim_client.errors import RunError

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
    """One number of an action; -1 and 1 of the action mean ``low`` and ``high`` in ``unit``."""

    name: str
    unit: str
    low: float
    high: float


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
