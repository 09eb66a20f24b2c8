"""Messages over the radio between vehicles, as topics: what a vehicle hears, and what it is to say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.messages import checked_message
from qrsim.links.ros2 import Message
from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types
from qrsim.simulation.simulation import Simulation

Checked = tuple[int, list[float], int]
ARRAY, DIMENSION = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/MultiArrayDimension"


def heard_topic(namespace: str) -> Topic:
    """Return the topic on which the radio messages received by a vehicle are published."""
    return Topic(f"/{namespace}/radio/rx", ARRAY, "reliable")


def said_topic(namespace: str) -> Topic:
    """Return the topic from which a vehicle takes radio messages to send."""
    return Topic(f"/{namespace}/radio/tx", ARRAY, "reliable")


class Inboxes:
    """What vehicles have heard, message by message.

    Args:
        types: of the distribution.
        simulation: with a radio.
        namespaces: of the vehicles.
    """

    def __init__(self, types: Types, simulation: Simulation, namespaces: Sequence[str]):
        self._types, self._simulation = types, simulation
        self._spaces = dict(zip(simulation.vehicle_names, namespaces, strict=True))
        # Of each vehicle, when the last message of each sender was sent.
        self._last: list[dict[str, float]] = [{} for _ in namespaces]
        self._time = simulation.time

    def new(self) -> Iterator[tuple[int, bytes]]:
        """Yield (row of the vehicle, CDR message) for each radio message received since the last call."""
        if self._simulation.time < self._time:
            # Another episode.
            self._last = [{} for _ in self._last]
        self._time = self._simulation.time
        for row, inbox in enumerate(self._simulation.inboxes()):
            last = self._last[row]
            for each in inbox:
                if last.get(each.sender) == each.sent:
                    continue
                last[each.sender] = each.sent
                numbers = each.payload.tolist()
                message = empty(self._types, ARRAY)
                label = self._spaces[each.sender]
                message.layout.dim = [self._types[DIMENSION](label, len(numbers), len(numbers))]
                message.data = each.payload.astype("float64")
                yield row, self._types.encode(message)


def hand_over(simulation: Simulation, namespaces: Sequence[str], said: Sequence[tuple[int, Message]]) -> list[Checked]:
    """Queue radio messages from ROS (``said``: row, message) at the radios, all or none; return them as (sender,
    numbers (D,), receiver or -1).

    Args:
        simulation: with a radio.
        namespaces: of the vehicles.
        said: row of the vehicle, and message; the label of its first dimension is the namespace of who alone is to
            hear it.

    Raises:
        UsageError: a message cannot be said; none of them is.
    """
    names = simulation.vehicle_names
    checked: list[Checked] = []
    for row, message in said:
        dimensions = message.layout.dim
        to = dimensions[0].label if len(dimensions) else ""
        if to and to not in namespaces:
            raise UsageError(f"radio/tx: no vehicle is called '{to[:60]}'{did_you_mean(to[:60], namespaces)}")
        receiver = names[list(namespaces).index(to)] if to else None
        numbers = [float(number) for number in message.data]
        checked.append(checked_message(simulation.world, names, names[row], numbers, receiver))
    simulation.send_all(checked)
    return checked
