"""What PX4 takes for one vehicle over its uXRCE-DDS bridge: offboard set-points and commands.

Source: PX4 1.15, Commander.cpp (commands), offboard control mode and the message definitions of px4_msgs, release/1.15.
A vehicle is in OFFBOARD as long as ``offboard_control_mode`` comes in; its flags say which numbers of the set-points
count.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Any

from qrsim.links.mavlink.stack.contracts import AttitudeTarget, Command, LocalTarget, Target, Triple
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.stack.offboard import NO_ATTITUDE, NO_RATES
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.view import View
from qrsim.links.ros2 import Message
from qrsim.links.ros2.apis.contracts import EACH, Answered, Heard, Told
from qrsim.links.ros2.apis.modes import NAV_STATES
from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types

# MAV_CMD: DO_SET_MODE; of PX4 alone: VEHICLE_CMD_SET_NAV_STATE.
_SET_MODE, _SET_NAV_STATE = 176, 100001
_UNKNOWN: Triple = (math.nan,) * 3
_LOCAL = 1
# Of acknowledgements that nobody could be sent, the last ones are kept.
_MOST = 64


class Asked:
    """The set-points and commands of one vehicle.

    Args:
        types: of the distribution, with ``px4.PACKAGES``.
        system: the vehicle.
        space: what is before the names of topics, such as "/px4_1/fmu/".
    """

    def __init__(self, types: Types, system: System, space: str):
        self._types, self._system, self._space = types, system, space
        self._acks: deque[bytes] = deque(maxlen=_MOST)
        self.restart()

    def restart(self) -> None:
        """Forget all set-points received, at the start of an episode."""
        self._mode: Message = None
        self._mode_at = -math.inf
        # By kind, the set-point that came last.
        self._motion: Message = None
        self._attitude: Message = None
        self._rates: Message = None
        self._here: Triple | None = None

    def heard(self) -> Iterator[Heard]:
        """Yield PX4's input topics that the vehicle subscribes to, each with its handler."""
        for name, kind, quality, take in (
            ("offboard_control_mode", "OffboardControlMode", "command", self._set_control_mode),
            ("trajectory_setpoint", "TrajectorySetpoint", "command", self._set_trajectory),
            ("vehicle_attitude_setpoint", "VehicleAttitudeSetpoint", "command", self._set_attitude),
            ("vehicle_rates_setpoint", "VehicleRatesSetpoint", "command", self._set_rates),
            ("vehicle_command", "VehicleCommand", "request", self._queue_acknowledgement),
        ):
            yield Heard(Topic(f"{self._space}in/{name}", f"px4_msgs/msg/{kind}", quality), take)  # type: ignore[arg-type]

    def told(self) -> Told:
        """Return the topic on which the vehicle publishes its VehicleCommandAck messages."""

        def make(view: View) -> bytes | None:
            """Return the oldest queued VehicleCommandAck as bytes, None if there is none."""
            return self._acks.popleft() if self._acks else None

        topic = Topic(f"{self._space}out/vehicle_command_ack", "px4_msgs/msg/VehicleCommandAck", "fmu")
        return Told(topic, EACH, make)

    # ---- set-points ----

    def _set_control_mode(self, message: object) -> None:
        """Store an OffboardControlMode message and its time; send the flight stack the set-point that it selects."""
        self._mode, self._mode_at = message, self._system.view.seen.time
        self._send_target()

    def _set_trajectory(self, message: object) -> None:
        """Store a TrajectorySetpoint message, and send it to the flight stack if offboard mode is alive."""
        self._motion = message
        self._send_if_alive()

    def _set_attitude(self, message: object) -> None:
        """Store a VehicleAttitudeSetpoint message, and send it to the flight stack if offboard mode is alive."""
        self._attitude = message
        self._send_if_alive()

    def _set_rates(self, message: object) -> None:
        """Store a VehicleRatesSetpoint message, and send it to the flight stack if offboard mode is alive."""
        self._rates = message
        self._send_if_alive()

    def _send_if_alive(self) -> None:
        """Send the newest set-point to the flight stack, if OffboardControlMode messages have not timed out."""
        stack = self._system.stack
        limit = stack.parameters["COM_OF_LOSS_T"] * max(1.0, stack.factor)
        if self._system.view.seen.time - self._mode_at < limit:
            self._send_target()
            if isinstance(stack, FlightStack):
                # Set-points alone do not keep a vehicle in OFFBOARD.
                stack.offboard.heard = self._mode_at

    def _send_target(self) -> None:
        """Send the flight stack the set-point that the present OffboardControlMode selects."""
        target = self._target()
        if target is not None:
            self._system.stack.setpoint(target)

    def _target(self) -> Target | None:
        """Return the set-point that the OffboardControlMode selects; the present position before the first message."""
        mode = self._mode
        if mode.position or mode.velocity or mode.acceleration:
            return self._motion_target(mode)
        if mode.attitude and self._attitude is not None:
            thrust = -float(self._attitude.thrust_body[2])
            w, x, y, z = map(float, self._attitude.q_d)
            return AttitudeTarget(NO_RATES, (w, x, y, z), (0.0, 0.0, 0.0), thrust)
        if mode.body_rate and self._rates is not None:
            rates, thrust = self._rates, -float(self._rates.thrust_body[2])
            turn = (float(rates.roll), float(rates.pitch), float(rates.yaw))
            return AttitudeTarget(NO_ATTITUDE, (1.0, 0.0, 0.0, 0.0), turn, thrust)
        return self._hold_target() if mode.attitude or mode.body_rate else None

    def _hold_target(self) -> Target:
        """Return a set-point that holds the position at which the vehicle was when this was first called."""
        if self._here is None:
            view = self._system.view
            self._here = view.local(view.seen.position_ned)
        return LocalTarget(_LOCAL, 0, position=self._here)

    def _motion_target(self, mode: Message) -> Target:
        """Return the last TrajectorySetpoint with only the parts (position, velocity, acceleration) that ``mode``
        uses."""
        if self._motion is None:
            return self._hold_target()
        motion = self._motion

        def part(name: str, counts: bool) -> Triple:
            """Return a vector of the TrajectorySetpoint, or NaNs if the mode does not use it (``counts`` False)."""
            x, y, z = (float(number) for number in getattr(motion, name))
            return (x, y, z) if counts else _UNKNOWN

        return LocalTarget(
            _LOCAL,
            0,
            part("position", mode.position),
            part("velocity", mode.position or mode.velocity),
            part("acceleration", True),
            float(motion.yaw),
            float(motion.yawspeed),
        )

    # ---- commands ----

    def answered(self) -> Answered:
        """Return PX4's service vehicle_command, with its handler."""
        response = self._types["px4_msgs/srv/VehicleCommand_Response"]

        def answer(request: Message) -> Message:
            """Execute the command in a service request, and return the response with its acknowledgement."""
            return response(self._acknowledged(request.request))

        return Answered(f"{self._space}vehicle_command", "px4_msgs/srv/VehicleCommand", answer)

    def _queue_acknowledgement(self, message: Message) -> None:
        """Execute a VehicleCommand that is addressed to this vehicle, and queue its acknowledgement."""
        if message.target_system in (0, self._system.number) and message.target_component in (0, 1):
            self._acks.append(self._types.encode(self._acknowledged(message)))

    def _acknowledged(self, message: Message) -> object:
        """Execute or refuse a VehicleCommand, and return the VehicleCommandAck message."""
        command = int(message.command)
        params: Any = tuple(float(getattr(message, f"param{i}")) for i in range(1, 8))
        if command == _SET_NAV_STATE:
            state = int(params[0]) if math.isfinite(params[0]) else -1
            main, sub = NAV_STATES.get(state, (255, 0))
            params, command = (1.0, float(main), float(sub), *params[3:]), _SET_MODE
        ack = self._system.stack.command(Command(command, params))
        answer = empty(self._types, "px4_msgs/msg/VehicleCommandAck")
        answer.timestamp, answer.command = self._system.view.boot_us, message.command
        answer.result, answer.result_param1 = int(ack.result), ack.progress
        answer.target_system, answer.target_component = message.source_system, message.source_component
        answer.from_external = True
        return answer
