"""Messages over the radio as topics."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.errors import UsageError
from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.messages import Messages
from qrsim.links.ros2.radio import ARRAY, DIMENSION, hand_over
from qrsim.links.ros2.typestore import Types
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

TYPES = Types("jazzy")
CONTENT = {
    "name": "trio",
    "duration": 60.0,
    "world": {"radio": {"preset": "wifi_2g4", "size": 3}},
    "fleets": {
        "uav": {
            "controller": {"type": "cascade", "feed": "truth"},
            "vehicles": [{"position_ned": [10.0 * i, 0, -20]} for i in range(3)],
        },
    },
}


def array(numbers, to=None):
    message = empty(TYPES, ARRAY)
    message.data = np.array(numbers, np.float64)
    if to is not None:
        message.layout.dim = [TYPES[DIMENSION](to, len(numbers), len(numbers))]
    return message


@pytest.fixture(scope="module")
def simulation():
    return Simulation(load_scenario(CONTENT).world(), seed=1)


def heard(simulation, said, ticks=30):
    """Return (topic, sender, numbers) of what is heard of a message."""
    simulation.reset()
    messages = Messages(TYPES, simulation)
    found = []
    hand_over(simulation, messages.namespaces, said)
    for _ in range(ticks):
        simulation.advance()
        for topic, cdr in messages.due(["guidance"] * 3):
            name = messages.topics[topic].name
            if name.endswith("/radio/rx"):
                message = TYPES.decode(cdr, ARRAY)
                assert TYPES.encode(message) == cdr
                found.append((name, message.layout.dim[0].label, message.data.tolist()))
    return found


@pytest.mark.long
def test_what_one_says_all_hear_once(simulation):
    found = heard(simulation, [(0, array([1.0, 2.0, 3.0]))])
    own = sorted(each for each in found if each[2] == [1.0, 2.0, 3.0])
    assert own == [("/uav_1/radio/rx", "uav_0", [1.0, 2.0, 3.0]), ("/uav_2/radio/rx", "uav_0", [1.0, 2.0, 3.0])]


@pytest.mark.long
def test_another_episode_is_heard_again(simulation):
    simulation.reset()
    messages = Messages(TYPES, simulation)
    for _ in range(2):
        hand_over(simulation, messages.namespaces, [(0, array([4.0, 5.0, 6.0]))])
        count = 0
        for _ in range(30):
            simulation.advance()
            names = [messages.topics[topic].name for topic, _ in messages.due(["guidance"] * 3)]
            count += "/uav_1/radio/rx" in names
        assert count >= 1
        simulation.reset()
        list(messages.due(["guidance"] * 3))


def test_one_alone_can_be_told(simulation):
    found = heard(simulation, [(0, array([7.0, 8.0], to="uav_2"))])
    assert [each for each in found if each[2][:2] == [7.0, 8.0]] == [("/uav_2/radio/rx", "uav_0", [7.0, 8.0, 0.0])]


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (array([1.0], to="uav_9"), "radio/tx: no vehicle is called 'uav_9'"),
        (array([1.0, 2.0, 3.0, 4.0]), "4 numbers"),
        (array([np.nan]), "finite"),
    ],
)
def test_what_cannot_be_said(simulation, message, why):
    simulation.reset()
    with pytest.raises(UsageError, match=why):
        hand_over(simulation, ["uav_0", "uav_1", "uav_2"], [(0, message)])
