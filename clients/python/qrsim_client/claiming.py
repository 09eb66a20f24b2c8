# Written by generate.py from src/qrsim/links/reference/claiming.py: change that.
"""Calls of a client: for a world that it shares with others, the radio, and faults; for Python 3.8 and later, as
``client``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from qrsim_client.errors import UsageError
from qrsim_client import qrsim_pb2 as pb
from qrsim_client.qrsim_pb2 import Message, Step
from qrsim_client.replies import Claim, Heard, Sensed, SensedVehicle, Status, VehicleStatus, heard_of

# What a vehicle may be ordered to do, with the numbers of it.
KINDS = {
    "waypoint": Step.WP,  # x, y, z NED [m], yaw [rad]
    "velocity": Step.VEL_YAW,  # north, east, down [m/s], yaw
    "velocity_height": Step.VEL_HEIGHT,  # north, east [m/s], z down [m], yaw
    "attitude_height": Step.ATT_HEIGHT,  # roll, pitch [rad], z, yaw
    "attitude": Step.ATT,  # roll, pitch, yaw [rad], throttle 0 to 1
    "path": Step.PATH,  # x, y, z, velocity and acceleration NED, yaw
    "track": Step.TRACK,  # x, y, z of a line's begin, of its end or a circle's centre; radius, speed, stops
    "control": Step.CTRL,  # the vehicle's own command
}
MOST_PUSHED = 1000


class SharedCalls(ABC):
    """The calls of ``Client`` to a world that several clients share (``qrsim serve SCENARIO --pace barrier|free``)."""

    def __init__(self) -> None:
        self._pushed: deque[pb.Readings] = deque(maxlen=MOST_PUSHED)

    def claim(self, *vehicles: str, on_silence: str | None = None, hold: float | None = None) -> Claim:
        """Claim vehicles, so that only this client commands them: all of the named ones or none; without names, all
        free ones.

        Args:
            vehicles: names.
            on_silence: what they do without this client: "hold" their place, "return" to above their start, or "stop"
                their motors; default: the server's.
            hold: after how many seconds without a command, 0: never; default: the server's. At once where the
                connection is lost.
        """
        request = pb.Claim(vehicle=vehicles, on_silence=on_silence, hold=hold)
        found = self._call(Message(type=Message.CLAIM, claim=request), Message.CLAIMED).claimed
        return Claim(
            found.client,
            tuple(found.vehicle),
            found.scenario,
            found.seed,
            found.pace,
            found.factor,
            found.time_step,
            found.tick,
            found.on_silence,
            found.hold,
        )

    def release(self, *vehicles: str) -> None:
        """Give claimed vehicles back to their scenario's guidance; without names, all of them."""
        self._call(Message(type=Message.RELEASE, release=pb.Release(vehicle=vehicles)), Message.ACK)

    def command(self, orders: Mapping[str, object], *, computed_from: int | None = None) -> int:
        """Send orders, each flown until the vehicle's next one; return the tick at which they take effect (servers with
        pace "free").

        Args:
            orders: vehicle -> (kind, numbers), as ``{"a": ("waypoint", [8.0, -6.0, -10.0, 0.0])}``; see ``KINDS``.
            computed_from: tick of the readings that they were computed from.
        """
        request = pb.Command(order=_order_messages(orders), computed_from=computed_from)
        return int(self._call(Message(type=Message.COMMAND, command=request), Message.COMMANDED).commanded.tick)

    def advance(
        self,
        orders: Mapping[str, Any] | None = None,
        *,
        ticks: int | None = None,
        until_tick: int | None = None,
        computed_from: int | None = None,
        truth: bool = False,
    ) -> Sensed:
        """Send orders, wait until all clients agree to advance to a tick, and return the readings there (servers with
        pace "barrier").

        Args:
            orders: as in ``command``; those left out fly on by their last order.
            ticks: for so many ticks; or
            until_tick: until this one; neither: until the next one.
            computed_from: tick of the readings that the orders were computed from.
            truth: return true states too.
        """
        if ticks is not None and until_tick is not None:
            raise UsageError("advance: give ticks or until_tick, not both")
        request = pb.Command(
            order=_order_messages(orders or {}),
            computed_from=computed_from,
            until_tick=until_tick,
            truth=truth,
            ticks=ticks,
        )
        return sensed_of(self._call(Message(type=Message.COMMAND, command=request), Message.READINGS).readings)

    def subscribe(self, *vehicles: str, rate: float | None = None, truth: bool = False, stop: bool = False) -> None:
        """Start or stop (``stop``) the server's pushing of vehicles' sensor readings, which ``sensed`` returns.

        Args:
            vehicles: names; none: those that one has claimed, at any time.
            rate: per simulated second; default: at every tick.
            truth: with true states.
            stop: no more.
        """
        request = pb.Subscribe(vehicle=vehicles, rate=rate, truth=truth, stop=stop)
        self._call(Message(type=Message.SUBSCRIBE, subscribe=request), Message.ACK)
        if stop:
            self._pushed.clear()

    def sensed(self, timeout: float | None = None, *, newest: bool = True) -> Sensed:
        """Return the sensor readings that the server has pushed; waits up to ``timeout`` [s] if there are no new ones.

        Args:
            timeout: how long to wait [s]; default: for ever.
            newest: of several, the last one, the others being dropped; else the first one.
        """
        self._decode_pushed()
        if not self._pushed:
            self._pushed.append(self._checked_reply(self._receive(timeout), Message.SENSED).sensed)
        found = self._pushed.pop() if newest else self._pushed.popleft()
        if newest:
            self._pushed.clear()
        return sensed_of(found)

    def say(self, words: Mapping[str, object], *, to: str | None = None) -> None:
        """Send messages, vehicle -> numbers, by the vehicles' radios, all or none; ``to``: the only receiver (default:
        all).

        In a shared world of claimed vehicles only, and of several messages of one in a tick the last one counts.

        Args:
            words: vehicle -> numbers, at most as many as a message has (``describe()["radio"]["size"]``).
            to: name of the vehicle that alone is to hear them; default: all.
        """
        request = pb.Say(
            words=[pb.Say.Words(vehicle=name, value=numbers_of(name, said), to=to) for name, said in words.items()]
        )
        self._call(Message(type=Message.SAY, say=request), Message.ACK)

    def inbox(self) -> dict[str, tuple[Heard, ...]]:
        """Return, for each vehicle, the newest radio message received from each sender, the newest first."""
        found = self._call(Message(type=Message.GET_READINGS, get_readings=pb.GetReadings()), Message.READINGS).readings
        return {vehicle.name: heard_of(vehicle.heard) for vehicle in found.vehicle}

    def inject(
        self,
        target: str,
        kind: str,
        vehicles: object = None,
        at: float | None = None,
        duration: float | None = None,
        **numbers: Any,
    ) -> str:
        """Inject a fault of a part (``target``), or a change of weather, now or ``at`` a time [s]; return the server's
        note on it.

        Args:
            target: name of a sensor, ``rotor N``, ``battery``, ``radio`` or ``body`` that is injectable; ``link``; or
                ``world``.
            kind: of a sensor ``off``, ``stuck``, ``wrong``, ``drift``, ``noisy``, ``garbage``, ``slow``, ``delayed`` or
                ``intermittent``; of a rotor ``off``, ``weak`` or ``stuck``; of a battery ``drop`` or ``weak``;
                of a radio ``off`` or ``weak``; of a link ``off``; of a body ``push``; of the world ``wind``, ``gusts``
                or ``jam``.
            vehicles: name or names; None: all that have the target, in a shared world those that one has claimed.
            at: simulated time [s]; None: from the next tick on.
            duration: how long [s]; None: for good.
            numbers: how large it is, as in ``Simulation.inject``.
        """
        request = pb.Inject(target=target, kind=kind, vehicle=_vehicle_list(vehicles), at=at, duration=duration)
        for name, value in numbers.items():
            if name == "field":
                request.field = str(value)
                continue
            try:
                # A vector, such as the acceleration of a push, is sent axis by axis.
                axes = (
                    zip((f"{name}.{axis}" for axis in "xyz"), value, strict=True) if np.ndim(value) else [(name, value)]
                )
                for part, number in axes:
                    request.number.add(name=part, value=float(number))
            except (TypeError, ValueError, OverflowError):
                raise UsageError(f"{name}: {value!r:.100}; expected a number, or 3 of a vector") from None
        return str(self._call(Message(type=Message.INJECT, inject=request), Message.ACK).ack.msg)

    def clear(self, target: str | None = None, vehicles: object = None) -> str:
        """End the injected faults of a target (None: of all targets) of vehicles; return the server's note on it.

        Args:
            target: as in ``inject``.
            vehicles: name or names; None: all, in a shared world those that one has claimed.
        """
        request = pb.ClearFaults(target=target, vehicle=_vehicle_list(vehicles))
        return str(self._call(Message(type=Message.CLEAR, clear=request), Message.ACK).ack.msg)

    def set_wind(self, speed: float, from_deg: float) -> str:
        """Change the mean wind: speed [m/s] at 20 ft and bearing it comes from [deg]; return the server's note on it.

        In a shared world the server has to allow it (``--allow-inject``).
        """
        return self.inject("world", "wind", speed_20ft=speed, wind_from_deg=from_deg)

    def status(self) -> Status:
        """Return each vehicle's controlling client and the age of its last order, and the statistics of the pace."""
        found = self._call(Message(type=Message.GET_STATUS, get_status=pb.GetStatus()), Message.STATUS).status
        vehicles = {
            each.name: VehicleStatus(
                each.client,
                each.flies,
                _optional_field(each, "source_tick"),
                _optional_field(each, "arrival_tick"),
                _optional_field(each, "age"),
                each.misses,
                _optional_field(each, "silent_since"),
            )
            for each in found.vehicle
        }
        pacing = {field.name: value for field, value in found.pacing.ListFields()}
        return Status(found.pace, found.tick, found.t, pacing, vehicles)

    def describe(self) -> dict[str, Any]:
        """Return a description of the world as a dict: area, obstacles, ground, wind, and fleets with sensors and
        commands."""
        found = self._call(Message(type=Message.DESCRIBE, describe=pb.Describe()), Message.WORLD).world
        parts = {name: _part(getattr(found, name)) for name in ("area", "ground", "wind", "turbulence", "gust")}
        parts.update({"radio": _part(found.radio)} if found.HasField("radio") else {})
        return {
            "scenario": found.scenario,
            "time_step": found.time_step,
            "collision_distance": found.collision_distance,
            "origin": list(found.origin),
            **parts,
            "obstacles": [_part(each) for each in found.obstacle],
            "fleets": {fleet.name: _fleet_description(fleet) for fleet in found.fleet},
        }

    # ---- of the client ----

    @abstractmethod
    def _call(self, request: Message, expected: Message.Type) -> Message:
        """Send a request and return the server's reply of the expected type; raises Refused if the server declines."""

    @abstractmethod
    def _receive(self, timeout: float | None) -> Message:
        """Return the server's next message, waiting at most ``timeout`` [s] (None: for ever)."""

    @abstractmethod
    def _checked_reply(self, reply: Message, expected: Message.Type) -> Message:
        """Return ``reply`` if it has the expected type; raises Refused if the server declined, else
        ConnectionFailed."""

    @abstractmethod
    def _decode_pushed(self) -> None:
        """Queue the pushed readings that have already arrived, without waiting."""


