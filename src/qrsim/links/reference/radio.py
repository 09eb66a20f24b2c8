"""Messages over the radio between vehicles, as clients say them and hear them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError
from qrsim.interface.messages import Message as Received
from qrsim.interface.messages import checked_message
from qrsim.links.contracts import Words
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Act
from qrsim.links.reference.readout import varint
from qrsim.simulation.simulation import Simulation
from qrsim.tasks import Play

_HEARD = b"\x32"


def words_of(request: pb.Say) -> list[Words]:
    """Return the radio messages of a SAY request; raises UsageError for invalid names and two messages of one vehicle.

    Raises:
        UsageError: a name is no text, or a vehicle says two things at once.
    """
    found = []
    for each in request.words:
        if not isinstance(each.vehicle, str) or not isinstance(each.to, str):
            raise UsageError("message: a text is not UTF-8")
        found.append(Words(each.vehicle, tuple(each.value), each.to if each.HasField("to") else None))
    for name, count in Counter(words.vehicle for words in found).items():
        if count > 1:
            raise UsageError(f"SAY: '{name}' is given {count} messages; one is allowed")
    return found


def hand_over(simulation: Simulation, words: Sequence[Words]) -> None:
    """Queue messages at the vehicles' radios in the simulation, all or none; raises UsageError for invalid messages."""
    world, names = simulation.world, simulation.vehicle_names
    simulation.send_all([checked_message(world, names, each.vehicle, each.numbers, each.to) for each in words])


def heard_by_all(simulation: Simulation) -> list[list[pb.Readings.Heard]]:
    """Return for each vehicle, in protobuf, the newest radio message that it has received from each sender."""
    if simulation.world.radio is None:
        return [[] for _ in range(simulation.size)]
    return [[_heard_message(each) for each in heard] for heard in simulation.inboxes()]


def _heard_message(found: Received) -> pb.Readings.Heard:
    """Convert a received radio message to protobuf."""
    return pb.Readings.Heard(
        sender=found.sender, sent=found.sent, received=found.received, rssi=found.rssi, value=found.payload.tolist()
    )


def heard_bytes(heard: Sequence[pb.Readings.Heard]) -> bytes:
    """Encode the radio messages that a vehicle has received as bytes of its part of a READINGS message."""
    parts = [each.SerializeToString() for each in heard]
    return b"".join(_HEARD + varint(len(part)) + part for part in parts)


def said(play: Play, request: Act) -> NumpyArray:
    """Return the agents' radio messages (n, D) from an ACT request, NaN where an agent sends none; D = 0 without a
    radio.

    Raises:
        UsageError: there is no radio, or not one message of each agent, of D finite numbers or none.
    """
    agents, size = play.agents, play.message
    found = np.full((len(agents), size), np.nan)
    if not request.say:
        return found
    if not size:
        raise UsageError("say: the scenario has no world.radio")
    if len(request.say) != len(agents):
        raise UsageError(f"say: there are {len(request.say)} messages; expected {len(agents)}, one of each agent")
    for i, (name, row) in enumerate(zip(agents, request.say, strict=True)):
        if len(row.value) not in (0, size):
            raise UsageError(f"say of '{name}': {len(row.value)} numbers; expected {size} (world.radio.size), or none")
        if len(row.value):
            found[i] = row.value
            if not (np.abs(found[i]) <= np.finfo(np.float32).max).all():
                raise UsageError(f"say of '{name}': a number is not finite")
    return found
