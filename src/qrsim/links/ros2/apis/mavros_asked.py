"""What mavros takes for one vehicle: set-points of its topics, and services, as it hands them to the autopilot.

Source: mavros, src/plugins of its branch ros2: command, setpoint_position, _velocity, _raw, _attitude and _accel,
sys_status, home_position.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from qrsim.links.mavlink.stack.codes import UNSET_INT, Result
from qrsim.links.mavlink.stack.contracts import (
    AttitudeTarget,
    Command,
    GlobalTarget,
    LocalTarget,
    Quadruple,
    Stack,
    Triple,
)
from qrsim.links.mavlink.stack.offboard import NO_ATTITUDE, NO_RATES
from qrsim.links.mavlink.system import System
from qrsim.links.ros2 import Message
from qrsim.links.ros2.apis import forms as f
from qrsim.links.ros2.apis.contracts import Answered, Heard
from qrsim.links.ros2.apis.modes import number_of
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types

# MAV_FRAME.
_LOCAL, _BODY, _BODY_OFFSET, _GLOBAL = 1, 8, 9, 5
# POSITION_TARGET_TYPEMASK: what is left out.
_POSITION, _VELOCITY, _ACCELERATION, _YAW, _YAW_RATE = 7, 7 << 3, 7 << 6, 1 << 10, 1 << 11
_ZERO: Triple = (0.0, 0.0, 0.0)
# MAV_CMD.
_TAKE_OFF, _LAND, _SET_HOME, _ARM, _GET_HOME = 22, 21, 179, 400, 410
_CUSTOM = 1


def _vector(message: Message) -> Triple:
    """Return the fields x, y, z of a ROS message as a tuple."""
    return message.x, message.y, message.z


def _attitude(turn: Message) -> Quadruple:
    """Convert a ROS orientation, FLU to ENU, to a quaternion (w, x, y, z), FRD to NED; all zeros mean identity, as in
    mavros."""
    numbers = turn.x, turn.y, turn.z, turn.w
    return f.ned_attitude(*numbers) if any(numbers) else f.ned_attitude(0.0, 0.0, 0.0, 1.0)


class Asked:
    """The set-points and services of one vehicle.

    Args:
        types: of the distribution, with ``mavros.PACKAGES``.
        system: the vehicle.
        space: what is before the names of topics and services, such as "/uav1/mavros/".
    """

    def __init__(self, types: Types, system: System, space: str):
        self._types, self._system, self._space = types, system, space
        # The last that setpoint_attitude heard, other than a thrust: an attitude (w, x, y, z), or rates.
        self._attitude: AttitudeTarget | None = None

    @property
    def _stack(self) -> Stack:
        """Return the flight stack of the vehicle."""
        return self._system.stack

    # ---- set-points ----

    def heard(self) -> Iterator[Heard]:
        """Yield mavros's set-point topics that the vehicle subscribes to, each with its handler."""
        pose, twist = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
        for name, kind, take in (
            ("setpoint_position/local", pose, self._set_position),
            ("setpoint_position/global", "geographic_msgs/msg/GeoPoseStamped", self._set_geodetic),
            ("setpoint_velocity/cmd_vel", twist, lambda message: self._set_velocity(message.twist)),
            ("setpoint_velocity/cmd_vel_unstamped", "geometry_msgs/msg/Twist", self._set_velocity),
            ("setpoint_accel/accel", "geometry_msgs/msg/Vector3Stamped", self._set_acceleration),
            ("setpoint_attitude/attitude", pose, self._store_attitude),
            ("setpoint_attitude/cmd_vel", twist, self._store_rates),
            ("setpoint_attitude/thrust", "mavros_msgs/msg/Thrust", self._set_thrust),
            ("setpoint_raw/local", "mavros_msgs/msg/PositionTarget", self._set_raw_local),
            ("setpoint_raw/global", "mavros_msgs/msg/GlobalPositionTarget", self._set_raw_global),
            ("setpoint_raw/attitude", "mavros_msgs/msg/AttitudeTarget", self._set_raw_attitude),
        ):
            yield Heard(Topic(self._space + name, kind, "command"), take)

    def _set_position(self, message: Message) -> None:
        """Send the flight stack a local position and heading from a message on setpoint_position/local."""
        pose = message.pose
        yaw = f.heading(_attitude(pose.orientation))
        mask = _VELOCITY | _ACCELERATION | _YAW_RATE
        self._stack.setpoint(LocalTarget(_LOCAL, mask, position=f.enu(_vector(pose.position)), yaw=yaw))

    def _set_geodetic(self, message: Message) -> None:
        """Send the flight stack a geodetic position and heading from a message on setpoint_position/global."""
        yaw = f.heading(_attitude(message.pose.orientation))
        self._send_global(_VELOCITY | _ACCELERATION | _YAW_RATE, _GLOBAL, message.pose.position, yaw=yaw)

    def _send_global(self, mask: int, frame: int, place: Any, **others: Any) -> None:
        """Send the flight stack a geodetic set-point, invalid coordinates as UNSET_INT; ``mask``, ``frame``: of
        SET_POSITION_TARGET_GLOBAL_INT."""
        north, east = place.latitude, place.longitude
        known = math.isfinite(north) and math.isfinite(east) and abs(north) <= 90.0 and abs(east) <= 180.0
        whole = (int(north * 1e7), int(east * 1e7)) if known else (UNSET_INT, UNSET_INT)
        self._stack.setpoint(GlobalTarget(frame, mask, *whole, place.altitude, **others))

    def _set_velocity(self, twist: Message) -> None:
        """Send the flight stack a velocity and yaw rate from a Twist message in ENU axes."""
        mask = _POSITION | _ACCELERATION | _YAW
        velocity = f.enu(_vector(twist.linear))
        self._stack.setpoint(LocalTarget(_LOCAL, mask, velocity=velocity, yaw_rate=-twist.angular.z))

    def _set_acceleration(self, message: Message) -> None:
        """Send the flight stack an acceleration from a Vector3Stamped message in ENU axes."""
        mask = _POSITION | _VELOCITY | _YAW | _YAW_RATE
        self._stack.setpoint(LocalTarget(_LOCAL, mask, acceleration=f.enu(_vector(message.vector))))

    def _store_attitude(self, message: Message) -> None:
        """Store an attitude message until the thrust message that belongs to it arrives."""
        self._attitude = AttitudeTarget(NO_RATES, _attitude(message.pose.orientation), _ZERO, 0.0)

    def _store_rates(self, message: Message) -> None:
        """Store a message of body rates until the thrust message that belongs to it arrives."""
        # With the axes that mavros has here: those of ENU, for rates of the body.
        rates = f.enu(_vector(message.twist.angular))
        self._attitude = AttitudeTarget(NO_ATTITUDE, (1.0, 0.0, 0.0, 0.0), rates, 0.0)

    def _set_thrust(self, message: Message) -> None:
        """Send the flight stack the stored attitude or body rates with the thrust of this message."""
        asked = self._attitude
        if asked is not None:
            self._attitude = None
            self._stack.setpoint(AttitudeTarget(asked.mask, asked.q, asked.rates, message.thrust))

    def _set_raw_local(self, message: Message) -> None:
        """Send the flight stack the set-point of a PositionTarget message, converted from ENU or FLU to NED or FRD."""
        of_body = message.coordinate_frame in (_BODY, _BODY_OFFSET)
        turned = f.flu if of_body else f.enu
        yaw = -message.yaw if of_body else 0.5 * math.pi - message.yaw
        parts = (message.position, message.velocity, message.acceleration_or_force)
        position, velocity, acceleration = (turned(_vector(part)) for part in parts)
        frame, mask, rate = message.coordinate_frame, message.type_mask, -message.yaw_rate
        self._stack.setpoint(LocalTarget(frame, mask, position, velocity, acceleration, yaw, rate))

    def _set_raw_global(self, message: Message) -> None:
        """Send the flight stack the set-point of a GlobalPositionTarget message, converted from ENU to NED."""
        self._send_global(
            message.type_mask,
            message.coordinate_frame,
            message,
            velocity=f.enu(_vector(message.velocity)),
            acceleration=f.enu(_vector(message.acceleration_or_force)),
            yaw=0.5 * math.pi - message.yaw,
            yaw_rate=-message.yaw_rate,
        )

    def _set_raw_attitude(self, message: Message) -> None:
        """Send the flight stack the set-point of an AttitudeTarget message, converted to FRD and NED."""
        thrust = min(max(message.thrust, 0.0), 1.0)
        q, rates = _attitude(message.orientation), f.flu(_vector(message.body_rate))
        self._stack.setpoint(AttitudeTarget(message.type_mask, q, rates, thrust))

    # ---- services ----

    def answered(self) -> Iterator[Answered]:
        """Yield mavros's services of the vehicle (arming, take-off, mode and others), each with its handler."""
        for name, kind, answer in (
            ("cmd/arming", "CommandBool", lambda r: self._command_response("CommandBool", _ARM, float(r.value))),
            ("cmd/command", "CommandLong", self._command_long),
            ("cmd/command_int", "CommandInt", self._command_int),
            ("cmd/takeoff", "CommandTOL", lambda r: self._take_off_or_land(_TAKE_OFF, r.min_pitch, r)),
            ("cmd/land", "CommandTOL", lambda r: self._take_off_or_land(_LAND, 0.0, r)),
            ("cmd/set_home", "CommandHome", self._set_home),
            ("set_mode", "SetMode", self._set_mode),
            ("set_stream_rate", "StreamRate", lambda r: self._response("StreamRate", 0)),
            ("set_message_interval", "MessageInterval", lambda r: self._response("MessageInterval", False)),
        ):
            yield Answered(self._space + name, f"mavros_msgs/srv/{kind}", answer)
        yield Answered(self._space + "home_position/req_update", "std_srvs/srv/Trigger", self._send_home)

    def _response(self, kind: str, *values: object) -> object:
        """Return the response message of a mavros service (``kind``) from its field values."""
        return self._types[f"mavros_msgs/srv/{kind}_Response"](*values)

    def _command_response(self, kind: str, command: int, *params: float) -> object:
        """Execute a MAVLink command with up to seven parameters; return the service's response (``kind``) with the
        result."""
        whole = (*params, *[0.0] * (7 - len(params)))
        result = self._stack.command(Command(command, whole)).result  # type: ignore[arg-type]
        return self._response(kind, result is Result.ACCEPTED, int(result))

    def _command_long(self, r: Message) -> object:
        """Execute the command of a CommandLong request, and return the response."""
        params = (r.param1, r.param2, r.param3, r.param4, r.param5, r.param6, r.param7)
        return self._command_response("CommandLong", r.command, *params)

    def _command_int(self, r: Message) -> object:
        """Execute the command of a CommandInt request, and return a response of success, as mavros does whatever the
        result."""
        self._stack.command(Command.of_int(r.command, r.frame, (r.param1, r.param2, r.param3, r.param4), r.x, r.y, r.z))
        # mavros does not wait for the result.
        return self._response("CommandInt", True)

    def _take_off_or_land(self, command: int, first: float, r: Message) -> object:
        """Execute a take-off or landing ``command`` with the first parameter ``first``, and return the response."""
        return self._command_response(
            "CommandTOL", command, first, 0.0, 0.0, r.yaw, r.latitude, r.longitude, r.altitude
        )

    def _set_home(self, r: Message) -> object:
        """Set the home position from a CommandHome request, and return the response."""
        params = (float(r.current_gps), 0.0, 0.0, r.yaw, r.latitude, r.longitude, r.altitude)
        return self._command_response("CommandHome", _SET_HOME, *params)

    def _set_mode(self, r: Message) -> object:
        """Request a flight mode, by mavros's name or by number, and return the response: whether the mode is known."""
        base, custom = r.base_mode, 0
        if r.custom_mode:
            number = number_of(r.custom_mode)
            if number is None:
                return self._response("SetMode", False)
            base, custom = base | _CUSTOM, number
        # As mavros: known and sent, whatever becomes of it.
        self._stack.set_mode(base, custom)
        return self._response("SetMode", True)

    def _send_home(self, r: object) -> object:
        """Have the flight stack send its home position, and return the response: whether it could."""
        result = self._stack.command(Command(_GET_HOME, (0.0,) * 7)).result
        return self._types["std_srvs/srv/Trigger_Response"](result is Result.ACCEPTED, "")
