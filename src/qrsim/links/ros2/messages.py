"""All that is published of a world at a tick: topics and messages as bytes; DDS is not known here."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2 import topics as t
from qrsim.links.ros2 import variances
from qrsim.links.ros2.names import namespaces
from qrsim.links.ros2.template import Template
from qrsim.links.ros2.transforms import Transforms, static_transforms
from qrsim.links.ros2.typestore import Types
from qrsim.links.ros2.vehicle import Publication, Sensors, kinds_of
from qrsim.links.shared import sight as s
from qrsim.links.shared.sight import Sight
from qrsim.simulation.simulation import Simulation

Array = np.ndarray[Any, Any]
# A state is told so often, and when it changes [s].
STATE_EVERY_S = 1.0


class Messages:
    """The topics of a world and their messages.

    Args:
        types: of the distribution.
        simulation: reset.
        truth: whether the true motion and wind are published.

    Attributes:
        namespaces: of the vehicles, in their order.
        topics: all of them.
        static: message of /tf_static.
    """

    def __init__(self, types: Types, simulation: Simulation, truth: bool = False):
        self._types, self._simulation, self._truth = types, simulation, truth
        self._sight = Sight(simulation)
        self.namespaces = namespaces(simulation.vehicle_names)
        self.topics: list[t.Topic] = [t.CLOCK, t.TF]
        self._dt = simulation.world.time_step
        self._vehicles: list[list[tuple[int, Publication]]] = []
        self._true: list[list[tuple[int, Publication]]] = []
        self._states = [self._add(t.Topic(f"/{name}/{t.STATE}", t.STATE_TYPE, "reliable")) for name in self.namespaces]
        self._told: list[tuple[str, float]] = [("", -math.inf)] * simulation.size
        self._noise = np.zeros((3, simulation.size))
        for number, fleet in enumerate(simulation.world.fleets):
            for vehicle in range(fleet.size):
                self._add_vehicle(number, vehicle)
        self._columns = sorted({own.sensor for each in self._vehicles for _, own in each if own.sensor is not None})
        clock = types["rosgraph_msgs/msg/Clock"](types["builtin_interfaces/msg/Time"](0, 0))
        self._clock = Template(types, clock)
        self._put_clock = self._clock.putter("clock.sec", "clock.nanosec")
        self._transforms = Transforms(types, self.namespaces)
        self.static = static_transforms(types, simulation, self.namespaces)

    def _add(self, topic: t.Topic) -> int:
        self.topics.append(topic)
        return len(self.topics) - 1

    def _add_vehicle(self, fleet: int, vehicle: int) -> None:
        row = len(self._vehicles)
        name, sight = self.namespaces[row], self._sight

        def sensors(column: int) -> Any:
            return sight.sensor(fleet, column)

        own = self._simulation.world.fleets[fleet]
        kinds = kinds_of(sensors, own.battery.drains, sight.has(s.WIND_NORTH, row))
        self._vehicles.append(self._published(kinds, name, sensors, vehicle))
        self._true.append(self._published(t.TRUE_KINDS, name, sensors, vehicle) if self._truth else [])
        distance = variances.of_range(sensors(s.RANGE), vehicle)
        self._noise[:, row] = (
            *distance,
            max((variances.of_attitude(sensor, vehicle) for sensor in own.sensors), default=0.0),
        )

    def _published(self, kinds: Any, name: str, sensors: Sensors, vehicle: int) -> list[tuple[int, Publication]]:
        made = [Publication(self._types, kind, name, sensors, vehicle) for kind in kinds]
        return [(self._add(own.topic), own) for own in made]

    def due(self, modes: list[str]) -> Iterator[tuple[int, bytes]]:
        """Yield what is published at the present tick: number of its topic, and message.

        Args:
            modes: by what each vehicle flies.
        """
        simulation, sight = self._simulation, self._sight
        sight.look()
        stamp = stamp_of(simulation.time)
        self._put_clock(*stamp)
        yield 0, bytes(self._clock.cdr)
        numbers = self._numbers()
        believed = [stamp_of(max(0.0, simulation.time - behind)) for behind in sight.behind]
        yield 1, self._transforms.message(numbers, believed)
        news = {column: sight.news(column) for column in self._columns}
        for row, (own, numbers_row) in enumerate(zip(self._vehicles, numbers.tolist(), strict=True)):
            for topic, publication in own:
                when = believed[row]
                if publication.sensor is not None:
                    fresh, times = news[publication.sensor]
                    if not fresh[row]:
                        continue
                    when = stamp_of(times[row])
                elif not self._is_time(publication.kind.every):
                    continue
                message = publication.message(numbers_row, *when)
                if message is not None:
                    yield topic, message
        if self._truth:
            yield from self._truths(stamp)
        yield from self._state_messages(modes)

    def _numbers(self) -> Array:
        values = n.seen(self._sight.values)
        still, growth, turn = self._noise
        values[:, n.RANGE_VARIANCE] = (still + growth * values[:, n.RANGE]) ** 2
        for first in (n.TURN_VARIANCE, n.IMU_VARIANCE):
            own = values[:, first : first + 3]
            own[:] = np.where(own == 0.0, turn[:, None], own)
        return values

    def _is_time(self, every: float) -> bool:
        return not every or self._simulation.tick % max(1, round(every / self._dt)) == 0

    def _truths(self, stamp: tuple[int, int]) -> Iterator[tuple[int, bytes]]:
        for own, row in zip(self._true, n.true(self._simulation).tolist(), strict=True):
            for topic, publication in own:
                message = publication.message(row, *stamp)
                if message is not None:
                    yield topic, message

    def _state_messages(self, modes: list[str]) -> Iterator[tuple[int, bytes]]:
        simulation = self._simulation
        stopped = np.asarray(simulation.packed[1][1])[self._sight.codes] != 0
        reasons = simulation.reasons if stopped.any() else [""] * simulation.size
        for row, topic in enumerate(self._states):
            text = json.dumps({"valid": not stopped[row].item(), "reason": reasons[row], "mode": modes[row]})
            before, at = self._told[row]
            if text != before or not 0.0 <= simulation.time - at < STATE_EVERY_S - 0.5 * self._dt:
                self._told[row] = text, simulation.time
                yield topic, text_message(self._types, text)


def stamp_of(time: float) -> tuple[int, int]:
    """Return seconds and nanoseconds of a simulated time [s]."""
    return divmod(round(time * 1e9), 1_000_000_000)


def text_message(types: Types, text: str) -> bytes:
    """Return a std_msgs/msg/String."""
    return types.encode(types["std_msgs/msg/String"](text))
