"""What each request does: one function for each type, which sends its one reply."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from qrsim.apps.serve.pacing import Pacer, checked_factor
from qrsim.apps.serve.session import Session, Wishes
from qrsim.apps.serve.tasks import uploaded
from qrsim.errors import UsageError
from qrsim.protocol import qrsim_pb2 as pb
from qrsim.protocol.framing import LARGEST_REQUEST
from qrsim.protocol.qrsim_pb2 import Message

if TYPE_CHECKING:
    from qrsim.apps.serve.connection import Connection

CAPABILITIES = ("seed", "scenario", "realtime", "readings", "reasons", "watch", "events")
# What clients of the reference implementation look for.
INVALID = "invalid uav state"


async def init(connection: Connection, message: Message) -> bool:
    """Start a task."""
    server, request = connection.server, message.init
    realtime = server.options.realtime or float(request.realTime)
    wishes = await server.aside(lambda: _wishes(connection, request.task, realtime=realtime))
    session = await server.open(connection, wishes)
    state = session.readout.frame()
    connection.send_frame(state)
    connection.send(Message(type=Message.TASKINFO, taskInfo=_info(session)))
    server.broadcast(session, state)
    return True


def _wishes(connection: Connection, task: str, *, scenario: str | None = None, **others: Any) -> Wishes:
    server = connection.server
    # What is not UTF-8 comes as bytes.
    if not isinstance(task, str) or not isinstance(scenario, str | None):
        raise UsageError("message: a text is not UTF-8")
    found = server.tasks.scenario(task) if scenario is None else uploaded(scenario)
    return Wishes(found, **{"seed": server.options.seed, "record": server.options.record, **others})


def _info(session: Session) -> pb.TaskInfo:
    return pb.TaskInfo(timestep=session.time_step, numUAVs=session.simulation.size)


async def reset(connection: Connection, message: Message) -> bool:
    """Start the task again."""
    session = connection.required_session()
    await connection.server.run(session, session.restart)
    connection.acknowledge()
    connection.server.broadcast(session, session.readout.frame())
    return True


async def disconnect(connection: Connection, message: Message) -> bool:
    """End the session, and the server where that is asked for and allowed."""
    await connection.server.close_session(connection)
    if not message.disconnect.quit:
        connection.acknowledge()
    elif connection.server.options.allow_quit:
        connection.acknowledge()
        connection.server.stop()
    else:
        connection.acknowledge(note="the server goes on: its operator has not allowed clients to end it (--allow-quit)")
    return False


async def set_state(connection: Connection, message: Message) -> bool:
    """Put the vehicles somewhere."""
    session = connection.required_session()
    await connection.server.run(session, lambda: session.set_state(message.setsState.X))
    connection.acknowledge()
    connection.server.broadcast(session, session.readout.frame())
    return True


async def step(connection: Connection, message: Message) -> bool:
    """Advance, in real time not before the wall clock has."""
    session, server = connection.required_session(), connection.server
    ticks = session.ticks(message.step.dt)
    await server.advance(connection, session, session.command(message.step), ticks)
    state = session.readout.frame()
    wait = session.pacer.wait_s(session.time)
    if wait > 0.0:
        await connection.pause(wait)
    if session.readout.all_valid():
        connection.send_frame(state)
    elif connection.reasons:
        connection.send(Message(type=Message.STATE, state=session.state_with_reasons()))
    else:
        connection.acknowledge(INVALID)
    server.broadcast(session, state)
    return True


# ---- extensions ----


async def hello(connection: Connection, message: Message) -> bool:
    """Say what the server is."""
    server = connection.server
    connection.reasons = message.hello.reasons
    found = pb.Server(
        version=version("qrsim"),
        capability=CAPABILITIES,
        task=server.tasks.names,
        session=sorted(server.sessions),
        largest_request=LARGEST_REQUEST,
    )
    connection.send(Message(type=Message.SERVER, server=found))
    return True


async def open_session(connection: Connection, message: Message) -> bool:
    """Start a session with a seed, a pace or a scenario of the client's own."""
    server, request = connection.server, message.open
    if request.HasField("task") and request.HasField("scenario"):
        raise UsageError("OPEN: give either a task or a scenario")
    scenario = request.scenario if request.HasField("scenario") else None
    factor = checked_factor(request.realtime if request.HasField("realtime") else server.options.realtime or 0.0)
    seed = request.seed if request.HasField("seed") else server.options.seed
    _check_seed(seed)
    wishes = await server.aside(
        lambda: _wishes(connection, request.task, scenario=scenario, seed=seed, realtime=factor, events=request.events)
    )
    session = await server.open(connection, wishes)
    _send_session(connection, session)
    return True


