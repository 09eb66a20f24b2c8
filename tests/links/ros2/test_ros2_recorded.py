"""Recordings of ``qrsim ros2``: flown again to the bit, with messages over the radio, injections and a reset."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from test_ros2_pilots import TYPES, Wire, twist
from test_ros2_radio import CONTENT, array

from qrsim.cli import main
from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.server import Options, Server
from qrsim.links.shared.recording import Recording
from qrsim.runs import open_run
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

CONTENT = {
    **CONTENT,
    "world": {**CONTENT["world"], "wind": {"type": "log_shear", "speed_20ft": 2.0, "wind_from_deg": 0}},
}


def text(words):
    message = empty(TYPES, "std_msgs/msg/String")
    message.data = words
    return message


@pytest.mark.long
def test_a_flight_is_flown_again_to_the_bit(tmp_path, capsys):
    scenario = load_scenario(CONTENT)
    wire, simulation, said = Wire(), Simulation(scenario.world(), seed=1), []
    record = partial(Recording, tmp_path, scenario, simulation)
    server = Server(simulation, TYPES, Options(pace="free"), said.append, wire, None, record)

    def fly(ticks, **sent):
        for _ in range(ticks):
            wire.waiting |= {f"/{name.replace('__', '/')}": list(messages) for name, messages in sent.items()}
            server.listen()
            server.tick()

    fly(30, uav_0__cmd_vel=[twist((2.0, 0.0, 0.0), 0.3)])
    # The second message of a tick replaces the first.
    fly(1, uav_1__radio__tx=[array([1.0]), array([2.0, 3.0])])
    fly(20, uav_1__radio__tx=[array([4.0, 5.0, 6.0], "uav_2")], uav_0__cmd_vel=[twist((0.0, 1.0, 0.0))])
    fly(1, qrsim__control=[text("wind 6 90"), text("inject link off uav_2 for 1")])
    fly(40, uav_2__cmd_vel=[twist((3.0, 0.0, 0.0))])
    fly(1, qrsim__control=[text("reset 9")])
    fly(10, uav_0__cmd_vel=[twist((2.0, 0.0, 0.0))])
    assert server.recording is not None
    server.recording.close()
    assert {"Wind: 6 m/s at 20 ft from 90 degrees", "Injected: link off of uav_2 for 1 s"} < set(said)
    (folder,) = tmp_path.iterdir()
    first, second = (folder / name for name in ("episode-0001", "episode-0002"))
    run = open_run(first)
    assert [(one["target"], one["kind"], one["tick"]) for one in run.injections] == [
        ("world", "wind", 51),
        ("link", "off", 51),
    ]
    orders = run["orders"]
    assert orders["said_tick"][[30, 31, 51, 91], 1].tolist() == [-1, 30, 50, 50]
    assert orders["said_1"][[31, 51], 1].tolist() == [3.0, 5.0]
    # Lost while its link is off.
    assert not np.any(orders["kind"][:, 2])
    for path, ticks in ((first, 92), (second, 11)):
        assert main(["replay", str(path)]) == 0
        assert f"{ticks} ticks of 3 vehicles: the same to the bit" in capsys.readouterr().out
    assert (run.info.seed, open_run(second).info.seed) == (1, 9)
