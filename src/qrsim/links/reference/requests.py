"""Handlers of requests: one function per type, which sends exactly one reply."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable
from importlib.metadata import version
from typing import Any, cast

from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.links.pacing import checked_factor
from qrsim.links.reference import shared_requests as shared
from qrsim.links.reference.describing import axis_message, description
from qrsim.links.reference.episode_session import EpisodeSession
from qrsim.links.reference.injecting import clear, inject
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.framing import LARGEST_REQUEST
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.radio import hand_over, words_of
from qrsim.links.reference.roles import Client
from qrsim.links.reference.sensors import sensor_readings
from qrsim.links.reference.session import SHORT_S, Session, SessionOptions
from qrsim.links.reference.shared_session import SharedSession
from qrsim.links.reference.tasks import uploaded

CAPABILITIES = (
    "seed", "scenario", "realtime", "readings", "reasons", "watch", "events", "episodes", "setpoints", "describe",
    "claims", "inject", "radio",
)  # fmt: skip
# What clients of the reference implementation look for.
INVALID = "invalid uav state"
# Of one ACT, which cannot be cut into pieces where its client leaves.
MOST_TICKS_OF_ACT = 10_000


async def init(connection: Client, message: Message) -> None:
    """Start a task for the client, and send the first states and TASKINFO."""
    server, request = connection.server, message.init
    realtime = server.options.realtime or float(request.realTime)
    session_options = await server.run_in_thread(lambda: _session_options(connection, request.task, realtime=realtime))
    session = await server.open(connection, lambda number: Session(number, session_options, server.options.view))
    connection.send_frame(session.states.frame(connection.reasons))
    connection.send(Message(type=Message.TASKINFO, taskInfo=_task_info(session)))
    server.broadcast(session)


def _session_options(
    connection: Client, task: str, *, scenario: str | None = None, flown: bool = True, **others: Any
) -> SessionOptions:
    """Return the options of a client's new session; ``flown``: by a client's commands, else a task that is played."""
    server = connection.server
    # What is not UTF-8 comes as bytes.
    if not isinstance(task, str) or not isinstance(scenario, str | None):
        raise UsageError("message: a text is not UTF-8")
    if scenario is not None:
        found = server.tasks.flown(uploaded(scenario)) if flown else uploaded(scenario)
    else:
        found = server.tasks.offboard(task) if flown else server.tasks.scenario(task)
    return SessionOptions(found, **{"seeds": server.seeds, "record": server.options.record, **others})


def _task_info(session: Session) -> pb.TaskInfo:
    """Return the message TASKINFO of a session: its time step [s] and number of vehicles."""
    return pb.TaskInfo(timestep=session.time_step, numUAVs=session.simulation.size)


async def reset(connection: Client, message: Message) -> None:
    """Start the next episode of the task, and acknowledge it."""
    session = connection.required_session()
    await connection.server.run(session, session.restart)
    _print_episode(connection, session)
    connection.acknowledge()
    connection.server.broadcast(session)


def _print_episode(connection: Client, session: Session) -> None:
    """Print a line for the operator on the new episode: session, episode and seed."""
    connection.server.say(f"session {session.number}, episode {session.episode}: seed {session.simulation.seed}")


async def disconnect(connection: Client, message: Message) -> None:
    """End the client's session, and the server too if the client asks for that and it is allowed."""
    await connection.server.close_session(connection)
    if connection.server.sharing is not None:
        connection.server.sharing.release(connection)
    if not message.disconnect.quit:
        connection.acknowledge()
    elif connection.server.options.allow_quit:
        connection.acknowledge()
        connection.server.stop()
    else:
        connection.acknowledge(note="the server goes on: its operator has not allowed clients to end it (--allow-quit)")


async def set_state(connection: Client, message: Message) -> None:
    """Set the vehicles' states from a SETSTATE message, and acknowledge it."""
    session = connection.required_session()
    await connection.server.run(session, lambda: session.set_state(message.setsState.X))
    connection.acknowledge()
    connection.server.broadcast(session)


def known_step(connection: Client, payload: bytes) -> tuple[object, int] | None:
    """Return command and ticks of a STEP that a session can read without parsing (see ``Commands.known``), else
    None."""
    session = connection.session
    return session.commands.known(payload) if isinstance(session, Session) else None


def parsed_step(connection: Client, message: Message, payload: bytes) -> tuple[object, int]:
    """Parse a STEP message, and return its command and number of ticks; raises UsageError for a wrong one.

    Raises:
        UsageError: the request is wrong, or there is nothing to advance.
    """
    if connection.server.sharing is not None:
        raise shared.has_no_owner(connection.server, "STEP")
    session, request = connection.required_session(), message.step
    if not message.HasField("step"):
        raise UsageError("STEP: the message has no 'step'")
    ticks, command = session.ticks(request.dt), session.commands.of(request)
    session.commands.learn(payload, request, ticks)
    return command, ticks