def _check_seed(seed: int) -> None:
    if seed >= 2**63:
        raise UsageError(f"seed: {seed} is not an integer from 0 to 2**63 - 1")


async def restart(connection: Connection, message: Message) -> bool:
    """Start the task again, with another seed if one is given."""
    session, request = connection.required_session(), message.restart
    seed = request.seed if request.HasField("seed") else None
    await connection.server.run(session, lambda: session.restart(seed))
    _send_session(connection, session)
    return True


def _send_session(connection: Connection, session: Session) -> None:
    simulation = session.simulation
    found = pb.Session(
        id=session.number,
        scenario=session.scenario.name,
        seed=simulation.seed,
        vehicle=simulation.vehicle_names,
        info=_info(session),
        state=session.state_with_reasons(),
    )
    connection.send(Message(type=Message.SESSION, session=found))
    connection.server.broadcast(session, session.readout.frame())


async def get_readings(connection: Connection, message: Message) -> bool:
    """Say what every sensor says, and why it does not."""
    session = connection.required_session()
    found = await connection.server.run(session, lambda: _readings(session))
    connection.send(Message(type=Message.READINGS, readings=found))
    return True


def _readings(session: Session) -> pb.Readings:
    simulation = session.simulation
    reading, found = simulation.reading, pb.Readings(t=session.time)
    for name, valid, reason in zip(simulation.vehicle_names, simulation.valid, simulation.reasons, strict=True):
        found.vehicle.add(name=name, valid=bool(valid), reason=reason)
    first = 0
    for fleet in simulation.world.fleets:
        for sensor_name in fleet.sensor_names:
            sensor = getattr(reading[fleet.name], sensor_name)
            arrays = {field: getattr(sensor, field).reshape(fleet.size, -1).tolist() for field in sensor.fields}
            for i, reason in enumerate(sensor.reasons):
                added = found.vehicle[first + i].sensor.add(name=sensor_name, reason=reason)
                for field, rows in arrays.items():
                    added.field.add(name=field, value=rows[i])
        first += fleet.size
    return found


async def watch(connection: Connection, message: Message) -> bool:
    """Send the states of a session from now on."""
    request = message.watch
    if connection.session is not None:
        raise UsageError("WATCH: this connection has a session of its own; watch from another connection")
    period = request.period if request.HasField("period") else 0.0
    if not 0.0 <= period < 1e9:
        raise UsageError(f"WATCH: period {period:g} s; allowed: from 0")
    number = request.session if request.HasField("session") else None
    connection.server.watch(connection, number, period, request.stop)
    connection.acknowledge()
    return True


async def get_events(connection: Connection, message: Message) -> bool:
    """Say what has happened since the last time."""
    found = connection.required_session().events()
    connection.send(Message(type=Message.EVENTS, events=found))
    return True


async def pace(connection: Connection, message: Message) -> bool:
    """Say how it went, and change the pace if asked to."""
    session = connection.required_session()
    report = session.pacer.report()
    if message.pace.HasField("factor"):
        session.pacer = Pacer(message.pace.factor, session.time)
    connection.send(Message(type=Message.PACING, pacing=report))
    return True


Handler = Callable[["Connection", Message], Awaitable[bool]]
# Each returns whether the connection goes on.
HANDLERS: dict[int, Handler] = {
    Message.INIT: init,
    Message.RESET: reset,
    Message.DISCONNECT: disconnect,
    Message.SETSTATE: set_state,
    Message.STEP: step,
    Message.HELLO: hello,
    Message.OPEN: open_session,
    Message.RESTART: restart,
    Message.GET_READINGS: get_readings,
    Message.WATCH: watch,
    Message.GET_EVENTS: get_events,
    Message.PACE: pace,
}
# The part of a message that a request of the reference protocol needs.
NEEDED = {Message.INIT: "init", Message.RESET: "reset", Message.DISCONNECT: "disconnect", Message.STEP: "step"}
