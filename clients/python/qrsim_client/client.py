# Written by generate.py from src/qrsim/links/reference/client.py: change that.
"""A client of ``qrsim serve``; it needs NumPy and protobuf only, not the simulator.

clients/python has this module as a package of its own, for Python 3.8 and later: nothing here may need a later one, and
``python clients/python/generate.py`` writes it anew.

The calls of the reference client have its semantics: ``init``, ``reset``, ``set_state``, ``step_waypoint``,
``step_control``, ``step_velocity``, ``disconnect``, ``quit``. The others are extensions of the protocol.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from google.protobuf.message import DecodeError

from qrsim_client import qrsim_pb2 as pb
from qrsim_client.claiming import SharedCalls, kind_of, numbers_of
from qrsim_client.errors import UsageError
from qrsim_client.framing import Deframer, frame
from qrsim_client.qrsim_pb2 import Message, Step
from qrsim_client.replies import (
    Axis,
    Claim,
    ConnectionFailed,
    Episode,
    Heard,
    InvalidState,
    Outcome,
    Refused,
    Sensed,
    SensedVehicle,
    Session,
    State,
    Status,
    VehicleStatus,
    arrays_of,
    axes_of,
    seen_of,
    state_of,
)

if TYPE_CHECKING:
    Array = np.ndarray[Any, Any]

__all__ = [
    "Axis", "Claim", "Client", "ConnectionFailed", "Episode", "Heard", "InvalidState", "Outcome", "Refused", "Sensed",
    "SensedVehicle", "Session", "State", "Status", "VehicleStatus",
]  # fmt: skip

LARGEST_REPLY = 1 << 26  # a state of 200 000 vehicles
INVALID = "invalid uav state"


class Client(SharedCalls):
    """A connection to a server; use it as a context manager.

    Args:
        host: name or address of the server.
        port: TCP port of the server.
        timeout: how long to wait for an answer [s]; the first step of each kind may have to be compiled.

    Attributes:
        time_step: simulation step of the session [s]; a step's dt is a multiple of it.
        size: number of vehicles of the session, n.

    Raises:
        ConnectionFailed: from every method, where the server cannot be reached or does not answer in time.
        Refused: from every method, where the server says no.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 10000, *, timeout: float = 60.0):
        super().__init__()
        self._where = f"{host}:{port}"
        self._timeout = timeout
        self._deframer = Deframer(LARGEST_REPLY)
        self.time_step, self.size = 0.0, 0
        try:
            self._socket: socket.socket | None = socket.create_connection((host, port), timeout)
        except (OSError, OverflowError) as error:
            reason = "nobody listens there" if isinstance(error, ConnectionRefusedError) else str(error)
            raise ConnectionFailed(f"cannot connect to {self._where}: {reason}") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    # ---- the reference client's calls ----

    def init(self, task: str, *, realtime: bool = False) -> State:
        """Start the task with this name, and return the state at its start; ``open`` has more options."""
        request = Message(type=Message.INIT, init=pb.Init(task=task, realTime=realtime))
        state = state_of(self._call(request, Message.STATE).state)
        self._set_info(self._checked_reply(self._receive(self._timeout), Message.TASKINFO).taskInfo)
        return state

    def reset(self) -> None:
        """Start the next episode of the task, without returning its state; ``restart`` does return it."""
        self._call(Message(type=Message.RESET, reset=pb.Reset(value=True)), Message.ACK)

    def set_state(self, state: object) -> None:
        """Set the states of all vehicles, each a row of 13, 12, 6 or 3 numbers as for ``Simulation.set_state``."""
        rows = pb.SetState(X=_vectors("state", state, (3, 6, 12, 13)))
        self._call(Message(type=Message.SETSTATE, setsState=rows), Message.ACK)

    def step_waypoint(self, dt: float, waypoints: object) -> State:
        """Fly to waypoints (n, 4), x, y, z NED [m] and yaw [rad], for ``dt`` [s] of simulated time; return the
        state."""
        return self._step(dt, Step.WP, waypoints, 4)

    def step_control(self, dt: float, commands: Any) -> State:
        """Fly control commands, one row for each vehicle, for ``dt`` [s] of simulated time; return the state.

        A quadrotor's row (5,) is pitch, roll [rad], throttle, yaw rate [rad/s], battery [V]; other vehicles have the
        fields of their own command, and one that takes none an empty row.
        """
        try:
            vectors = [pb.Arrayd(value=np.asarray(row, np.float64).tolist()) for row in commands]
        except (TypeError, ValueError):
            shape = f"(vehicles, 5), found {commands!r:.100}"
            raise UsageError(f"command: expected numbers of shape {shape}") from None
        return self._send_step(Step(dt=dt, type=Step.CTRL, cmd=vectors))

    def step_velocity(self, dt: float, velocities: object) -> State:
        """Fly at velocities NED (n, 3) [m/s], heading north, for ``dt`` [s] of simulated time; return the state."""
        return self._step(dt, Step.VEL, velocities, 3)

    def step_setpoint(self, dt: float, kind: str, setpoints: object) -> State:
        """Fly set-points of a kind in ``claiming.KINDS``, a row for each vehicle, for ``dt`` [s]; return the state."""
        return self._send_step(Step(dt=dt, type=kind_of(kind), cmd=_vectors("set-point", setpoints)))

    def disconnect(self) -> None:
        """End the session on the server, and close the connection."""
        self._send_disconnect(quit_server=False)

    def quit(self) -> str:
        """End the session and ask the server to stop; return "", or the reason why it keeps running."""
        return self._send_disconnect(quit_server=True)

    def _send_disconnect(self, quit_server: bool) -> str:
        """End the session, and the server if asked, and close the connection; return the server's note."""
        request = Message(type=Message.DISCONNECT, disconnect=pb.Disconnect(quit=quit_server))
        said = self._call(request, Message.ACK).ack.msg
        self.close()
        return said

    def _step(self, dt: float, kind: Step.Type, rows: object, width: int) -> State:
        """Fly rows of ``width`` numbers, one for each vehicle, for ``dt`` [s]; return the state."""
        return self._send_step(Step(dt=dt, type=kind, cmd=_vectors("command", rows, (width,))))

    def _send_step(self, step: Step) -> State:
        """Send a STEP message, and return the state that the server replies."""
        return state_of(self._call(Message(type=Message.STEP, step=step), Message.STATE).state)

    # ---- extensions ----

    def hello(self) -> dict[str, Any]:
        """Return the server's version, capabilities, tasks and sessions; from then on, states explain invalid
        vehicles."""
        found = self._call(Message(type=Message.HELLO, hello=pb.Hello()), Message.SERVER).server
        return {
            "version": found.version, "capabilities": list(found.capability), "tasks": list(found.task),
            "sessions": list(found.session), "largest_request": found.largest_request,
        }  # fmt: skip

    def open(
        self,
        task: str | None = None,
        *,
        scenario: str | None = None,
        seed: int | None = None,
        realtime: float | None = None,
        events: bool = False,
    ) -> Session:
        """Start a session of a task or of an uploaded scenario (YAML text), and return its description and first state.

        Args:
            task: name; or
            scenario: a scenario as YAML text, which names no files.
            seed: of the first episode, which the next seeds follow; default: the next one of the server.
            realtime: simulated seconds per second of the wall clock, 0 for lock-step; default: the server's.
            events: collect events.
        """
        request = pb.Open(task=task, scenario=scenario, seed=_checked_seed(seed), realtime=realtime, events=events)
        return self._open_session(Message(type=Message.OPEN, open=request))

    def restart(self, seed: int | None = None) -> Session:
        """Start the next episode of the task, or that of a given seed; return its description and first state."""
        return self._open_session(Message(type=Message.RESTART, restart=pb.Restart(seed=_checked_seed(seed))))

    def _open_session(self, request: Message) -> Session:
        """Send a request that starts a session or episode, and return its description and first state."""
        found = self._call(request, Message.SESSION).session
        self._set_info(found.info)
        return Session(
            found.id, found.scenario, found.seed, tuple(found.vehicle), found.info.timestep, state_of(found.state)
        )

    def readings(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Return {vehicle: {sensor: {field: number or array}}}; a field "reason" explains a missing reading."""
        found = self._call(Message(type=Message.GET_READINGS, get_readings=pb.GetReadings()), Message.READINGS).readings
        return {
            vehicle.name: {
                sensor.name: {
                    **{f.name: f.value[0] if len(f.value) == 1 else np.array(f.value) for f in sensor.field},
                    "reason": sensor.reason,
                }
                for sensor in vehicle.sensor
            }
            for vehicle in found.vehicle
        }

    def events(self) -> list[dict[str, Any]]:
        """Return the events (crashes, reached waypoints and so on) since the last call; needs ``open(events=True)``."""
        found = self._call(Message(type=Message.GET_EVENTS, get_events=pb.GetEvents()), Message.EVENTS).events
        return [
            {
                "time": event.t, "kind": event.kind, "vehicle": event.vehicle or None, "field": event.field or None,
                "value": event.value if event.HasField("value") else None, "message": event.message,
            }
            for event in found.event
        ]  # fmt: skip

    def pace(self, factor: float | None = None) -> dict[str, float]:
        """Return the pace statistics of the session; ``factor`` sets a new pace (0: lock-step)."""
        request = Message(type=Message.PACE, pace=pb.Pace(factor=factor))
        found = self._call(request, Message.PACING).pacing
        return {field.name: value for field, value in found.ListFields()}

    def play(self, task: str | None = None, *, scenario: str | None = None, seed: int | None = None) -> Episode:
        """Start an episode of a task to play by ``act``, or the next episode of the present one.

        Args:
            task: name; or
            scenario: a scenario as YAML text, which names no files; neither: the task that is played already.
            seed: of all randomness; default: the next one of the server, or of the series that the task has begun.
        """
        request = pb.Play(task=task, scenario=scenario, seed=_checked_seed(seed))
        found = self._call(Message(type=Message.PLAY, play=request), Message.EPISODE).episode
        return Episode(
            session=found.id, scenario=found.scenario, seed=found.seed, number=found.number, agents=tuple(found.agent),
            axes=axes_of(found.axis), period=found.period, steps=found.steps, answer_shape=tuple(found.answer_shape),
            observation=seen_of(found.observation), info=arrays_of(found.info), say_size=found.say_size,
        )  # fmt: skip

    def act(self, action: object, answer: object = None, say: Any = None) -> Outcome:
        """Advance the episode by one step with the agents' actions; return observation, reward, end flags and info.

        Args:
            action: (n, A) numbers in [-1, 1].
            answer: what the n agents hand in, (n, ...); with the last action of tasks that ask for it.
            say: what they say over the radio, (n, D), an empty row for who says nothing; default: nobody does.
        """
        words = [] if say is None else [pb.Arrayd(value=numbers_of(f"agent {i}", row)) for i, row in enumerate(say)]
        request = pb.Act(action=_vectors("action", action), answer=_answers(answer), say=words)
        found = self._call(Message(type=Message.ACT, act=request), Message.OUTCOME).outcome
        return Outcome(
            step=found.step, time=found.t, observation=seen_of(found.observation), reward=np.array(found.reward),
            terminated=found.terminated, truncated=found.truncated, info=arrays_of(found.info),
        )  # fmt: skip

    def watch(
        self, session: int | None = None, *, period: float = 0.0, timeout: float | None = None
    ) -> Iterator[State]:
        """Yield the states of a session (None: the only one) that another client controls, as they arrive.

        Args:
            session: its number; may be left out where the server has one session at a time.
            period: least simulated time between two states [s].
            timeout: how long to wait for a state [s]; default: for ever.
        """
        request = pb.Watch(session=session, period=period)
        self._call(Message(type=Message.WATCH, watch=request), Message.ACK)
        return self._watched(timeout)

    def _watched(self, timeout: float | None) -> Iterator[State]:
        """Yield the states that the server sends, waiting at most ``timeout`` [s] for each."""
        while True:
            yield state_of(self._checked_reply(self._receive(timeout), Message.STATE).state)

    # ---- the connection ----

    def close(self) -> None:
        """Close the connection, which ends the session on the server."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _set_info(self, info: pb.TaskInfo) -> None:
        """Store the session's time step and number of vehicles."""
        self.time_step, self.size = info.timestep, info.numUAVs

    def _call(self, request: Message, expected: Message.Type) -> Message:
        """Send a request and return the reply; if sending fails, raise the error that the server sent last."""
        try:
            self._open_socket().sendall(frame(request.SerializeToString()))
        except OSError as error:
            try:
                return self._checked_reply(self._receive(0.5), expected)
            except ConnectionFailed:
                raise self._close_with(f"the connection is lost: {error.strerror or error}") from None
        while (reply := self._receive(self._timeout)).type == Message.SENSED:
            self._pushed.append(reply.sensed)
        return self._checked_reply(reply, expected)

    def _checked_reply(self, reply: Message, expected: Message.Type) -> Message:
        """Return ``reply`` if it has the expected type; raises Refused, InvalidState or ConnectionFailed otherwise."""
        if reply.type == expected and not (expected == Message.ACK and reply.ack.error):
            return reply
        if reply.type == Message.ACK:
            raise (InvalidState if reply.ack.msg == INVALID else Refused)(f"{self._where}: {reply.ack.msg}")
        raise self._close_with(f"expected {Message.Type.Name(expected)}, found {Message.Type.Name(reply.type)}")

    def _receive(self, timeout: float | None) -> Message:
        """Return the server's next message, waiting at most ``timeout`` [s] (None: for ever)."""
        connection = self._open_socket()
        deadline = None if timeout is None else time.monotonic() + timeout
        try:
            while (payload := self._deframer.next()) is None:
                connection.settimeout(None if deadline is None else max(deadline - time.monotonic(), 1e-6))
                data = connection.recv(1 << 18)
                if not data:
                    raise self._close_with("the server has closed the connection")
                self._deframer.feed(data)
            return Message.FromString(payload)
        except (TimeoutError, socket.timeout):  # noqa: UP041 (two things before Python 3.10)
            raise self._close_with(f"no answer within {timeout:g} s") from None
        except OSError as error:
            raise self._close_with(f"the connection is lost: {error.strerror or error}") from None
        except (UsageError, DecodeError) as error:
            raise self._close_with(f"this is no qrsim server: {error}") from None

    def _decode_pushed(self) -> None:
        """Queue the messages that have arrived, without waiting; the next receiving call reports a closed
        connection."""
        connection = self._open_socket()
        connection.settimeout(0.0)
        try:
            while data := connection.recv(1 << 18):
                self._deframer.feed(data)
        except (BlockingIOError, InterruptedError):
            pass
        except OSError as error:
            raise self._close_with(f"the connection is lost: {error.strerror or error}") from None
        try:
            while (payload := self._deframer.next()) is not None:
                self._pushed.append(self._checked_reply(Message.FromString(payload), Message.SENSED).sensed)
        except (UsageError, DecodeError) as error:
            raise self._close_with(f"this is no qrsim server: {error}") from None

    def _open_socket(self) -> socket.socket:
        """Return the open socket; raises ConnectionFailed if this client is closed."""
        if self._socket is None:
            raise ConnectionFailed(f"{self._where}: this client is closed")
        return self._socket

    def _close_with(self, why: str) -> ConnectionFailed:
        """Close the connection and return the error to raise, with the reason ``why``."""
        self.close()
        return ConnectionFailed(f"{self._where}: {why}")


def _checked_seed(seed: int | None) -> int | None:
    """Return a valid seed, or None, unchanged; raises UsageError for others."""
    if seed is not None and not 0 <= seed < 2**63:
        raise UsageError(f"seed: {seed!r} is not an integer from 0 to 2**63 - 1")
    return seed


def _vectors(what: str, rows: object, widths: tuple[int, ...] = ()) -> list[pb.Arrayd]:
    """Convert rows to a protobuf vector for each vehicle; raises UsageError unless their width is in ``widths`` (empty:
    any)."""
    try:
        array = np.atleast_2d(np.asarray(rows, np.float64))
    except (TypeError, ValueError):
        array = np.zeros((0, 0, 0))
    if array.ndim != 2 or (widths and array.shape[1] not in widths):
        allowed = " or ".join(map(str, widths)) or "numbers of an action"
        raise UsageError(f"{what}: expected numbers of shape (vehicles, {allowed}), found {np.shape(array)}")
    return [pb.Arrayd(value=row) for row in array.tolist()]


def _answers(answer: object) -> list[pb.Act.Answer]:
    """Convert the agents' answers (n, ...) to protobuf messages; [] for None."""
    try:
        array = np.zeros((0, 1)) if answer is None else np.asarray(answer, np.float32)
    except (TypeError, ValueError):
        array = np.zeros(())
    if array.ndim < 2:
        raise UsageError(f"answer: expected numbers of shape (agents, ...), found shape {np.shape(array)}")
    return [pb.Act.Answer(value=row.ravel().tolist()) for row in array]
