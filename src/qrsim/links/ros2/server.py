"""The server: the world ticks by the wall clock, reads what other nodes ask, and publishes what is new."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from qrsim.errors import UsageError, did_you_mean
from qrsim.links.pacing import Metronome, PaceReport
from qrsim.links.ros2 import Message
from qrsim.links.ros2 import topics as t
from qrsim.links.ros2.apis.flown import Flown
from qrsim.links.ros2.commands import topics_of, wish_of
from qrsim.links.ros2.messages import Messages, text_message
from qrsim.links.ros2.node import Node, Reader
from qrsim.links.ros2.pilots import Pilots
from qrsim.links.ros2.radio import hand_over, said_topic
from qrsim.links.ros2.typestore import Types
from qrsim.links.shared.latches import Latches
from qrsim.links.shared.recording import Recording
from qrsim.scenarios.live_requests import VERBS, apply, injected_rows, parsed
from qrsim.simulation.simulation import Simulation

CONTROLS = ("pause", "resume", "reset", "step", *VERBS)
MOST_STEPS = 1_000_000
BARRIER_EVERY_S = 2e-4
# While the world stands, others are listened to so often; its status is told so often [s] of the wall clock.
LISTEN_EVERY_S, STATUS_EVERY_S = 0.01, 1.0


@dataclass(frozen=True)
class Options:
    """How a world is served.

    Attributes:
        factor: simulated seconds per second of the wall clock.
        truth: whether the truth is published too.
        hold: silence [s] after which a vehicle holds its place.
        paused: whether it begins standing.
        rate: how often estimates, TF and truth are published at most [Hz].
        pace: "free", by the wall clock; "fast", as fast as it computes; "barrier", each tick when all who are flown
            have been asked for something.
    """

    factor: float = 1.0
    truth: bool = False
    hold: float = 0.5
    paused: bool = False
    rate: float = 50.0
    pace: str = "free"


class Server:
    """A world as a node of ROS 2.

    Args:
        simulation: of the scenario.
        types: of the distribution.
        options: how it is served.
        say: told one line of what happens.
        node: that others see.
        flown: the vehicles of the simulation, where they are flown by flight stacks; None: nodes fly them directly.
        record: makes the recording where nodes fly vehicles directly; None: it is not recorded.

    Attributes:
        recording: of the world, to be closed at the end; None: it is not recorded.
    """

    def __init__(
        self,
        simulation: Simulation,
        types: Types,
        options: Options,
        say: Callable[[str], None],
        node: Node,
        flown: Flown | None = None,
        record: Callable[[Latches], Recording] | None = None,
    ):
        self._types, self._options, self._say, self._participant = types, options, say, node
        self.simulation, self._flown = simulation, flown
        if flown is None:
            simulation.reset()
        self._pilots = Pilots(simulation, options.hold, options.factor, say, by_wall=options.pace != "free")
        if flown is None:
            self._compile()
        if flown is not None:
            self.recording = flown.world.recording
        else:
            self.recording = None if record is None else record(self._pilots.latches)
        self.messages = Messages(types, simulation, options.truth, options.rate)
        self._writers = [self._participant.writer(topic) for topic in self.messages.topics]
        self._static = self._participant.writer(t.TF_STATIC)
        self._status = self._participant.writer(t.STATUS)
        self._control = self._participant.reader(t.CONTROL)
        self._readers: list[tuple[int, str, Reader]] = []
        own = [] if flown is None else flown.topics
        self._api_writers = [node.writer(topic) for topic in own]
        self._api_readers = [] if flown is None else [(node.reader(each.topic), each.take) for each in flown.heard]
        services = [] if flown is None else flown.answered
        self._services = [(node.service(each.name, each.type), each.answer) for each in services]
        if flown is None:
            self._subscribe()
        self._said: list[tuple[int, Reader]] = []
        # Of each vehicle the last message that its radio gets before the next tick.
        self._saying: dict[int, Message] = {}
        self._not_said = ""
        if simulation.world.radio is not None:
            spaces = enumerate(self.messages.namespaces)
            self._said = [(row, self._participant.reader(said_topic(space))) for row, space in spaces]
        self._participant.announce()
        self._static.write(self.messages.static)
        self.paused, self._steps = options.paused, 0
        self._told_status = -math.inf
        self._pacer = self._new_metronome()

    def _subscribe(self) -> None:
        """Subscribe to the vehicles' command topics."""
        for row, (name, space) in enumerate(zip(self.simulation.vehicle_names, self.messages.namespaces, strict=True)):
            for own, topic in topics_of(space, self._pilots.latches.kinds(name)):
                self._readers.append((row, own, self._participant.reader(topic)))

    def _compile(self) -> None:
        """Compile all programs that the flight needs, by running them once."""
        self.simulation.advance(self._pilots.actions())
        self.simulation.reset()
        self._pilots.restart()

    def _new_metronome(self) -> Metronome:
        """Return a new Metronome, which paces the ticks from the present time on."""
        return Metronome(self._options.factor, self.simulation.time, self.simulation.world.time_step)

    def serve(self, until: float = math.inf) -> None:
        """Fly and publish tick by tick until interrupted, or until the simulated time ``until`` [s]."""
        self._pacer = self._new_metronome()
        self.publish()
        while self.simulation.time < until:
            self.listen()
            if self.paused and not self._steps:
                self._publish_status()
                time.sleep(LISTEN_EVERY_S)
                continue
            if self._options.pace == "barrier" and not self.paused and self._pilots.waited_for:
                time.sleep(BARRIER_EVERY_S)
                continue
            if not self.paused and self._options.pace == "free":
                wait = self._pacer.until_s(self.simulation.time + self.simulation.world.time_step)
                if wait > 0.0:
                    time.sleep(wait)
            self.tick()

    def tick(self) -> None:
        """Advance the simulation by one tick, and publish its messages."""
        self._send_by_radio()
        if self._flown is None:
            self._pilots.advance()
            if self.recording is not None:
                self.recording.keep()
        else:
            self._flown.advance()
        self._steps = max(0, self._steps - 1)
        self.publish()
        if not self.paused and self._options.pace == "free":
            self._pacer.ended(self.simulation.time)
        elif not self._steps:
            self._told_status = -math.inf

    def publish(self) -> None:
        """Publish all messages that are due at the present tick."""
        writers = self._writers
        flown, off = self._flown, self._off_prefixes()
        for topic, message in self.messages.due(self._pilots.modes if flown is None else flown.modes):
            if not (off and self.messages.topics[topic].name.startswith(off)):
                writers[topic].write(message)
        if flown is not None:
            for topic, message in flown.due():
                self._api_writers[topic].write(message)
        self._publish_status()

    def _off_prefixes(self) -> tuple[str, ...]:
        """Return the topic prefixes, such as "/uav1/", of the vehicles whose link is off by an injected fault."""
        unlinked = self.simulation.unlinked
        if not unlinked:
            return ()
        names = zip(self.simulation.vehicle_names, self.messages.namespaces, strict=True)
        return tuple(f"/{space}/" for name, space in names if name in unlinked)

    def listen(self) -> None:
        """Execute the requests that other nodes have sent; those for a vehicle whose link is off are dropped."""
        if self._participant.has_news():
            self._take_messages()
        for service, answer in self._services:
            for request, message in service.take():
                response = answer(message)
                if response is not None:
                    service.reply(request, response)

    def _take_messages(self) -> None:
        """Execute what the messages of all readers ask, and report the transport's remarks."""
        for message in self._control.take():
            self._obey_control(message.data)
        unlinked = self.simulation.unlinked
        for row, own, reader in self._readers:
            for message in reader.take():
                if unlinked and self.simulation.vehicle_names[row] in unlinked:
                    continue
                try:
                    wish = wish_of(own, message)
                except UsageError as error:
                    self._pilots.refuse(row, str(error))
                else:
                    self._pilots.ask(row, wish)
        for api_reader, take in self._api_readers:
            for message in api_reader.take():
                take(message)
        for row, reader in self._said:
            for message in reader.take():
                self._saying[row] = message
        for line in self._participant.remarks():
            self._say(line)

    def _send_by_radio(self) -> None:
        """Queue the messages received from ROS at the vehicles' radios."""
        for said in self._saying.items():
            try:
                checked = hand_over(self.simulation, self.messages.namespaces, [said])
                if self.recording is not None:
                    self.recording.said(checked)
            except UsageError as error:
                # Once, however often it is repeated.
                if str(error) != self._not_said:
                    self._not_said = str(error)
                    self._say(self._not_said)
        self._saying = {}

    def _obey_control(self, text: str) -> None:
        """Execute a text of /qrsim/control, and report an invalid one."""
        try:
            self._control_world(text.split())
        except UsageError as error:
            self._say(str(error))
        self._told_status = -math.inf

    def _control_world(self, words: list[str]) -> None:
        """Execute a request of /qrsim/control: reset, step, pause, resume or an injection; raises UsageError for
        others."""
        what, rest = (words[0], words[1:]) if words else ("", [])
        if what not in CONTROLS:
            raise UsageError(
                f"/qrsim/control '{what[:60]}': expected {', '.join(CONTROLS)}{did_you_mean(what[:60], CONTROLS)}"
            )
        if what == "reset":
            self._reset_world(_integer_argument("reset", rest, self.simulation.seed, 0, 2**63 - 1))
        elif what == "step":
            self.paused = True
            self._steps = _integer_argument("step", rest, 1, 1, MOST_STEPS)
        elif what in VERBS:
            self._inject(words)
        else:
            if rest:
                raise UsageError(f"/qrsim/control {what}: '{rest[0][:60]}' is too much")
            self.paused = what == "pause"
            self._pacer = self._new_metronome()

    def _inject(self, words: list[str]) -> None:
        """Inject a fault or change the wind, as a text of /qrsim/control asks, split into words; vehicles by name or
        namespace."""
        names = dict(zip(self.messages.namespaces, self.simulation.vehicle_names, strict=True))
        try:
            request = parsed(" ".join(words))
            vehicles = request.vehicles and tuple(names.get(name.strip("/"), name) for name in request.vehicles)
            self._say(apply(self.simulation, replace(request, vehicles=vehicles), "ros2"))
        except UsageError as error:
            raise UsageError(f"/qrsim/control {words[0]}: {error}") from None

    def _reset_world(self, seed: int) -> None:
        """Start an episode with a seed, and publish its first messages."""
        if self._flown is None:
            if self.recording is not None:
                self.recording.end()
            self.simulation.reset(seed)
            if self.recording is not None:
                self.recording.begin()
        else:
            self._flown.reset(seed)
        self._pilots.restart()
        self._steps, self._saying = 0, {}
        self._pacer = self._new_metronome()
        self.publish()

    def _publish_status(self) -> None:
        """Publish time, pace, seed and injected faults as JSON text, at most every STATUS_EVERY_S [s]."""
        now = time.monotonic()
        if now - self._told_status < STATUS_EVERY_S:
            return
        self._told_status = now
        report, simulation = self._pacer.report(), self.simulation
        status: dict[str, object] = {
            "time": simulation.time,
            "tick": simulation.tick,
            "paused": self.paused,
            "steps": self._steps,
            "seed": simulation.seed,
            "factor": self._options.factor,
            "late": report.overruns,
            "lost": sum(writer.lost for writer in (*self._writers, *self._api_writers)),
            "injected": injected_rows(simulation),
        }
        self._status.write(text_message(self._types, json.dumps(status)))

    def report(self) -> PaceReport:
        """Return the statistics of the pace."""
        return self._pacer.report()


def _integer_argument(what: str, words: list[str], default: int, low: int, high: int) -> int:
    """Return a control request's integer argument, or its default; raises UsageError, naming ``what``, outside ``low``
    to ``high``."""
    if not words:
        return default
    if len(words) == 1 and words[0].isdecimal() and low <= int(words[0]) <= high:
        return int(words[0])
    raise UsageError(f"/qrsim/control {what} '{' '.join(words)[:60]}': expected an integer from {low} to {high}")
