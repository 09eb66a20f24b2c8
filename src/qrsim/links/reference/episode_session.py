"""One client's episodes of a task; methods are called one at a time, from any thread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.noise import Key
from qrsim.core.tree import cast
from qrsim.engine.layout import Buffers, Packer
from qrsim.engine.settings import use_compilation_cache
from qrsim.errors import UsageError
from qrsim.links.pacing import Pacer
from qrsim.links.reference.commands import rows_of
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Act, Arrayd, Outcome
from qrsim.links.reference.radio import said
from qrsim.links.reference.readout import States
from qrsim.links.reference.session import SessionOptions
from qrsim.tasks import Play
from qrsim.tasks.episodes import Episodes, score
from qrsim.world.episode import refuse_unplaced
from qrsim.world.state import World

PRECISION = np.dtype(np.float32)
# An action may be outside [-1, 1] by no more than rounding.
ROUNDING = 1e-5


class EpisodeSession:
    """Session of a task's episodes. Call ``begin`` first, in the compiling thread.

    Attributes:
        number: id of the session.
        scenario: what is played.
        thread: a thread of its own, for what takes long.
        play: the task and its world.
        pacer: of the present episode.
        episode: () which one of its seed's series.
    """

    play: Play
    pacer: Pacer

    def __init__(self, number: int, options: SessionOptions):
        self.number, self.scenario, self._options = number, options.scenario, options
        self.thread = ThreadPoolExecutor(1, thread_name_prefix=f"session-{number}")
        self.seed = self.episode = self._step = 0
        self._seeds = options.seeds
        self._running = False
        self._layout: Packer | None = None
        self._states: States | None = None

    @property
    def vehicle_names(self) -> tuple[str, ...]:
        """Names of all vehicles of the world, including those that no agent commands."""
        return tuple(name for fleet in self.play.world.fleets for name in fleet.vehicle_names)

    @property
    def size(self) -> int:
        """Number of vehicles of the world."""
        return len(self.vehicle_names)

    @property
    def world(self) -> World:
        """World (parameters) of the task."""
        return self.play.world

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._step * self.play.ticks * self.play.world.time_step

    @property
    def answer_shape(self) -> tuple[int, ...]:
        """Shape of the answer that each agent gives with its last action; () for a task without answers."""
        return tuple(self.play.task.answer_shape(self.play.world))

    def begin(self) -> None:
        """Build the task and its world, and start the first episode.

        Raises:
            RunError: a fleet found no place.
        """
        use_compilation_cache()
        task, world = self.scenario.task(PRECISION.name), self.scenario.world(PRECISION.name)
        # Of every number one array, so that all scenarios of a structure share a program.
        self.play = Play(cast(task, PRECISION), world, self.scenario.steps)
        # Alone, as an environment computes it, so that it is the same episode to the bit.
        self._episodes = Episodes(self.play, 1, PRECISION)
        self.pacer = Pacer(self._options.realtime, 0.0)
        self.seed = self._seeds.next()
        self._start_episode()

    def start_clock(self, factor: float) -> None:
        """Start counting the pace at a real-time factor (0: lock-step); raises UsageError for a bad factor."""
        self.pacer = Pacer(factor, self.time)

    def restart(self, seed: int | None) -> None:
        """Start the first episode of a new seed, or, for None, the next one of the same series of seeds.

        Raises:
            RunError: a fleet found no place.
        """
        if seed is not None:
            self._seeds = self._seeds.begin(seed)
            self.seed, self.episode = self._seeds.next(), 0
        elif self._seeds.episodes == "new":
            self.episode += 1
        self._start_episode()
        self.pacer.restarted()

    def _start_episode(self) -> None:
        """Start an episode from the session's seed and the episode's number, and store its first observation."""
        keys = self.play.keys(Key.roots(np.array([self.seed]), np.array([self.episode])))
        self._running = False
        begun = self._episodes.start(np.zeros(1, int), keys)
        self._seen, self._truth = begun.seen, begun.truth
        refuse_unplaced(self.play.world, begun.placed)
        self._running, self._step = True, 0

    def act(self, request: Act) -> Outcome:
        """Advance the episode by one step with the agents' actions, and return the protobuf outcome.

        Raises:
            UsageError: the episode has ended; or wrong actions or answers, and nothing has changed.
        """
        if not self._running:
            raise UsageError("ACT: the episode has ended; PLAY starts the next one")
        action = np.concatenate([self._action(request.action), said(self.play, request)], axis=1, dtype=PRECISION)
        last = self._step + 1 >= self.play.steps
        answer = self._answer(request.answer) if request.answer or (last and self.answer_shape) else None
        step, self._truth = self._episodes.step(action[None])
        self._seen = step.observation
        self._step += 1
        reward = np.asarray(step.reward)[0].astype(np.float64)
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        if truncated and answer is not None:
            reward += score(self.play, self._episodes.episode(0), answer)
        self._running = not (terminated or truncated)
        return Outcome(
            step=self._step,
            t=self.time,
            observation=self.observation(),
            reward=reward.tolist(),
            terminated=terminated,
            truncated=truncated,
            info=self.info(),
        )

    def _action(self, given: Sequence[Arrayd]) -> NumpyArray:
        """Return the agents' actions (n, A) from a request's vectors; raises UsageError for wrong counts and numbers
        out of range."""
        axes, agents = self.play.axes, self.play.agents
        with np.errstate(over="ignore"):
            action = np.array(rows_of(given, (len(axes),), "action", agents), PRECISION)
        wrong = ~(np.abs(action) <= 1.0 + ROUNDING)
        if wrong.any():
            row, axis = np.argwhere(wrong)[0]
            said = f"{axes[axis].name} of '{agents[row]}' is {action[row, axis]:g}"
            raise UsageError(f"action: {said}; allowed: -1 to 1")
        return action

    def _answer(self, given: Sequence[Act.Answer]) -> NumpyArray:
        """Return the agents' answers (n, ...) from a request; raises UsageError for wrong counts or numbers."""
        shape, agents = self.answer_shape, self.play.agents
        if not shape:
            raise UsageError("answer: nothing is handed in in this task")
        if len(given) != len(agents):
            raise UsageError(f"answer: there are {len(given)}; expected {len(agents)}, one of each agent")
        wanted = int(np.prod(shape))
        for name, row in zip(agents, given, strict=True):
            if len(row.value) != wanted:
                raise UsageError(f"answer of '{name}': {len(row.value)} numbers; expected {wanted}, of shape {shape}")
        answer = np.array([row.value for row in given], PRECISION)
        if not np.isfinite(answer).all():
            row, number = np.argwhere(~np.isfinite(answer))[0]
            raise UsageError(f"answer of '{agents[row]}': number {number} is not finite")
        return answer.reshape(len(agents), *shape)

    # ---- what is told ----

    def observation(self) -> list[pb.Values]:
        """Return the agents' present observations as protobuf arrays, each with its name."""
        return _values(_flat(self._seen) if isinstance(self._seen, dict) else {"": self._seen})

    def info(self) -> list[pb.Values]:
        """Return the task's ground truth at this step as protobuf arrays, each with its name."""
        return _values(self._truth)

    @property
    def states(self) -> States:
        """Encoder of STATE messages for clients that watch."""
        self._states = self._states or States(self)
        return self._states

    @property
    def packed(self) -> tuple[Packer, Buffers]:
        """Layout and flat buffers of the world's present state."""
        state = jax.tree.map(np.asarray, self._episodes.episode(0).state)
        if self._layout is None:
            self._layout = Packer(state)
        return self._layout, self._layout.pack(state)

    def summary(self) -> str:
        """Return a line for the operator on the episodes played."""
        return f"{self._step} steps of episode {self.episode} of seed {self.seed}"

    def end(self) -> None:
        """End the session; no other method may be called afterwards."""
        self.thread.shutdown(wait=False)


def _flat(arrays: Mapping[str, object], before: str = "") -> dict[str, object]:
    """Flatten a dict of dicts of arrays: each array by its dotted name, after ``before``."""
    found: dict[str, object] = {}
    for name, array in arrays.items():
        found |= _flat(array, f"{before}{name}.") if isinstance(array, dict) else {f"{before}{name}": array}
    return found


def _values(arrays: Mapping[str, object]) -> list[pb.Values]:
    """Convert arrays (1, n, ...) by name to protobuf arrays of shape (n, ...)."""
    found = []
    for name, array in arrays.items():
        numbers = np.asarray(array)[0]
        found.append(pb.Values(name=name, shape=numbers.shape, value=numbers.astype(np.float32).ravel().tolist()))
    return found
