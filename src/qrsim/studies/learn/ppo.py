"""Proximal policy optimisation (Schulman et al. 2017) in JAX; gradients by JAX, Adam by optax."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.extras import load
from qrsim.tasks.learned import LIMIT, Scaling, View

# Mean and standard deviation of the inputs, (F,) each.
Pair = tuple[Any, Any]
# Names of the weights that a decision needs.
DECIDING = ("policy", "log_spread")


@dataclass(frozen=True)
class Settings:
    """Numbers of the algorithm.

    Attributes:
        discount: of the reward of the next decision.
        trace: lambda of generalised advantage estimation (Schulman et al. 2016).
        clip: largest change of a probability ratio that is rewarded.
        rate: learning rate of Adam.
        epochs: passes over the samples of an iteration.
        minibatches: steps of the gradient in a pass.
        value_weight: of the squared error of the value.
        entropy_weight: of the entropy.
        most_gradient: norm at which gradients are clipped.
        spread: first standard deviation of the outputs.
        width: of the two hidden layers.
        averaged: weight of the iterations before in the running mean of the policies that is flown and kept; 0: the
            last policy.
        falling: whether the rate falls to 0 with the last decision.
    """

    discount: float = 0.98
    trace: float = 0.95
    clip: float = 0.2
    rate: float = 1e-3
    epochs: int = 1
    minibatches: int = 32
    value_weight: float = 0.5
    entropy_weight: float = 0.0
    most_gradient: float = 0.5
    spread: float = 1.0
    width: int = 32
    averaged: float = 0.0
    falling: bool = False


class Learner(NamedTuple):
    """Weights of policy and value, and the state of the optimiser."""

    weights: Any
    optimiser: Any


class Samples(NamedTuple):
    """Decisions of an iteration.

    Attributes:
        inputs: (T + 1, N, F) before each decision, and after the last; unscaled as they are recorded.
        outputs: (T, N, K) of the decisions.
        log_density: (T, N) of these outputs, up to a constant.
        reward: (T, N).
        ended: (T, N) bool: the episode has ended.
        beyond: (T, N) value of the state in which an episode was cut off by its time limit, 0 elsewhere.
    """

    inputs: Any
    outputs: Any
    log_density: Any
    reward: Any
    ended: Any
    beyond: Any


class Decision(NamedTuple):
    """A decision of all rows.

    Attributes:
        features: (N, F) unscaled inputs.
        outputs: (N, K) of the network.
        action: (N, A).
    """

    features: Any
    outputs: Any
    action: Any


class Rows(NamedTuple):
    """Decisions (M,) to learn from; inputs (M, F), outputs (M, K), transposed in a step of the gradient."""

    inputs: Any
    outputs: Any
    log_density: Any
    advantage: Any
    target: Any


def _layers(key: Array, sizes: tuple[int, ...], last: float) -> list[tuple[Array, Array]]:
    """Return initial layers (weights, offset) for ``sizes``, orthogonal, with gain ``last`` in the last layer."""
    keys = jax.random.split(key, len(sizes) - 1)
    gains = [2.0**0.5] * (len(sizes) - 2) + [last]
    return [
        (jax.nn.initializers.orthogonal(gain)(one, shape, jnp.float32), jnp.zeros(shape[1], jnp.float32))
        for one, gain, shape in zip(keys, gains, itertools.pairwise(sizes), strict=True)
    ]


def network(layers: Any, inputs: Array) -> Array:
    """Return the outputs (K, N) of a network of ``layers`` with tanh between them, for inputs (F, N).

    Each column is a decision. XLA computes a gradient by columns in two thirds of the time that it takes by rows.
    """
    for weights, offset in layers[:-1]:
        inputs = jnp.tanh(weights.T @ inputs + offset[:, None])
    found: Array = layers[-1][0].T @ inputs + layers[-1][1][:, None]
    return found


class Algorithm:
    """The compiled functions of a learner.

    Args:
        view: of the task.
        settings: numbers of the algorithm.

    Raises:
        MissingExtraError: optax is not installed.
    """

    def __init__(self, view: View, settings: Settings):
        optax = load("learn", "qrsim train", "optax")
        self.settings, self.view = settings, view
        self._adam = optax.chain(optax.clip_by_global_norm(settings.most_gradient), optax.adam(settings.rate, eps=1e-5))
        self._apply = optax.apply_updates
        self.decide = jax.jit(self._decide)
        self.value = jax.jit(lambda weights, scaling, features: _value(weights, _scaled(scaling, features)))
        self.improve = jax.jit(self._improve)
        self.improve_value = jax.jit(partial(self._improve, of=("value",)))

    def begin(self, seed: int) -> Learner:
        """Return initial weights and optimiser state, drawn from a seed; the network's outputs are near zero."""
        policy, value = jax.random.split(jax.random.key(seed))
        hidden, outputs = (self.settings.width, self.settings.width), len(self.view.flown)
        weights = {
            "policy": _layers(policy, (self.view.inputs, *hidden, outputs), 0.01),
            "value": _layers(value, (self.view.inputs, *hidden, 1), 1.0),
            "log_spread": jnp.full(outputs, jnp.log(self.settings.spread), jnp.float32),
        }
        with usual_promotion():
            return Learner(weights, self._adam.init(weights))

    def orders(self, rng: np.random.Generator, size: int) -> NumpyArray:
        """Return shuffled indices of ``size`` samples for each pass, (epochs, minibatches, M), without remainder."""
        settings = self.settings
        count = size // settings.minibatches
        each = [rng.permutation(size)[: count * settings.minibatches] for _ in range(settings.epochs)]
        return np.array(each, np.int32).reshape(settings.epochs, settings.minibatches, count)

    def _decide(self, weights: Any, scaling: Pair, seen: Array, last: Array, noise: Array) -> Decision:
        """Draw outputs and actions for observations (N, O), remembered values (N, K) and normals (N, outputs)."""
        features = self.view.features(seen, last)
        mean = network(weights["policy"], _scaled(scaling, features).T).T
        outputs = mean + jnp.exp(weights["log_spread"])[None] * noise
        return Decision(features, outputs, self.view.action(outputs.clip(-LIMIT, LIMIT), seen))

    def _improve(
        self,
        learner: Learner,
        scaling: Pair,
        samples: Samples,
        orders: Array,
        share: Array | None = None,
        of: tuple[str, ...] = ("policy", "value", "log_spread"),
    ) -> tuple[Learner, Array]:
        """Train on an iteration's samples in minibatches ``orders``; return learner, last pass's mean divergence ().

        Args:
            learner: before.
            scaling: of the inputs.
            samples: of the iteration.
            orders: of the samples in each step of the gradient.
            share: () of the rate; None: all of it.
            of: names of the weights that change.
        """
        samples = samples._replace(inputs=_scaled(scaling, samples.inputs))
        settings, rows = self.settings, _rows_of(learner.weights, samples, self.settings)

        def minibatch(learner: Learner, part: Rows) -> tuple[Learner, Array]:
            """Update the learner by one gradient step on some samples (M,), with inputs (F, M) and outputs (K, M)."""
            slope, divergence = jax.grad(partial(_loss, settings), has_aux=True)(learner.weights, part)
            slope = {name: each if name in of else jax.tree.map(jnp.zeros_like, each) for name, each in slope.items()}
            with usual_promotion():
                change, optimiser = self._adam.update(slope, learner.optimiser, learner.weights)
                if share is not None:
                    change = jax.tree.map(lambda each: share * each, change)
                return Learner(self._apply(learner.weights, change), optimiser), divergence

        def epoch(learner: Learner, order: Array) -> tuple[Learner, Array]:
            """Update the learner by one pass over the samples, in minibatches of the indices ``order``."""
            # Shuffled once, because picking the rows of each minibatch is slow.
            shuffled = Rows(*(leaf[order] for leaf in rows))
            inputs, outputs = (part.swapaxes(1, 2) for part in (shuffled.inputs, shuffled.outputs))
            return jax.lax.scan(minibatch, learner, shuffled._replace(inputs=inputs, outputs=outputs))

        learner, divergence = jax.lax.scan(epoch, learner, orders)
        return learner, jnp.mean(divergence[-1])


