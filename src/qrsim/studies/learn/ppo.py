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
from jax import Array

from qrsim.extras import load


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
    """

    discount: float = 0.98
    trace: float = 0.95
    clip: float = 0.2
    rate: float = 1e-3
    epochs: int = 5
    minibatches: int = 8
    value_weight: float = 0.5
    entropy_weight: float = 0.0
    most_gradient: float = 0.5
    spread: float = 0.6
    width: int = 64


class Learner(NamedTuple):
    """Weights of policy and value, and the state of the optimiser."""

    weights: Any
    optimiser: Any


class Samples(NamedTuple):
    """Decisions of an iteration, (T, N) each; inputs (T, N, F), outputs (T, N, K)."""

    inputs: Any
    outputs: Any
    log_density: Any
    value: Any
    reward: Any
    ended: Any
    value_after: Any


def _layers(key: Array, sizes: tuple[int, ...], last: float) -> list[tuple[Array, Array]]:
    """Return orthogonally initialised layers of a network, with gain ``last`` in the last layer."""
    keys = jax.random.split(key, len(sizes) - 1)
    gains = [2.0**0.5] * (len(sizes) - 2) + [last]
    return [
        (jax.nn.initializers.orthogonal(gain)(one, shape, jnp.float32), jnp.zeros(shape[1], jnp.float32))
        for one, gain, shape in zip(keys, gains, itertools.pairwise(sizes), strict=True)
    ]


def network(layers: Any, inputs: Array) -> Array:
    """Return the outputs (N, K) of a network with tanh between its layers, for inputs (N, F)."""
    for weights, offset in layers[:-1]:
        inputs = jnp.tanh(inputs @ weights + offset[None])
    found: Array = inputs @ layers[-1][0] + layers[-1][1][None]
    return found


class Algorithm:
    """The compiled functions of a learner.

    Args:
        inputs: size of an input (F).
        outputs: size of an output (K).
        settings: numbers of the algorithm.

    Raises:
        MissingExtraError: optax is not installed.
    """

    def __init__(self, inputs: int, outputs: int, settings: Settings):
        optax = load("learn", "qrsim train", "optax")
        self.settings, self._inputs, self._outputs = settings, inputs, outputs
        self._adam = optax.chain(optax.clip_by_global_norm(settings.most_gradient), optax.adam(settings.rate, eps=1e-5))
        self._apply = optax.apply_updates
        self.decide = jax.jit(_decide)
        self.value = jax.jit(lambda weights, inputs: network(weights["value"], inputs)[..., 0])
        self.improve = jax.jit(self._improve)

    def begin(self, seed: int) -> Learner:
        """Return a learner whose network's outputs are near zero."""
        policy, value = jax.random.split(jax.random.key(seed))
        hidden = (self.settings.width, self.settings.width)
        weights = {
            "policy": _layers(policy, (self._inputs, *hidden, self._outputs), 0.01),
            "value": _layers(value, (self._inputs, *hidden, 1), 1.0),
            "log_spread": jnp.full(self._outputs, jnp.log(self.settings.spread), jnp.float32),
        }
        with _usual_promotion():
            return Learner(weights, self._adam.init(weights))

    def _improve(self, learner: Learner, samples: Samples, key: Array) -> tuple[Learner, Array]:
        """Return the learner after all passes over an iteration's samples, and the mean divergence ()."""
        settings = self.settings
        advantage = _advantages(samples, settings)
        target = advantage + samples.value
        rows = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), (samples, advantage, target))
        count = rows[1].shape[0] // settings.minibatches

        def minibatch(learner: Learner, chosen: Array) -> tuple[Learner, Array]:
            """Take a step of the gradient."""
            part = jax.tree.map(lambda leaf: leaf[chosen], rows)
            slope, divergence = jax.grad(partial(_loss, settings), has_aux=True)(learner.weights, *part)
            with _usual_promotion():
                change, optimiser = self._adam.update(slope, learner.optimiser, learner.weights)
                return Learner(self._apply(learner.weights, change), optimiser), divergence

        def epoch(learner: Learner, key: Array) -> tuple[Learner, Array]:
            """Pass once over all samples, in a new order."""
            order = jax.random.permutation(key, rows[1].shape[0])[: count * settings.minibatches]
            return jax.lax.scan(minibatch, learner, order.reshape(settings.minibatches, count))

        learner, divergence = jax.lax.scan(epoch, learner, jax.random.split(key, settings.epochs))
        return learner, jnp.mean(divergence[-1])


@contextmanager
def _usual_promotion() -> Iterator[None]:
    """Context in which optax may mix types and ranks, even if the user has configured JAX otherwise."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


def _decide(weights: Any, inputs: Array, key: Array, number: Array) -> tuple[Array, Array, Array]:
    """Return outputs (N, K) sampled from the policy, their log densities, and the values (N,)."""
    mean = network(weights["policy"], inputs)
    drawn = jax.random.normal(jax.random.fold_in(key, number), mean.shape)
    outputs = mean + jnp.exp(weights["log_spread"])[None] * drawn
    return outputs, _log_density(weights, mean, outputs), network(weights["value"], inputs)[..., 0]


def _log_density(weights: Any, mean: Array, outputs: Array) -> Array:
    """Return the log density of outputs (N, K), up to a constant."""
    away = (outputs - mean) * jnp.exp(-weights["log_spread"])[None]
    return -jnp.sum(0.5 * away * away + weights["log_spread"][None], axis=-1)


def _advantages(samples: Samples, settings: Settings) -> Array:
    """Return generalised advantages (T, N); ``value_after`` is that of the state that a decision led to."""
    error = samples.reward + settings.discount * samples.value_after - samples.value

    def back(later: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        """Add the later errors of the same episode."""
        error, ended = row
        now = error + jnp.where(ended, 0.0, settings.discount * settings.trace) * later
        return now, now

    return jax.lax.scan(back, jnp.zeros_like(error[0]), (error, samples.ended), reverse=True)[1]


def _loss(settings: Settings, weights: Any, samples: Samples, advantage: Array, target: Array) -> tuple[Array, Array]:
    """Return the loss of a minibatch, and the divergence from the old policy."""
    advantage = (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)
    mean = network(weights["policy"], samples.inputs)
    change = _log_density(weights, mean, samples.outputs) - samples.log_density
    ratio = jnp.exp(change)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip) * advantage)
    wrong = network(weights["value"], samples.inputs)[..., 0] - target
    entropy = jnp.sum(weights["log_spread"])
    loss = settings.value_weight * jnp.mean(wrong * wrong) - jnp.mean(gain) - settings.entropy_weight * entropy
    return loss, jnp.mean(ratio - 1.0 - change)
