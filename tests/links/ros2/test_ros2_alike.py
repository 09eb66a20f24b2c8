"""Messages of many vehicles, made together: the bytes of one by one."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2 import topics as t
from qrsim.links.ros2.alike import Alike
from qrsim.links.ros2.publications import Publications
from qrsim.links.ros2.typestore import Types
from qrsim.links.ros2.vehicle import Publication
from qrsim.links.shared import sight as s
from qrsim.scenarios.catalogue import SENSORS
from qrsim.scenarios.scenario import load_scenario

TYPES = Types("jazzy")


def sensors(column):
    """Return a sensor for the columns of an IMU."""
    return {s.RATES: SENSORS["ideal_gyroscope"](), s.FORCE: SENSORS["ideal_accelerometer"]()}.get(column)


@pytest.mark.parametrize("kind", [*t.KINDS, *t.TRUE_KINDS], ids=lambda kind: kind.topic)
def test_messages_together_are_those_alone(kind):
    random, rows = np.random.default_rng(4), [3, 1, 0]
    numbers = random.normal(size=(5, n.WIDTH))
    numbers[:, n.FIX_STATUS] = [0.0, 2.0, 0.0, 2.0, 0.0]
    numbers[1, :: 1 + kind.needs[0] if kind.needs else 1] = np.nan
    numbers[1, n.FIX_STATUS] = 2.0
    stamps = [(7, 40_000_000 + row) for row in range(5)]
    each = [Publication(TYPES, kind, f"uav_{row}", sensors, 0) for row in rows]
    alone = [own.message(numbers[row].tolist(), *stamps[row]) for row, own in zip(rows, each, strict=True)]
    together = Alike([Publication(TYPES, kind, f"uav_{row}", sensors, 0) for row in rows], rows)
    assert together.messages(numbers, stamps) == alone
    assert alone[0] is not None
    # What is sent next has nothing of what was sent before.
    assert together.messages(numbers[::-1], stamps)[2] == each[2].message(numbers[4].tolist(), *stamps[0])


def test_topics_of_a_tick_come_by_vehicle():
    """Six vehicles; the first two have longer names, and are too few for most of their messages to be made together."""
    world = load_scenario(
        {
            "name": "six",
            "duration": 1.0,
            "fleets": {
                name: {
                    "controller": {"type": "waypoint", "feed": "truth"},
                    "sensors": {"barometer": {"type": "ideal_barometer"}, "gyroscope": {"type": "ideal_gyroscope"}},
                    "vehicles": [{"position_ned": [10.0 * i, at, -20.0]} for i in range(count)],
                }
                for name, count, at in (("of_a_long_name", 2, 0.0), ("uav", 4, 50.0))
            },
        }
    ).world()
    names = [name for fleet in world.fleets for name in fleet.vehicle_names]
    kinds = {s.HEIGHT: world.fleets[0].sensors[0], s.RATES: world.fleets[0].sensors[1]}
    made = Publications(TYPES, world, names, lambda fleet, column: kinds.get(column), [False] * 6, False)
    values = np.random.default_rng(5).normal(size=(6, s.WIDTH))
    news = {column: ([True, True, True, False, True, True], [0.5] * 6) for column in made.columns}
    sent = list(made.of_tick(1, [0.5] * 6, values, news, None))
    numbers = [number for number, _ in sent]
    assert numbers == sorted(numbers)
    spaces = [made.topics[number].name.split("/")[1] for number, _ in sent]
    # The fourth vehicle has nothing new of its two sensors.
    assert [spaces.count(name) for name in names] == [spaces.count("uav_0")] * 3 + [spaces.count("uav_0") - 2] + [
        spaces.count("uav_0")
    ] * 2
    # A longer name moves the numbers of an odometry, whose child frame has it; a pose is in the map.
    together = {made.topics[number].name for number in made._together}
    assert {"/uav_3/odom", "/of_a_long_name_0/pose"} < together
    assert "/of_a_long_name_0/odom" not in together
