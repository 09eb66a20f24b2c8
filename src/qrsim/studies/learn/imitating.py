"""Imitation of a task's baseline, by DAgger (Ross, Gordon and Bagnell 2011).

The baseline flies the first round of episodes, and the policy all others. After each round the network is fitted to the
baseline's actions in all states so far, so that a policy learns to come back from its own errors. A policy does not see
the time, so it imitates the form of a baseline that has no clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.envs.batch import Batch
from qrsim.envs.one_side import OneSide
from qrsim.extras import load
from qrsim.studies.learn.flights import Flights
from qrsim.studies.learn.moments import Moments
from qrsim.studies.learn.ppo import network, usual_promotion
from qrsim.tasks.baselines.many import Many
from qrsim.tasks.learned import LIMIT, Scaling, forward

# Rounds of episodes, and blocks of steps of the gradient after each of them and after the last; their rate falls to 0.
ROUNDS, BLOCKS, LAST_BLOCKS = 30, 4, 60
# Steps of the gradient in a block, states of each, and the rate of Adam.
STEPS, ROWS, RATE = 250, 1024, 3e-3
# Noise of the outputs that are flown, so that states near the flown ones are seen too.
NOISE = 0.03
# One round of so many is of whole episodes, and the others are left after so many decisions.
CUT, SHORT = 3, 30
# States that are kept at most; of more a part is left out.
MOST_STATES = 4_000_000


@dataclass(frozen=True)
class Imitated:
    """Result of an imitation.

    Attributes:
        layers: of the network.
        decisions: flown by all agents.
    """

    layers: Any
    decisions: int


class States:
    """States that were seen, inputs (N, F), and the baseline's outputs there, (N, K).

    Args:
        expected: number of states that will be added; of more than ``MOST_STATES`` every second, third, ... is kept.
    """

    def __init__(self, expected: int = 0) -> None:
        self._every = -(-max(expected, 1) // MOST_STATES)
        self.inputs: list[Floats] = []
        self.outputs: list[Floats] = []

    def add(self, inputs: Floats, outputs: Floats) -> None:
        """Append rows."""
        self.inputs.append(inputs[:: self._every])
        self.outputs.append(outputs[:: self._every])


def fly_round(
    flights: Flights,
    seeds: Floats,
    steps: int,
    act: Callable[[Floats], Floats] | None,
    rng: np.random.Generator,
    states: States,
) -> int:
    """Fly one episode for each seed, and add its states and the baseline's outputs to ``states``.

    Args:
        flights: of the learner.
        seeds: (B,) of the episodes.
        steps: after which they are left, at most those of an episode.
        act: inputs (N, F) to outputs (N, K); None: the baseline flies.
        rng: of the noise of the outputs that are flown.
        states: is added to.

    Returns:
        The number of decisions.
    """
    flights.begin(seeds)
    batch = flights.batch
    taught = _by_baseline(batch)
    alive, count = np.ones(flights.rows, bool), 0
    for _ in range(steps):
        features = flights.features()
        action = taught()
        wanted = flights.view.output(action.reshape(flights.rows, -1), flights.seen)
        states.add(features[alive], wanted[alive])
        outputs = wanted if act is None else act(features)
        count += int(alive.sum())
        flown = outputs + NOISE * rng.standard_normal(outputs.shape, np.float32)
        flights.last = flights.view.remember(flown, flights.seen, flights.last)
        action = flights.view.action(flown.clip(-LIMIT, LIMIT), flights.seen).reshape(batch.size, flights.agents, -1)
        _, terminated, _ = batch.step(action)
        alive &= ~np.repeat(terminated, flights.agents)
        if not alive.any():
            break
    return count


def _by_baseline(batch: Batch | OneSide) -> Callable[[], Floats]:
    """Return a function that returns the baseline's actions (B, n, A) for the present observations."""
    if isinstance(batch, OneSide):
        return batch.baseline
    many = Many(batch.functional.play, batch.size, timeless=True)
    many.begin()
    return lambda: many.act(batch.seen)