def sensed_of(found: pb.Readings) -> Sensed:
    """Convert a protobuf message of sensor readings to a ``Sensed`` record."""
    return Sensed(
        found.tick, found.t, found.sent, found.missed, {each.name: _sensed_vehicle(each) for each in found.vehicle}
    )


def _sensed_vehicle(found: pb.Readings.Vehicle) -> SensedVehicle:
    """Convert one vehicle's sensor readings from protobuf to a ``SensedVehicle`` record."""
    sensors = {
        sensor.name: {
            **{f.name: f.value[0] if len(f.value) == 1 else np.array(f.value) for f in sensor.field},
            "time": sensor.time,
            "fresh": sensor.fresh,
            "reason": sensor.reason,
        }
        for sensor in found.sensor
    }
    state = np.array(found.X.value) if found.HasField("X") else None
    return SensedVehicle(found.valid, found.reason, sensors, state, heard_of(found.heard))


def _vehicle_list(vehicles: Any) -> list[str]:
    """Return vehicle names as a list: [] for None, one name for a string."""
    return [] if vehicles is None else [vehicles] if isinstance(vehicles, str) else list(vehicles)


def _optional_field(found: Any, name: str) -> Any:
    """Return a field of a protobuf message, None where it is not set."""
    return getattr(found, name) if found.HasField(name) else None


