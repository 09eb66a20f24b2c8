"""Vehicles that fly by flight stacks, as those of ``qrsim mavlink``, and are asked over the topics of an API."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Literal

from qrsim.errors import UsageError
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.world import FlownWorld
from qrsim.links.ros2 import Message
from qrsim.links.ros2.apis import mavros, mavros_asked, px4, px4_asked
from qrsim.links.ros2.apis.contracts import EACH, Answered, Heard, Interface, Told
from qrsim.links.ros2.apis.modes import name_of
from qrsim.links.ros2.apis.texts import Texts
from qrsim.links.ros2.names import namespaces
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types

ApiName = Literal["mavros", "px4"]
PACKAGES: dict[str, Sequence[str]] = {"mavros": mavros.PACKAGES, "px4": px4.PACKAGES}


def spaces_of(api: ApiName, names: Sequence[str], pattern: str | None) -> list[str]:
    """Return each vehicle's topic prefix for an API, such as "/uav1/mavros/" or "/px4_1/fmu/"; ``pattern``: the user's
    own.

    Args:
        api: whose topics they are.
        names: of the vehicles.
        pattern: of the namespaces, with {name}, {i} from 0 and {n} from 1; None: of PX4's simulation, no namespace for
            the first vehicle and px4_1, px4_2, ... for the others; of mavros, no namespace for a single vehicle, else
            the names of the vehicles.

    Raises:
        UsageError: the pattern has other fields, gives no names of ROS, or the same one twice.
    """
    own = namespaces(names)
    if pattern is None:
        if api == "px4":
            found = ["", *(f"px4_{i}" for i in range(1, len(own)))]
        else:
            found = own if len(own) > 1 else [""]
    else:
        try:
            found = [pattern.format(name=name, i=i, n=i + 1).strip("/") for i, name in enumerate(own)]
        except (KeyError, IndexError, ValueError, AttributeError):
            raise UsageError(f"--namespaces {pattern}: expected a text with {{name}}, {{i}} or {{n}}") from None
        for space in found:
            if space and namespaces(space.split("/")) != space.split("/"):
                raise UsageError(f"--namespaces {pattern}: '{space}' is no name in ROS")
        if len(set(found)) < len(found):
            raise UsageError(f"--namespaces {pattern}: {len(found)} vehicles need {{name}}, {{i}} or {{n}}")
    last = "mavros" if api == "mavros" else "fmu"
    return [f"/{space}/{last}/" if space else f"/{last}/" for space in found]


class Flown:
    """The vehicles of a world, their topics and their services.

    Args:
        types: of the distribution, with the PACKAGES of the API.
        world: with stacks in PX4's flavour.
        api: by which they are asked.
        pattern: of namespaces (``spaces_of``).
        rate: how often estimates are published at most [Hz].

    Attributes:
        world: whose vehicles they are.
        topics: that are published.
        heard, answered: topics that are subscribed to, and services.
        spaces: see ``spaces_of``.
    """

    def __init__(self, types: Types, world: FlownWorld, api: ApiName, pattern: str | None, rate: float):
        self.world = world
        self._rate, self._dt = rate, world.simulation.world.time_step
        self.spaces = spaces_of(api, [system.name for system in world.systems], pattern)
        self._asked: list[px4_asked.Asked] = []
        self.topics: list[Topic] = []
        self.heard: list[Heard] = []
        self.answered: list[Answered] = []
        self._told: list[tuple[System, list[_Scheduled]]] = []
        for system, space in zip(world.systems, self.spaces, strict=True):
            made = (
                self._mavros_interface(types, system, space)
                if api == "mavros"
                else self._px4_interface(types, system, space)
            )
            scheduled = []
            for told in made.told:
                scheduled.append(_Scheduled(told, len(self.topics), self._every(told.rate)))
                self.topics.append(told.topic)
            self._told.append((system, scheduled))
            self.heard += [replace(each, take=_unless_muted(system, each.take)) for each in made.heard]
            self.answered += [replace(each, answer=_unless_muted(system, each.answer)) for each in made.answered]

    def _mavros_interface(self, types: Types, system: System, space: str) -> Interface:
        """Return the topics and services of mavros for the vehicle ``system``, with the topic prefix ``space``."""
        texts = Texts(system.number, self._dt)
        system.links.append(texts)
        asked = mavros_asked.Asked(types, system, space)
        return Interface(list(mavros.published(types, space, texts)), list(asked.heard()), list(asked.answered()))

    def _px4_interface(self, types: Types, system: System, space: str) -> Interface:
        """Return the topics and services of PX4's uXRCE-DDS client for the vehicle ``system``, with the topic prefix
        ``space``."""
        asked = px4_asked.Asked(types, system, space)
        self._asked.append(asked)
        told = [*px4.published(types, system, space, self._dt), asked.told()]
        return Interface(told, list(asked.heard()), [asked.answered()])

    def _every(self, rate: float) -> int:
        """Convert a topic's rate [Hz] to a period in ticks; 0 for one that is sent on changes or on demand."""
        if rate == EACH:
            return 0
        return max(1, round(1.0 / (min(rate, self._rate) * self._dt))) if rate else 0

    @property
    def modes(self) -> list[str]:
        """Return each vehicle's flight mode, as a text, or the guidance of its scenario."""
        simulation = self.world.simulation
        found = dict.fromkeys(simulation.vehicle_names, "guidance")
        found |= {system.name: name_of(system.stack.heartbeat().custom_mode) for system in self.world.systems}
        return list(found.values())

    def advance(self) -> None:
        """Advance the simulation and the flight stacks by one tick."""
        self.world.tick(time.monotonic())

    def reset(self, seed: int) -> None:
        """Reset the simulation and the flight stacks for an episode with a seed."""
        self.world.reset(seed)
        for asked in self._asked:
            asked.restart()

    def due(self) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, CDR message) of every topic that is due at the present tick."""
        tick = self.world.simulation.tick
        for system, scheduled in self._told:
            for each in () if system.muted else scheduled:
                yield from each.due(tick, system)


def _unless_muted(system: System, does: Callable[[Message], Message]) -> Callable[[Message], Message]:
    """Wrap a service or topic handler (``does``) so that it returns None while the vehicle's link is off."""
    return lambda message: None if system.muted else does(message)


class _Scheduled:
    """A topic, and when it was published last."""

    def __init__(self, told: Told, number: int, every: int):
        self._told, self._number, self._every = told, number, every
        self._key: object = None

    def due(self, tick: int, system: System) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, CDR message) of this vehicle's topics that are due at a tick."""
        told, view = self._told, system.view
        if told.rate == EACH:
            while (message := told.make(view)) is not None:
                yield self._number, message
            return
        key = None if told.key is None else told.key(view)
        if key != self._key or (self._every and tick % self._every == 0):
            self._key = key
            message = told.make(view)
            if message is not None:
                yield self._number, message
