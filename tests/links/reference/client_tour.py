"""Every call of the client in Python, in a process of its own: ``client_tour.py PORT``; prints what came back as JSON.

It runs on Python 3.8 with NumPy and protobuf alone.
"""

from __future__ import annotations

import json
import sys

import google.protobuf
import numpy as np
from qrsim_client import Client, ConnectionFailed, InvalidState, QrsimError, Refused, UsageError

HERE = [6.0, -8.0, -9.0]
HOLD = [[*HERE, 0.0]]


def tour(port: int) -> dict[str, object]:
    found: dict[str, object] = {"protobuf": google.protobuf.__version__, "python": sys.version_info[:2]}
    with Client(port=port, timeout=300.0) as client:
        state = client.init("TaskComplacs")
        found["init"] = [client.size, client.time_step, state.time, state.state.shape, state.measured.shape]
        found["waypoint"] = client.step_waypoint(1.0, HOLD).state[0].tolist()
        client.step_velocity(0.1, np.array([[0.5, 0.0, 0.0]]))
        client.step_control(0.02, [[0.0, 0.0, 0.59, 0.0, 12.0]])
        client.reset()
        client.set_state([[5.0, -6.0, -8.0, 0.0, 0.1, 0.2]])
        found["set_state"] = client.step_waypoint(0.02, [[5.0, -6.0, -8.0, 0.2]]).state[0].tolist()
        for name, call in {
            "invalid": lambda: client.step_velocity(8.0, [[0.0, 0.0, -3.0]]),
            "refused": lambda: client.step_waypoint(0.03, HOLD),
            "usage": lambda: client.set_state("here"),
            "claim": lambda: client.claim("pelicans_0"),
            "order": lambda: client.command({"pelicans_0": ("waypont", HOLD[0])}),
        }.items():
            try:
                call()
            except QrsimError as error:
                found[name] = [type(error).__name__, str(error)]
        assert issubclass(InvalidState, Refused)
        assert issubclass(UsageError, ValueError)
        hello = client.hello()
        session = client.open("free_flight", seed=5, events=True)
        found["open"] = [session.scenario, session.seed, list(session.vehicles), "reasons" in hello["capabilities"]]
        world = client.describe()
        found["describe"] = [world["area"]["type"], sorted(world["fleets"]["pelicans"]["sensors"])[0]]
        found["restart"] = [client.restart().seed, client.restart(9).seed]
        readings = client.readings()["pelicans_0"]
        found["readings"] = [sorted(readings), np.shape(readings["attitude"]["quaternion"]), readings["gnss"]["reason"]]
        client.step_velocity(8.0, [[0.0, 0.0, -3.0]])
        found["events"] = [event["kind"] for event in client.events()]
        found["pace"] = client.pace()["factor"]
        episode = client.play("keep_spot", seed=7)
        outcome = client.act([[0.0, 0.0, 0.0, 0.0, 1.0]])
        found["play"] = [episode.agents, episode.seed, episode.steps, outcome.step, float(outcome.reward[0])]
        with Client(port=port) as watcher:
            states = watcher.watch(timeout=20.0)
            client.act([[0.0, 0.0, 0.0, 0.0, 1.0]])
            found["watched"] = next(states).state.shape
        client.disconnect()
    with Client(port=port) as client:
        found["quit"] = client.quit()
    try:
        Client(port=1)
    except ConnectionFailed as error:
        found["nobody"] = str(error)
    return found


if __name__ == "__main__":
    print(json.dumps(tour(int(sys.argv[1]))))
