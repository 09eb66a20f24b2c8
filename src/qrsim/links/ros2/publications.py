"""Topics of all vehicles, and their messages for the numbers of a tick, wherever those are from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2 import topics as t
from qrsim.links.ros2 import variances
from qrsim.links.ros2.alike import MANY, Alike
from qrsim.links.ros2.blank import stamp_of, stamps_of
from qrsim.links.ros2.names import namespaces
from qrsim.links.ros2.transforms import Transforms
from qrsim.links.ros2.typestore import Types
from qrsim.links.ros2.vehicle import Publication, Sensors, kinds_of
from qrsim.links.shared import sight as s
from qrsim.world.state import World

# Of each vehicle whether a sensor has delivered, and when that was true [s].
News = tuple[list[bool], list[float]]


class Publications:
    """What vehicles publish of what they know.

    Args:
        types: of the distribution.
        world: of the vehicles.
        names: of them.
        sensor: finds the sensor of a fleet, by its number, that a column (shared/sight.py) is of, or None.
        windy: of each vehicle whether its wind is known.
        truth: whether the true motion and wind are published.
        rate: how often estimates, TF and truth are published at most [Hz].

    Attributes:
        namespaces: of the vehicles.
        topics: all of them.
        columns: whose sensors' news are needed.
    """

    def __init__(
        self,
        types: Types,
        world: World,
        names: Sequence[str],
        sensor: Callable[[int, int], Any],
        windy: Sequence[bool],
        truth: bool,
        rate: float = math.inf,
    ):
        self._types, self._truth, self._dt = types, truth, world.time_step
        self._each = max(1, math.ceil(1.0 / (rate * world.time_step) - 1e-6))
        self.namespaces = namespaces(names)
        self.topics: list[t.Topic] = [t.TF]
        self._transforms = Transforms(types, self.namespaces)
        self._vehicles: list[list[tuple[int, Publication]]] = []
        self._true: list[list[tuple[int, Publication]]] = []
        self._noise = np.zeros((3, len(names)))
        for number, fleet in enumerate(world.fleets):

            def sensors(column: int, number: int = number) -> Any:
                """Return this fleet's sensor that fills a column of the readings; None without one."""
                return sensor(number, column)

            for vehicle in range(fleet.size):
                row = len(self._vehicles)
                kinds = kinds_of(sensors, fleet.battery.drains, windy[row])
                self._vehicles.append(self._added(kinds, row, sensors, vehicle))
                self._true.append(self._added(t.TRUE_KINDS, row, sensors, vehicle) if truth else [])
                distance = variances.of_range(sensors(s.RANGE), vehicle)
                attitude = max((variances.of_attitude(each, vehicle) for each in fleet.sensors), default=0.0)
                self._noise[:, row] = (*distance, attitude)
        # Of many vehicles the messages that differ in their numbers alone are made together.
        forms: dict[tuple[object, ...], list[tuple[int, int, Publication]]] = {}
        for row, each in enumerate(self._vehicles):
            for topic, own in each:
                forms.setdefault(own.form, []).append((topic, row, own))
        groups = [tuple(zip(*group, strict=True)) for group in forms.values() if len(group) >= MANY]
        self._alike = [(owns[0], topics, Alike(owns, rows)) for topics, rows, owns in groups]
        self._together = {topic for _, topics, _ in self._alike for topic in topics}
        self._single = [
            (topic, row, own)
            for row, each in enumerate(self._vehicles)
            for topic, own in each
            if topic not in self._together
        ]
        # The messages of a tick, by the numbers of their topics.
        self._made: list[bytes | None] = [None] * len(self.topics)
        self.columns = sorted({own.sensor for each in self._vehicles for _, own in each if own.sensor is not None})

    def add(self, topic: t.Topic) -> int:
        """Add a topic to those published, and return its number."""
        self.topics.append(topic)
        return len(self.topics) - 1

    def _added(
        self, kinds: Sequence[t.Kind], row: int, sensors: Sensors, vehicle: int
    ) -> list[tuple[int, Publication]]:
        """Add the topics of the vehicle at ``row``, and return each with its number; ``vehicle``: its number in the
        fleet."""
        made = [Publication(self._types, kind, self.namespaces[row], sensors, vehicle) for kind in kinds]
        return [(self.add(own.topic), own) for own in made]

    def of_tick(
        self,
        tick: int,
        believed: list[float],
        values: NumpyArray,
        news: Mapping[int, News],
        true: NumpyArray | None,
    ) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, CDR message) of every topic due at a tick, from the vehicles' values and new readings
        (``news``).

        Args:
            tick: its number.
            believed: of each vehicle when its estimate held [s].
            values: (n, sight.WIDTH) what vehicles know of themselves.
            news: of sensors by column.
            true: (n, numbers.WIDTH), with the truth.
        """
        due = tick % self._each == 0
        if not due and not any(any(fresh) for fresh, _ in news.values()):
            return
        numbers, stamps = self._filled_numbers(values), stamps_of(believed)
        if due:
            yield 0, self._transforms.message(numbers, stamps)
        made = self._made[:]
        for publication, topics, alike in self._alike:
            column = publication.sensor
            messages: Sequence[bytes | None] = ()
            if column is None and due and self._is_due(tick, publication.kind.every):
                messages = alike.messages(numbers, stamps)
            elif column is not None and any(news[column][0]):
                fresh, times = news[column]
                messages = alike.messages(numbers, stamps_of(times))
                if not all(fresh):
                    rows = zip(alike.rows.tolist(), messages, strict=True)
                    messages = [message if fresh[row] else None for row, message in rows]
            for topic, message in zip(topics, messages, strict=False):
                made[topic] = message
        if self._single:
            alone, each = numbers.tolist(), stamps.tolist()
            for topic, row, publication in self._single:
                made[topic] = self._alone(publication, row, alone[row], (tick, due), each[row], news)
        yield from ((topic, message) for topic, message in enumerate(made) if message is not None)
        if due and true is not None:
            yield from self._true_messages(true, stamp_of(tick * self._dt))

    def _alone(
        self,
        publication: Publication,
        row: int,
        numbers: Sequence[float],
        now: tuple[int, bool],
        stamp: Sequence[int],
        news: Mapping[int, News],
    ) -> bytes | None:
        """Return the CDR message of one vehicle's topic, with its time ``stamp`` (s, ns); None if it is not due at this
        tick.

        Args:
            publication: the topic's kind of message and its sensor, if it has one.
            row: the vehicle's number.
            numbers: (WIDTH,) values for the vehicle's messages.
            now: the tick, and whether estimates are due.
            stamp: time of the vehicle's estimate, seconds and nanoseconds.
            news: for each sensor (by column of the log) which vehicles have a new reading, and its times.
        """
        if publication.sensor is not None:
            fresh, times = news[publication.sensor]
            return publication.message(numbers, *stamp_of(times[row])) if fresh[row] else None
        tick, due = now
        return publication.message(numbers, *stamp) if due and self._is_due(tick, publication.kind.every) else None

    def _filled_numbers(self, values: NumpyArray) -> NumpyArray:
        """Convert estimates and readings to numbers of ROS messages (n, WIDTH), with the sensors' variances filled
        in."""
        numbers = n.seen(values)
        still, growth, turn = self._noise
        measured = np.where(np.isfinite(numbers[:, n.RANGE]), numbers[:, n.RANGE], 0.0)
        numbers[:, n.RANGE_VARIANCE] = (still + growth * measured) ** 2
        for first in (n.TURN_VARIANCE, n.IMU_VARIANCE):
            own = numbers[:, first : first + 3]
            own[:] = np.where(own == 0.0, turn[:, None], own)
        return numbers

    def _is_due(self, tick: int, every: float) -> bool:
        """Return whether a message with the period ``every`` [s] is due at a tick."""
        # Of ticks at which something is published.
        return not every or tick // self._each % max(1, round(every / (self._dt * self._each))) == 0

    def _true_messages(self, true: NumpyArray, stamp: tuple[int, int]) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, CDR message) of the vehicles' true states (n, WIDTH) at a time ``stamp`` (s, ns)."""
        for own, row in zip(self._true, true.tolist(), strict=True):
            for topic, publication in own:
                message = publication.message(row, *stamp)
                if message is not None:
                    yield topic, message
