"""Services of simulation_interfaces for 'qrsim ros2', by its topics /qrsim/control and /qrsim/status."""

import json
import threading

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from simulation_interfaces.srv import GetSimulationState, ResetSimulation, SetSimulationState, StepSimulation
from std_msgs.msg import String

# simulation_interfaces/msg/Result and SimulationState.
OK, INCORRECT_STATE, OPERATION_FAILED, UNSUPPORTED = 1, 3, 4, 0
PLAYING, PAUSED = 1, 2
PATIENCE_S = 30.0


class Services(Node):
    """Offers services, and hands what they ask to qrsim."""

    def __init__(self):
        super().__init__("qrsim_services")
        group = ReentrantCallbackGroup()
        self._status, self._news = {}, threading.Condition()
        self._control = self.create_publisher(String, "/qrsim/control", 10)
        self.create_subscription(String, "/qrsim/status", self._hear, 10, callback_group=group)
        for kind, name, answer in (
            (GetSimulationState, "get_simulation_state", self._state),
            (SetSimulationState, "set_simulation_state", self._set_state),
            (StepSimulation, "step_simulation", self._step),
            (ResetSimulation, "reset_simulation", self._reset),
        ):
            self.create_service(kind, name, answer, callback_group=group)

    def _hear(self, message):
        with self._news:
            self._status = json.loads(message.data)
            self._news.notify_all()

    def _do(self, text, done, result):
        """Ask qrsim for something, and wait until its status says that it is done."""
        self._control.publish(String(data=text))
        with self._news:
            if self._news.wait_for(lambda: bool(self._status) and done(self._status), PATIENCE_S):
                result.result = OK
            else:
                result.result = OPERATION_FAILED
                result.error_message = f"no answer to '{text}' in {PATIENCE_S:g} s: is 'qrsim ros2' running?"

    def _state(self, request, response):
        with self._news:
            known = self._news.wait_for(lambda: bool(self._status), PATIENCE_S)
            response.state.state = PAUSED if self._status.get("paused") else PLAYING
        response.result.result = OK if known else OPERATION_FAILED
        return response

    def _set_state(self, request, response):
        if request.state.state == PLAYING:
            self._do("resume", lambda status: not status["paused"], response.result)
        elif request.state.state == PAUSED:
            self._do("pause", lambda status: status["paused"], response.result)
        else:
            response.result.result = UNSUPPORTED
            response.result.error_message = "qrsim plays and pauses; Ctrl-C ends it"
        return response

    def _step(self, request, response):
        if not self._status.get("paused"):
            response.result.result = INCORRECT_STATE
            response.result.error_message = "pause first"
            return response
        goal = self._status["tick"] + request.steps
        self._do(f"step {request.steps}", lambda status: status["tick"] >= goal, response.result)
        return response

    def _reset(self, request, response):
        before = self._status.get("tick", 0)
        self._do("reset", lambda status: status["tick"] < max(1, before), response.result)
        return response


def main():
    """Serve."""
    rclpy.init()
    executor = MultiThreadedExecutor()
    executor.add_node(Services())
    executor.spin()