async def step(connection: Client, command: object, ticks: int) -> None:
    """Advance the session by ``ticks`` with a command, and send its state; in real time, not before it is due.

    Raises:
        UsageError: the command cannot be flown, and nothing has changed; or its client leaves meanwhile.
    """
    session = connection.required_session()
    if session.expected_s(command, ticks) < SHORT_S:
        session.advance(command, ticks)
    else:
        await connection.server.advance(connection, session, command, ticks)
    state = session.states.frame(connection.reasons)
    wait = session.pacer.wait_s(session.time)
    if wait > 0.0:
        await connection.pause(wait)
    if connection.reasons or session.states.all_valid():
        connection.hold_frame(state)
    else:
        connection.acknowledge(INVALID)
    connection.server.broadcast(session, {connection.reasons: state})


# ---- extensions ----


async def hello(connection: Client, message: Message) -> None:
    """Answer HELLO with the server's version, capabilities, tasks and sessions."""
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


async def open_session(connection: Client, message: Message) -> None:
    """Start a session with the seed, pace or scenario of an OPEN message, and send its description."""
    server, request = connection.server, message.open
    factor = checked_factor(request.realtime if request.HasField("realtime") else server.options.realtime or 0.0)
    chosen = _chosen(connection, request)
    session_options = await server.run_in_thread(
        lambda: _session_options(connection, **chosen, realtime=factor, events=request.events)
    )
    session = await server.open(connection, lambda number: Session(number, session_options, server.options.view))
    _send_session(connection, session)


def _chosen(connection: Client, request: pb.Open | pb.Play) -> Content:
    """Return task, scenario and seeds of an OPEN or PLAY message, as keyword arguments of ``_session_options``."""
    if request.HasField("task") and request.HasField("scenario"):
        raise UsageError("give either a task or a scenario")
    seed = _seed(request)
    return {
        "task": request.task,
        "scenario": request.scenario if request.HasField("scenario") else None,
        "seeds": connection.server.seeds if seed is None else connection.server.seeds.begin(seed),
    }


def _seed(request: pb.Open | pb.Play | pb.Restart) -> int | None:
    """Return the seed in a request, None if it has none; raises UsageError if it is out of range."""
    if not request.HasField("seed"):
        return None
    if request.seed >= 2**63:
        raise UsageError(f"seed: {request.seed} is not an integer from 0 to 2**63 - 1")
    return request.seed


async def restart(connection: Client, message: Message) -> None:
    """Start the next episode of the task, or the first one of a seed; send the session's description."""
    session, seed = connection.required_session(), _seed(message.restart)
    async with _still(connection, "RESTART"):
        await connection.server.run(session, lambda: session.restart(seed))
        _print_episode(connection, session)
        _send_session(connection, session)


def _still(connection: Client, what: str = "") -> contextlib.AbstractAsyncContextManager[object]:
    """Return a context in which a shared world does not advance; ``what``: name of a change, refused while others have
    claims.

    Args:
        connection: whose request it is.
        what: that changes the world for all; nothing: it only looks.

    Raises:
        UsageError: others fly in the world that is to be changed.
    """
    sharing = connection.server.sharing
    if sharing is None:
        return contextlib.nullcontext()
    if what:
        sharing.check_alone(connection, what)
    return cast("contextlib.AbstractAsyncContextManager[object]", sharing.lock)


def _send_session(connection: Client, session: Session) -> None:
    """Send a client its session's description, and the first state to all clients that watch the session."""
    simulation = session.simulation
    message = pb.Session(
        id=session.number,
        scenario=session.scenario.name,
        seed=simulation.seed,
        vehicle=simulation.vehicle_names,
        info=_task_info(session),
        state=session.states.message(),
    )
    connection.send(Message(type=Message.SESSION, session=message))
    connection.server.broadcast(session)


async def get_readings(connection: Client, message: Message) -> None:
    """Send every sensor's present reading, or the reason why it is missing."""
    session = connection.required_session()
    async with _still(connection):
        told = session.sensors.frame()
        if told is not None:
            connection.send_frame(told)
            return
        found = await connection.server.run(session, lambda: sensor_readings(session.simulation))
    connection.send(Message(type=Message.READINGS, readings=found))


async def watch(connection: Client, message: Message) -> None:
    """Start or stop sending the states of a session, which another client controls, to this client."""
    request = message.watch
    if connection.session is not None:
        raise UsageError("WATCH: this connection has a session of its own; watch from another connection")
    period = request.period if request.HasField("period") else 0.0
    if not 0.0 <= period < 1e9:
        raise UsageError(f"WATCH: period {period:g} s; allowed: from 0")
    number = request.session if request.HasField("session") else None
    connection.server.watch(connection, number, period, request.stop)
    connection.acknowledge()


async def get_events(connection: Client, message: Message) -> None:
    """Send the session's events since the last request."""
    session = connection.required_session()
    if isinstance(session, SharedSession):
        async with _still(connection):
            session.hand_over()
        found = await connection.server.run(session, session.events)
    else:
        found = session.events()
    connection.send(Message(type=Message.EVENTS, events=found))