@contextmanager
def usual_promotion() -> Iterator[None]:
    """Context in which optax may mix types and ranks, even if the user has configured JAX otherwise."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


def _scaled(scaling: Pair, features: Array) -> Array:
    """Normalise the network's inputs (..., F) by ``scaling`` (mean, standard deviation)."""
    found: Array = Scaling(*scaling).scaled(features.reshape(-1, features.shape[-1])).reshape(features.shape)
    return found


def _value(weights: Any, inputs: Array) -> Array:
    """Return the expected discounted returns (...) that the value network gives for inputs (..., F)."""
    return network(weights["value"], inputs.reshape(-1, inputs.shape[-1]).T).reshape(inputs.shape[:-1])


def _rows_of(weights: Any, samples: Samples, settings: Settings) -> Rows:
    """Compute advantages and value targets; return an iteration's decisions as rows (T N, ...)."""
    value = _value(weights, samples.inputs)
    after = jnp.where(samples.ended, samples.beyond, value[1:])
    advantage = _advantages(samples.reward, value[:-1], after, samples.ended, settings)
    whole = (samples.inputs[:-1], samples.outputs, samples.log_density, advantage, advantage + value[:-1])
    return Rows(*(leaf.reshape(-1, *leaf.shape[2:]) for leaf in whole))


def _advantages(reward: Array, value: Array, after: Array, ended: Array, settings: Settings) -> Array:
    """Return generalised advantages (T, N); ``after``: values of the next states, ``ended``: flags of ends."""
    error = reward + settings.discount * after - value

    def back(later: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return a row's discounted sum of temporal-difference errors, with ``later`` ones of the same episode."""
        error, ended = row
        now = error + jnp.where(ended, 0.0, settings.discount * settings.trace) * later
        return now, now

    return jax.lax.scan(back, jnp.zeros_like(error[0]), (error, ended), reverse=True)[1]


def _loss(settings: Settings, weights: Any, rows: Rows) -> tuple[Array, Array]:
    """Return the PPO loss of a minibatch, inputs (F, M) and outputs (K, M), and the divergence from the old policy."""
    advantage = (rows.advantage - jnp.mean(rows.advantage)) / (jnp.std(rows.advantage) + 1e-8)
    away = (rows.outputs - network(weights["policy"], rows.inputs)) * jnp.exp(-weights["log_spread"])[:, None]
    change = -jnp.sum(0.5 * away * away + weights["log_spread"][:, None], axis=0) - rows.log_density
    ratio = jnp.exp(change)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip) * advantage)
    wrong = network(weights["value"], rows.inputs)[0] - rows.target
    entropy = jnp.sum(weights["log_spread"])
    loss = settings.value_weight * jnp.mean(wrong * wrong) - jnp.mean(gain) - settings.entropy_weight * entropy
    return loss, jnp.mean(ratio - 1.0 - change)