def numbers_of(vehicle: str, said: object) -> list[float]:
    """Convert a radio message's payload to a list of floats; raises UsageError, naming the vehicle, unless it is
    one-dimensional."""
    try:
        values = np.asarray(said, np.float64)
    except (TypeError, ValueError):
        values = np.zeros((0, 0))
    if values.ndim != 1:
        raise UsageError(f"message of '{vehicle}': expected numbers, found {said!r:.100}")
    found: list[float] = values.tolist()
    return found


def _order_messages(orders: Mapping[str, Any]) -> list[pb.Order]:
    """Convert {vehicle: (kind, numbers)} to protobuf orders; raises UsageError for anything else."""
    messages = []
    for vehicle, order in orders.items():
        try:
            kind, numbers = order
            values = np.asarray(numbers, np.float64)
        except (TypeError, ValueError):
            values = np.zeros((0, 0))
        if values.ndim != 1:
            raise UsageError(f"order of '{vehicle}': expected (kind, numbers), found {order!r:.100}")
        messages.append(pb.Order(vehicle=vehicle, type=kind_of(kind), cmd=pb.Arrayd(value=values.tolist())))
    return messages


def kind_of(name: str) -> Step.Type:
    """Return the protocol's number for a kind of order, such as "waypoint"; raises UsageError for an unknown name."""
    if name not in KINDS:
        raise UsageError(f"no order is of kind {name!r:.60}; there are {', '.join(KINDS)}")
    return KINDS[name]


def _part(found: pb.World.Part) -> dict[str, Any]:
    """Convert the protobuf description of a component to a dict: "type", its parameters, and their "units"."""
    values: dict[str, Any] = {"type": found.type}
    for each in found.quantity:
        numbers = list(each.value)
        values[each.name] = each.text if each.HasField("text") else numbers[0] if len(numbers) == 1 else numbers
    values["units"] = {each.name: each.unit for each in found.quantity if each.unit}
    return values


def _fleet_description(found: pb.World.Fleet) -> dict[str, object]:
    """Convert the protobuf description of a fleet to a dict."""
    return {
        "vehicles": list(found.vehicle),
        "model": _part(found.model),
        "controller": found.controller,
        "guidance": found.guidance,
        "radius": found.radius,
        "limits": _part(found.limits),
        "sensors": {
            each.name: {"type": each.type, "period": each.period, "fields": list(each.field)} for each in found.sensor
        },
        "commands": {
            each.name: [
                {"name": field.name, "unit": field.unit, "low": field.low, "high": field.high} for field in each.field
            ]
            for each in found.command
        },
        "start": [list(row.value) for row in found.start],
    }
