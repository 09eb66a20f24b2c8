"""Topics of a world and their messages as bytes at each tick, independent of DDS."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import numpy as np

from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2 import topics as t
from qrsim.links.ros2.blank import stamp_of
from qrsim.links.ros2.perceived import Perceived
from qrsim.links.ros2.publications import Publications
from qrsim.links.ros2.radio import Inboxes, heard_topic
from qrsim.links.ros2.template import Template
from qrsim.links.ros2.transforms import static_transforms
from qrsim.links.ros2.typestore import Types
from qrsim.links.shared import sight as s
from qrsim.links.shared.sight import Sight
from qrsim.simulation.simulation import Simulation

# A state is told so often, and when it changes [s].
STATE_EVERY_S = 1.0


class Messages:
    """The topics of a world and their messages.

    Args:
        types: of the distribution.
        simulation: reset.
        truth: whether the true motion and wind are published.
        rate: see ``Publications``.

    Attributes:
        namespaces: of the vehicles, in their order.
        topics: all of them.
        static: message of /tf_static.
    """

    def __init__(self, types: Types, simulation: Simulation, truth: bool = False, rate: float = math.inf):
        self._types, self._simulation, self._truth = types, simulation, truth
        self._sight = sight = Sight(simulation)
        world, names = simulation.world, simulation.vehicle_names
        windy = [sight.has(s.WIND_NORTH, row) for row in range(simulation.size)]
        self._publications = own = Publications(types, world, names, sight.sensor, windy, truth, rate)
        self.namespaces, self.topics = own.namespaces, own.topics
        self._clock_topic = own.add(t.CLOCK)
        self._states = [own.add(t.Topic(f"/{name}/{t.STATE}", t.STATE_TYPE, "reliable")) for name in self.namespaces]
        self._perceived = Perceived(types, simulation, self.namespaces, own.add)
        self._inboxes = None if world.radio is None else Inboxes(types, simulation, self.namespaces)
        self._heard = [] if self._inboxes is None else [own.add(heard_topic(name)) for name in self.namespaces]
        self._sent_states: list[tuple[object, float]] = [(None, -math.inf)] * simulation.size
        # What the states were made of last, and from when on one of them is sent again though nothing changes.
        self._same_states: tuple[object, float, float] = (None, math.inf, -math.inf)
        clock = types["rosgraph_msgs/msg/Clock"](types["builtin_interfaces/msg/Time"](0, 0))
        self._clock = Template(types, clock)
        self._put_clock = self._clock.putter("clock.sec", "clock.nanosec")
        self.static = types.encode(static_transforms(types, world, self.namespaces, simulation.site))

    def due(self, modes: list[str]) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, CDR message) of every topic due at the present tick; ``modes``: flight mode of each
        vehicle.

        Args:
            modes: by what each vehicle flies.
        """
        simulation, sight = self._simulation, self._sight
        sight.look()
        self._put_clock(*stamp_of(simulation.time))
        yield self._clock_topic, bytes(self._clock.cdr)
        believed = [max(0.0, simulation.time - behind) for behind in sight.behind]
        news = {column: sight.news(column) for column in self._publications.columns}
        true = n.true(simulation) if self._truth else None
        # Estimates of the tick before begin with the first tick: no two may have the same time.
        if simulation.tick or not any(sight.behind):
            yield from self._publications.of_tick(simulation.tick, believed, sight.values, news, true)
        if simulation.tick:
            yield from self._perceived.new()
        yield from self._state_messages(modes)
        if self._inboxes is not None:
            for row, message in self._inboxes.new():
                yield self._heard[row], message

    def _state_messages(self, modes: list[str]) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, message) of each vehicle whose flight state has changed, or was sent STATE_EVERY_S [s]
        ago."""
        simulation = self._simulation
        # The whole numbers of the packed state contain the reason of each vehicle that has stopped, else 0.
        codes = np.asarray(simulation.packed[1][1])[self._sight.codes]
        stopped, key, time = codes != 0, (list(modes), codes.tobytes()), simulation.time
        last, first, again = self._same_states
        if last == key and first <= time < again:
            return
        reasons = simulation.reasons if stopped.any() else [""] * simulation.size
        # Half a tick, because times are multiples of the time step; the time is negative after a reset.
        period = STATE_EVERY_S - 0.5 * simulation.world.time_step
        for row, topic in enumerate(self._states):
            now = not stopped[row].item(), reasons[row], modes[row]
            before, at = self._sent_states[row]
            if now != before or not 0.0 <= time - at < period:
                self._sent_states[row] = now, time
                text = json.dumps(dict(zip(("valid", "reason", "mode"), now, strict=True)))
                yield topic, text_message(self._types, text)
        times = [at for _, at in self._sent_states]
        self._same_states = key, max(times), min(times) + period


def text_message(types: Types, text: str) -> bytes:
    """Return a text as an encoded std_msgs/msg/String."""
    return types.encode(types["std_msgs/msg/String"](text))