class Fit:
    """Supervised regression of a network by Adam.

    Args:
        layers: of the network, before.

    Raises:
        MissingExtraError: optax is not installed.
    """

    def __init__(self, layers: Any):
        optax = load("learn", "qrsim train", "optax")
        self._adam, self._apply = optax.scale_by_adam(), optax.apply_updates
        with usual_promotion():
            self._carry = (layers, self._adam.init(layers))
        self._block = jax.jit(self._steps)

    @property
    def layers(self) -> Any:
        """Layers of the network now."""
        return self._carry[0]

    def improve(self, inputs: Floats, outputs: Floats, rates: Floats, rng: np.random.Generator) -> None:
        """Take a step of the gradient for each of rates (S,), of ``ROWS`` rows that are drawn from all (N, ...)."""
        rows = rng.integers(0, len(inputs), (len(rates), ROWS))
        self._carry = self._block(self._carry, inputs[rows], outputs[rows], rates)

    def _steps(self, carry: Any, inputs: Array, outputs: Array, rates: Array) -> Any:
        """Return layers and optimiser after steps with inputs (S, M, F), outputs (S, M, K) and rates (S,)."""

        def step(carry: Any, rows: Any) -> tuple[Any, None]:
            """Take one step of the gradient."""
            layers, state = carry
            given, wanted, rate = rows
            slope = jax.grad(lambda layers: jnp.mean(jnp.square(network(layers, given) - wanted)))(layers)
            with usual_promotion():
                change, state = self._adam.update(slope, state)
                return (self._apply(layers, jax.tree.map(lambda each: -rate * each, change)), state), None

        # ``network`` takes a state in each column.
        return jax.lax.scan(step, carry, (inputs.swapaxes(1, 2), outputs.swapaxes(1, 2), rates))[0]


def imitate(flights: Flights, layers: Any, moments: Moments, seed: int, rng: np.random.Generator) -> Imitated:
    """Return a network that does as the task's baseline.

    Args:
        flights: of the learner.
        layers: of the network, before.
        moments: of the inputs; the states of all rounds are added.
        seed: of the first episode; those of the others follow.
        rng: of noise and rows.

    Raises:
        UsageError: the task has no baseline.
    """
    whole = flights.batch.functional.play.steps
    lengths = [whole if number % CUT == 0 else min(SHORT, whole) for number in range(ROUNDS)]
    fit, states, decisions = Fit(layers), States(flights.rows * sum(lengths)), 0
    act: Callable[[Floats], Floats] | None = None
    # Vehicles meet at the start, which is a small part of a whole episode.
    for number, steps in enumerate(lengths):
        seeds = seed + flights.batch.size * number + np.arange(flights.batch.size)
        begun = len(states.inputs)
        decisions += fly_round(flights, seeds, steps, act, rng, states)
        moments.add(np.concatenate(states.inputs[begun:]))
        scaling = moments.scaling()
        inputs, outputs = scaling.scaled(np.concatenate(states.inputs)), np.concatenate(states.outputs)
        for rates in _rates(number == ROUNDS - 1):
            fit.improve(inputs, outputs, rates, rng)
        flown = jax.tree.map(np.asarray, fit.layers)

        def act(features: Floats, flown: Any = flown, scaling: Scaling = scaling) -> Floats:
            """Return the outputs of the network now."""
            found: Floats = forward(flown, scaling.scaled(features))
            return found

    return Imitated(fit.layers, decisions)


def _rates(last: bool) -> list[Floats]:
    """Return the rates of all blocks of steps after a round; after the last they fall to 0."""
    blocks = LAST_BLOCKS if last else BLOCKS
    part = np.linspace(1.0, 0.0, blocks * STEPS, endpoint=False) if last else np.ones(blocks * STEPS)
    return np.split((RATE * part).astype(np.float32), blocks)
