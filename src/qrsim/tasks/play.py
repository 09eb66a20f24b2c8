"""A task in its world: episodes from their start, step by step; pure functions, compiled by the caller."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.extend.core.primitives import convert_element_type_p

from qrsim.core.noise import Draw, Key, StreamKeys
from qrsim.core.tree import quantity, record, replace, select, setting
from qrsim.tasks.agents import Axis, all_fly, fleet_of
from qrsim.tasks.contracts import Task
from qrsim.tasks.speaking import at_first_period, message_size, overheard, spoken
from qrsim.tasks.teams import Side, apart, in_units, of_all, sides_of, width
from qrsim.world import tick as ticks_of
from qrsim.world.draws import keys_of
from qrsim.world.radio import heard
from qrsim.world.state import Action, State, World, WorldKeys, period_ticks

TASK = "/task"


@record
class Episode:
    """Everything that changes in an episode."""

    state: State = quantity(doc="of the world")
    memory: Any = quantity(doc="of the task")
    step: Array = quantity(doc="() int32 steps done")
    gone: Any = quantity(default=None, doc="(n,) bool agents that have stopped, where these leave; else None")


@record
class Judged:
    """What a step was worth."""

    memory: Any = quantity(doc="of the task, after it")
    reward: Array = quantity(doc="(n,) of the agents")
    goes_on: Array = quantity(doc="() bool: no agent has stopped, or if agents leave, not all have")
    gone: Array | None = quantity(doc="as of ``Episode``")


@record
class Step:
    """Result of a step for the agents (n,)."""

    observation: Any = quantity(
        doc="observations of the agents, (n, O) or a dict of arrays (n, ...); of several fleets by fleet"
    )
    reward: Array = quantity(doc="(n,)")
    terminated: Array = quantity(doc="() bool: a vehicle has stopped, and the episode has ended")
    truncated: Array = quantity(doc="() bool: the last step is done")
    gone: Any = quantity(default=None, doc="as of ``Episode``")


@record
class Progress:
    """An episode between two ticks."""

    episode: Episode = quantity()
    commands: tuple[Action, ...] = quantity(doc="held over the ticks of a step")
    last: Step = quantity(doc="result of the last step")
    truth: Any = quantity(doc="after the last step, by name")
    shot: Any = quantity(default=None, doc="what ``Play.look`` needs of the agents (n,); None: it is not used")


@record
class EpisodeKeys:
    """The keys of all randomness of an episode."""

    world: WorldKeys = quantity()
    task: StreamKeys = quantity()


@record
class Play:
    """A task, its world and the length of an episode; its numbers are leaves, so changing them does not recompile."""

    task: Task = quantity(doc="the task")
    world: World = quantity(doc="where")
    length: Any = quantity(unit="1", doc="() int32 steps of an episode; given as an int")
    late: bool = setting(default=False, doc="whether observations lack what ``look`` computes")

    def __post_init__(self) -> None:
        # int32 like the number of a step, so that every episode's length has one program.
        if isinstance(self.length, int):
            object.__setattr__(self, "length", np.int32(self.length))

    @property
    def steps(self) -> int:
        """Number of steps in an episode; a program reads ``length``."""
        return int(self.length)

    @property
    def _steps(self) -> Array:
        """Number of steps () int32 that a task gets; JAX promotes it as it does a Python integer (weakly typed)."""
        # No function of JAX's own makes one of a number that a program is given.
        weak: Array = convert_element_type_p.bind(
            self.length, new_dtype=np.dtype(np.int32), weak_type=True, sharding=None
        )
        return weak

    @property
    def agents(self) -> tuple[str, ...]:
        """Names of the vehicles that are agents of the task."""
        return tuple(name for side in self.sides for name in side.names)

    @property
    def sides(self) -> tuple[Side, ...]:
        """Agents grouped by fleet; more than one group if several fleets are agents."""
        return sides_of(self.task, self.world)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Description of each number of an agent's action; with several fleets, of the first fleet."""
        return self.sides[0].axes

    @property
    def width(self) -> int:
        """Size A of the action array (n, A) of all agents: the largest number of axes."""
        return width(self.sides)

    @property
    def message(self) -> int:
        """Size D of the message that an agent can send per step; 0 without a radio, or if the task receives them."""
        return 0 if self.task.receives else message_size(self.world)

    @property
    def ticks(self) -> int:
        """Number of ticks in a step (one action)."""
        return period_ticks(self.task.period, self.world.time_step)

    @property
    def in_step(self) -> bool:
        """Whether a step is a multiple of all periods in the world, so that the worlds of a batch stay in phase."""
        contents = self.world.contents
        periods = [self.world.sky.period, contents.plume.period, contents.persons.period]
        periods += [sensor.period for fleet in self.world.fleets for sensor in fleet.sensors]
        periods += [] if self.world.radio is None else [self.world.radio.period]
        return all(self.ticks % period_ticks(period, self.world.time_step) == 0 for period in periods)

    def keys(self, key: Key) -> EpisodeKeys:
        """Return the random keys of an episode, or of many; NumPy arrays if those of ``key`` are."""
        return EpisodeKeys(keys_of(self.world, key), key.streams([TASK]))

    def reset(self, keys: EpisodeKeys) -> tuple[Episode, Any]:
        """Start an episode from its random keys; return its state and the agents' observations."""
        state = ticks_of.reset(self.world, keys.world)
        memory = self.begun(keys, state)
        episode = Episode(state, memory, jnp.int32(0), self.nobody_gone())
        return episode, self.observed(memory, state, jnp.int32(0))

    def nobody_gone(self) -> Array | None:
        """Return flags (n,) of the agents that have left, all False at first; None if agents never leave."""
        return jnp.zeros(len(self.agents), bool) if self.task.leave else None

    def begun(self, keys: EpisodeKeys, state: State) -> object:
        """Return the task's memory (its own state) at the start of an episode with the world in ``state``."""
        like = jnp.zeros((), self.world.fleets[0].start.position_ned.x.dtype)
        ids = jnp.arange(self.task.ids, dtype=jnp.uint32)
        return self.task.init(self.world, state, Draw(keys.task.stream(0, ids), jnp.int32(0), like))

    def step(self, episode: Episode, action: Array) -> tuple[Episode, Step]:
        """Advance an episode by one step (action); return its state, and observation, reward and ends.

        Args:
            episode: before; where it has ended, what comes has no meaning.
            action: (n, A) in [-1, 1], clipped; see ``width``. With a radio also (n, A + D), whose
                last numbers are said to all; NaN: nothing is.
        """
        begun = episode.step * self.ticks
        commands = self._commands_of(episode, action)

        def tick(number: object, now: tuple[State, object]) -> tuple[State, object]:
            """Advance world and task by one tick under the commands of the step."""
            return self._tick(*now, commands, begun, number)

        carry = (episode.state, episode.memory)
        state, memory = tick(0, carry) if self.ticks == 1 else lax.fori_loop(0, self.ticks, tick, carry)
        return self._judged(Episode(state, memory, episode.step, episode.gone))

    def tick(self, action: Array, progress: Progress, number: Array) -> Progress:
        """Advance an episode by tick ``number`` of a step; like ``step``, for programs that run tick by tick.

        Args:
            action: as of ``step``.
            progress: after the tick before.
            number: () int32 of the tick in its step, the same in all worlds.
        """
        episode = progress.episode
        commands = lax.cond(number == 0, lambda: self._commands_of(episode, action), lambda: progress.commands)
        begun = episode.step * self.ticks
        state, memory = self._tick(episode.state, episode.memory, commands, begun, number)
        after = Episode(state, memory, episode.step, episode.gone)

        def judged() -> Progress:
            """Return the episode at the end of a step, with reward, observation and truth."""
            ended, step = self._judged(after)
            return Progress(ended, commands, step, self.truth(ended), self._shot(ended.state, progress.shot))

        def going() -> Progress:
            """Return the episode after a tick that does not end the step."""
            return Progress(after, commands, progress.last, progress.truth, progress.shot)

        return lax.cond(number == self.ticks - 1, judged, going)

    def progress(self, keys: EpisodeKeys) -> Progress:
        """Start an episode that ``tick`` advances; its results hold only the first observations."""
        episode, seen = self.reset(keys)
        dtype = self.world.fleets[0].start.position_ned.x.dtype
        action = jnp.zeros((len(self.agents), self.width + self.message), dtype)
        commands = jax.eval_shape(self._commands_of, episode, action)
        _, step = jax.eval_shape(self._judged, episode)
        zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), (commands, step))
        shot = self.task.shot(self.world, episode.state) if self.late else None
        return Progress(episode, zeros[0], replace(zeros[1], observation=seen), self.truth(episode), shot)

    def _shot(self, state: State, before: Any) -> Any:
        """Return what ``look`` needs of each agent; of stopped agents what it was before they stopped."""
        if not self.late:
            return None
        _, fleet = fleet_of(self.world, state, self.task.fleet)
        return select(fleet.violation.code != 0, before, self.task.shot(self.world, state))

    def look(self, progress: Progress, to: dict[str, Array]) -> dict[str, Array]:
        """Compute the parts of an observation that ``task.later`` names; stopped agents keep their last ones.

        Args:
            progress: at the end of a step.
            to: zeros in the shapes of these parts.
        """
        return self.task.look(self.world, progress.episode.state, progress.shot, to)

    def _commands_of(self, episode: Episode, action: Array) -> tuple[Action, ...]:
        """Return one command or set-point per fleet for an action (n, A) in [-1, 1]."""
        acts, sides = self.width, self.sides
        says = self.message > 0 and action.shape[1] > acts
        flown = action[:, :acts] if says else action
        commands = self.task.commands(episode.memory, self.world, apart(sides, self.scaled(flown)))
        for side in sides if says else ():
            commands = spoken(self.world, side.fleet, commands, action[side.rows, acts:])
        return commands

    def observed(self, memory: object, state: State, tick: Array) -> Any:
        """Return the agents' observations at a tick () of the episode, with received messages if there is a radio."""
        if self.task.receives:
            return self.task.observe_received(memory, self.world, state, heard(self.world, state, tick))
        observe, fleets = self.task.observe_early if self.late else self.task.observe, self.task.fleets
        seen: Any = observe(memory, self.world, state)
        if not self.message:
            return seen
        if len(fleets) == 1:
            return overheard(self.world, state, fleets[0], seen, tick)
        return {fleet: overheard(self.world, state, fleet, seen[fleet], tick) for fleet in fleets}

    def _tick(
        self, state: State, memory: object, commands: tuple[Action, ...], begun: Array, number: Any
    ) -> tuple[State, object]:
        """Advance world and task by tick ``number`` of the step that began at tick ``begun``; return their states."""
        # Where all are due together, the number is that of every world and slow sensors are really skipped.
        tick, before = (number, begun) if self.in_step else (begun + number, None)
        commands = at_first_period(self.world, commands, tick, number)
        state = ticks_of.step(self.world, state, tick, commands, None, before)
        return state, self.task.each_tick(memory, self.world, state)

    def _judged(self, episode: Episode) -> tuple[Episode, Step]:
        """Return the episode's state after its step, and the step's observation, reward and ends."""
        state, number = episode.state, episode.step + 1
        found = self.rewarded(episode)
        after = Episode(state, found.memory, number, found.gone)
        seen = self.observed(found.memory, state, number * self.ticks)
        fly = found.goes_on
        return after, Step(seen, found.reward, ~fly, fly & (number >= self.length), found.gone)

    def rewarded(self, episode: Episode) -> Judged:
        """Return task memory, reward, whether the episode goes on, and agents that left, after a step's last tick."""
        memory, worth = self.task.judge(episode.memory, self.world, episode.state, episode.step + 1, self._steps)
        reward = of_all(self.sides, worth)
        if not self.task.leave:
            fly = all_fly(episode.state)
            return Judged(memory, jnp.where(fly, reward, self._crashed(episode)), fly, None)
        stopped = {
            model.name: state.violation.code != 0
            for model, state in zip(self.world.fleets, episode.state.fleets, strict=True)
        }
        own = [stopped.pop(name) for name in self.task.fleets]
        gone = jnp.concatenate(own)
        # It ends when no agent of a fleet is left.
        over = [jnp.all(each) for each in own] + [jnp.any(each) for each in stopped.values()]
        goes_on = ~jnp.any(jnp.stack(over))
        # Who stops pays once; what the task is worth to the others does not depend on it.
        left = jnp.where(episode.gone, 0.0, self.task.penalty)
        reward = jnp.where(gone, left, jnp.where(goes_on, reward, self._crashed(episode)))
        return Judged(memory, reward, goes_on, gone)

    def _crashed(self, episode: Episode) -> Array:
        """Return the reward, () for the team or (n,), of the step in which a vehicle stops."""
        return self.task.crashed(episode.memory, self.world, episode.state, self._steps)

    def scaled(self, action: object) -> Any:
        """Convert actions (n, A) in [-1, 1], clipped, to physical units; NumPy or JAX."""
        return in_units(self.sides, action)

    def truth(self, episode: Episode) -> dict[str, Array]:
        """Return the true values of the agents, name -> (n, ...), which they do not observe."""
        each = [self._fleet_truth(episode, fleet) for fleet in self.task.fleets]
        own = each[0] if len(each) == 1 else {name: jnp.concatenate([one[name] for one in each]) for name in each[0]}
        return own | self.task.truth(episode.memory, self.world, episode.state)

    def _fleet_truth(self, episode: Episode, name: str) -> dict[str, Array]:
        """Return the true values of a fleet's vehicles, name -> (n, ...)."""
        model, fleet = fleet_of(self.world, episode.state, name)
        vehicle = model.vehicle.pose(fleet.vehicle)
        return {
            "position_ned": vehicle.position_ned.stack(),
            "attitude": jnp.stack(jax.tree.leaves(vehicle.attitude), axis=-1),
            "velocity_body": vehicle.velocity_body.stack(),
            "reason": fleet.violation.code,
            "reason_value": fleet.violation.value,
        }