async def pace(connection: Client, message: Message) -> None:
    """Send the statistics of the session's pace, and set a new pace if the message has one."""
    session = connection.any_session()
    report = session.pacer.report()
    if message.pace.HasField("factor"):
        async with _still(connection, "PACE"):
            session.start_clock(message.pace.factor)
    connection.send(Message(type=Message.PACING, pacing=pb.Pacing(**vars(report))))


async def describe(connection: Client, message: Message) -> None:
    """Send the description of the session's world."""
    session = connection.required_session()
    found = await connection.server.run(session, lambda: description(session.scenario, session.simulation))
    connection.send(Message(type=Message.WORLD, world=found))


async def play(connection: Client, message: Message) -> None:
    """Start an episode of a task, or the next one, and send its description and first observation."""
    server, request = connection.server, message.play
    if request.HasField("task") or request.HasField("scenario") or not isinstance(connection.session, EpisodeSession):
        chosen = _chosen(connection, request)
        session_options = await server.run_in_thread(lambda: _episode_options(connection, chosen))
        session = await server.open(connection, lambda number: EpisodeSession(number, session_options))
    else:
        session, seed = connection.session, _seed(request)
        await server.run(session, lambda: session.restart(seed))
        server.say(f"session {session.number}: episode {session.episode} of seed {session.seed}")
    found = pb.Episode(
        id=session.number,
        scenario=session.scenario.name,
        seed=session.seed,
        number=session.episode,
        agent=session.play.agents,
        axis=[axis_message(axis) for axis in session.play.axes],
        period=session.play.ticks * session.play.world.time_step,
        steps=session.play.steps,
        answer_shape=session.answer_shape,
        say_size=session.play.message or None,
        observation=session.observation(),
        info=session.info(),
    )
    connection.send(Message(type=Message.EPISODE, episode=found))
    connection.server.broadcast(session)


def _episode_options(connection: Client, chosen: Content) -> SessionOptions:
    """Return the options of a new session of episodes; raises UsageError if this server cannot play tasks."""
    options = connection.server.options
    if options.record is not None or options.view is not None:
        raise UsageError(
            "PLAY: episodes are neither recorded nor drawn, and this server was started with --record or --view"
        )
    session_options = _session_options(connection, **chosen, flown=False, realtime=options.realtime)
    scenario = session_options.scenario
    if not scenario.steps:
        raise UsageError(f"PLAY: scenario '{scenario.name}' has no task; INIT or OPEN let it be flown")
    if scenario.ticks > MOST_TICKS_OF_ACT * scenario.steps:
        ticks = scenario.ticks // scenario.steps
        raise UsageError(f"PLAY: a step of this task is {ticks} time steps; allowed: up to {MOST_TICKS_OF_ACT}")
    fleets = scenario.task("float32").fleets
    if len(fleets) > 1:
        raise UsageError(f"PLAY: the agents are of several fleets, {', '.join(fleets)}; a session has those of one")
    return session_options


async def act(connection: Client, message: Message) -> None:
    """Advance an episode by one step with the actions of an ACT message, and send its outcome."""
    session = connection.required_episodes()
    found = await connection.server.run(session, lambda: session.act(message.act))
    wait = session.pacer.wait_s(session.time)
    if wait > 0.0:
        await connection.pause(wait)
    connection.send(Message(type=Message.OUTCOME, outcome=found))
    connection.server.broadcast(session)


async def say(connection: Client, message: Message) -> None:
    """Queue the radio messages of a SAY message at the vehicles' radios, and acknowledge it."""
    session, words = connection.required_session(), words_of(message.say)
    if isinstance(session, SharedSession):
        session.plant.say(connection.number, words)
    else:
        await connection.server.run(session, lambda: hand_over(session.simulation, words))
    connection.acknowledge()


Handler = Callable[["Client", Message], Awaitable[None]]
HANDLERS: dict[int, Handler] = {
    Message.INIT: init,
    Message.RESET: reset,
    Message.DISCONNECT: disconnect,
    Message.SETSTATE: set_state,
    Message.HELLO: hello,
    Message.OPEN: open_session,
    Message.RESTART: restart,
    Message.GET_READINGS: get_readings,
    Message.WATCH: watch,
    Message.GET_EVENTS: get_events,
    Message.PACE: pace,
    Message.PLAY: play,
    Message.ACT: act,
    Message.CLAIM: shared.claim,
    Message.RELEASE: shared.release,
    Message.COMMAND: shared.command,
    Message.SUBSCRIBE: shared.subscribe,
    Message.GET_STATUS: shared.get_status,
    Message.DESCRIBE: describe,
    Message.SAY: say,
    Message.INJECT: inject,
    Message.CLEAR: clear,
}
# What only a world that clients share has, and what it has not.
SHARED = {Message.CLAIM, Message.RELEASE, Message.COMMAND, Message.SUBSCRIBE, Message.GET_STATUS}
OWNED = {Message.INIT, Message.RESET, Message.SETSTATE, Message.OPEN, Message.PLAY, Message.ACT}
# The part of a message that a request needs.
NEEDED = {
    Message.INIT: "init",
    Message.RESET: "reset",
    Message.DISCONNECT: "disconnect",
    Message.INJECT: "inject",
}
